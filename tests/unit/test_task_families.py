"""Task families: parameters checked, members that are addresses, and nothing built too early."""

import copy
import pickle
from functools import partial
from typing import Annotated, Any, Literal

import pytest

from curricle import GridWorld, solve
from curricle.errors import TaskError
from curricle.study_file.task_tables import BUILT_IN
from curricle.tasks import (
    ComponentsByName,
    Parameter,
    Rule,
    TaskFamily,
    maze_family,
    pursuit_family,
    task_family,
)
from tests.support.refusals import check_refusal, check_values

BUILT = list[int]()


@task_family(
    mapping=ComponentsByName("clip"),
    constraint=lambda values: (
        "a long corridor must be flat"
        if values["length"] > 7 and values["slope"] == "steep"
        else None
    ),
)
def corridor(
    length: Annotated[int, Rule(2, 9, "larger")],
    slope: Annotated[Literal["flat", "steep"], Rule(harder="later")] = "flat",
    wet: bool = False,
    side: Literal["left", "right"] = "left",
    limit: int | None = 50,
    discount: float = 0.9,
    notes: object = None,
) -> GridWorld:
    """Return a corridor."""
    BUILT.append(length)
    return GridWorld("S" + "." * (length - 2) + "T", discount=discount, time_limit=limit)


def test_a_decorated_function_is_a_family():
    assert isinstance(corridor, TaskFamily)
    member = corridor(length=4)
    assert member.task == GridWorld("S..T", discount=0.9, time_limit=50)
    assert member.parameters == {
        "length": 4, "slope": "flat", "wet": False, "side": "left", "limit": 50, "discount": 0.9,
    }  # fmt: skip


def test_nothing_is_built_before_a_task_is_asked_for():
    BUILT.clear()
    members = list(corridor.easier(corridor(length=9, wet=True)))
    assert len(set(members)) == len(members) == 7
    assert not BUILT
    first = members[0]
    assert first.task is first.task
    assert BUILT == [2]


def test_members_are_values():
    member = corridor(length=5, discount=0.5)
    assert member == corridor(discount=0.5, length=5.0)
    assert hash(member) == hash(corridor(length=5, discount=0.5))
    assert member != corridor(length=5)
    assert repr(member) == "corridor(length=5, discount=0.5)"
    assert repr(corridor(length=5)) == "corridor(length=5)"
    assert {member: 1}[copy.deepcopy(member)] == 1
    assert member.replace(length=3) == corridor(length=3, discount=0.5)


@pytest.mark.parametrize(
    "family", [corridor, *BUILT_IN.values()], ids=lambda family: repr(family)[:40]
)
def test_families_and_members_are_pickled(family):
    assert pickle.loads(pickle.dumps(family)) == family
    member = family(**({"length": 3} if family.name == "corridor" else {}))
    _ = member.task  # which is not pickled with it
    again = pickle.loads(pickle.dumps(member))
    assert "task" not in vars(again)
    assert (again, hash(again), repr(again)) == (member, hash(member), repr(member))


def test_easier_members_are_nowhere_harder():
    assert list(corridor.easier(corridor(length=3, slope="steep", wet=True))) == [
        corridor(length=2, wet=True),
        corridor(length=2, slope="steep", wet=True),
        corridor(length=3, wet=True),
    ]
    assert not list(corridor.easier(corridor(length=2)))
    members = list(pursuit_family.easier(pursuit_family(size=4, predators=2, capture=2)))
    assert pursuit_family(size=4, predators=1) not in members
    assert {parameter["predators"] for parameter in members} == {
        2
    }  # one predator cannot be two on the prey


def test_a_smaller_number_may_be_harder_and_so_may_a_flag():
    @task_family()
    def cave(
        light: Annotated[int, Rule(0, 3, "smaller")] = 2,
        wet: Annotated[bool, Rule(harder="larger")] = True,
    ) -> GridWorld:
        return GridWorld("ST")

    assert list(cave.easier(cave())) == [
        cave(light=3, wet=False), cave(light=3, wet=True), cave(light=2, wet=False),
    ]  # fmt: skip


def one_word(word: Annotated[Any, Rule(values=("a", "c"))] = "a") -> GridWorld:
    return GridWorld("ST")


def another_word(word: Annotated[Any, Rule(values=("b",))] = "a") -> GridWorld:
    return GridWorld("ST")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: corridor(), "length of corridor must be given: it has no default, and is 2..9"),
        (lambda: corridor(lenght=4), "be one of length, .*: got 'lenght', did you mean 'length'"),
        (lambda: corridor(length=9, slope="steep"), "a long corridor must be flat: got corridor"),
        (lambda: corridor(length=99), r"must lie in \[2, 9\]: got 99"),
        (lambda: corridor(length=3)["size"], "a parameter of corridor must be one of"),
        (lambda: list(corridor.easier(3)), "easier than must be a FamilyMember: got 3"),
        (lambda: list(corridor.easier(maze_family())), "easier needs a member of corridor"),
        (lambda: Parameter("a", int, Rule(2, 1)), "low of parameter 'a' must be at most high"),
        (lambda: Parameter("a", int, Rule(harder="later")), "needs values in that order"),
        (lambda: Parameter("a", None, Rule(None, None, "larger", ("x", "y"))), "must be 'later'"),
        (lambda: TaskFamily("f", another_word), "word of f, its default, must be one of b: got"),
        (
            lambda: TaskFamily("f", one_word, constraint=lambda values: False)(),
            "constraint of f must return None or, as a sentence, the mistake: got False for f",
        ),
        (lambda: task_family()(lambda x: x), "parameter 'x' of <lambda> must have a kind"),
        (lambda: solve(pursuit_family(size=3)), r"got pursuit\(size=3\), whose task is its \.task"),
        (lambda: TaskFamily("f", lambda: 1)().task, "a task must be a FiniteMDP"),
    ],
)
def test_bad_members_and_declarations_are_refused_in_a_sentence(wrong, said):
    check_refusal(TaskError, wrong, said)


def test_wrong_values_are_named():
    check_values(TaskError, corridor, {"length": [1, 10, "4", True, 2.5]})
    wrong = {"wet": [1], "slope": ["step"], "discount": ["x", None]}
    check_values(TaskError, partial(corridor, length=4), wrong)
    check_values(TaskError, pursuit_family, {"capture": [True]})
    check_values(TaskError, lambda harder: Parameter("a", int, Rule(2, 3, harder)), {"harder": [3]})
    wrong = {"mapping": [3], "constraint": [3]}
    check_values(TaskError, partial(TaskFamily, "f", one_word), wrong)
    check_values(TaskError, partial(TaskFamily, "f"), {"factory": [3]})
    check_values(TaskError, ComponentsByName, {"unequal": ["stretch"], "renaming": [3, {"a": 1}]})
