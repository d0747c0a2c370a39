"""Mappings and curricula that make no sense: each is refused in one sentence."""

import numpy as np
import pytest

import curricle as cr
from curricle import (
    Curriculum,
    FiniteMDP,
    GridWorld,
    Pursuit,
    StateActionPotential,
    Transfer,
    from_function,
    learn,
    project,
    same_position,
)
from curricle.errors import CurriculumError, MappingError, PotentialError, TaskError
from curricle.transfer import StateActionMapping, compose, identity
from tests.refusals import check_refusal

NAN = float("nan")
LINE = GridWorld("S.T")
HUNT, CHASE = Pursuit(size=2, predators=2), Pursuit(size=2, predators=1)
FIRST = project(HUNT, CHASE, predator="predator_1")
INDEX = identity(LINE).index


def curriculum(**changes):
    settings = {"tasks": {"chase": CHASE, "hunt": HUNT}, "budget": 50}
    settings["transfers"] = [Transfer("chase", "hunt", FIRST)]
    return Curriculum(**(settings | changes))


def around(*names):
    """A curriculum of one task under several names, each the source of the next, in a ring."""
    here = identity(LINE)
    edges = [Transfer(s, t, here) for s, t in zip(names, names[1:] + names[:1], strict=True)]
    return Curriculum(dict.fromkeys(names, LINE), edges)


MAPPINGS = [
    (lambda: StateActionMapping(LINE, LINE, INDEX[:2]), r"\(3, 4\): got int64 of shape \(2, 4\)"),
    (lambda: StateActionMapping(LINE, LINE, INDEX * 1.0), "integer array .*got float64"),
    (lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 5, 12, INDEX)), r"action 1 has 12"),
    (lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 2, -3, INDEX)), "0, action 2 has -3"),
    (lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 4, 8, INDEX)), "at source state 2"),
    (lambda: identity(LINE).read(np.ones((4, 3))), r"\(3, 4\): got \(4, 3\)"),
    (lambda: same_position(LINE, CHASE), "GridWorld: the source is Pursuit"),
    (lambda: project(HUNT, CHASE), "must be read .*prey, predator_1, predator_2.*got 'predator'"),
    (lambda: from_function(LINE, LINE, lambda s, a: ({"row": s["row"]}, a)), "column: got row"),
    (
        lambda: from_function(cr.Pursuit(10, predators=3), LINE, lambda s, a: (s, a)),
        "lists all pairs of the target, at most 1,000,000,000: it has 12,500,000,000",
    ),
    (lambda: compose(identity(LINE), FIRST), "source to be the second's"),
]

CURRICULA = [
    (lambda: Curriculum({}), "at least one task"),
    (lambda: curriculum(transfers=[Transfer("x", "hunt", FIRST)]), "one of chase, hunt: got 'x'"),
    (lambda: curriculum(transfers=[Transfer("hunt", "chase", FIRST)]), "'hunt' in hunt -> chase"),
    (lambda: around("a", "b", "c"), "cycle: (a -> b -> c -> a|b -> c -> a -> b|c -> a -> b -> c)$"),
    (lambda: curriculum(budget={"x": 9}), "budget .*chase, hunt: got 'x'"),
    (lambda: Transfer("chase", "hunt", FIRST, scale=NAN), "chase -> hunt must be finite: got nan"),
    (lambda: curriculum().train(trained={"hunt": learn(CHASE, budget=9)}), "'hunt' does not"),
    (
        lambda: curriculum().train(2, trained={"chase": learn(CHASE, budget=9)}),
        r"seeds asked for, \(0, 1\): 'chase' has \(0,\)",
    ),
    (lambda: curriculum().train()["x"], "one of chase, hunt: got 'x'"),
]


@pytest.mark.parametrize(("call", "says"), MAPPINGS)
def test_bad_mappings_are_refused_in_one_sentence(call, says):
    check_refusal(MappingError, call, says)


@pytest.mark.parametrize(("call", "says"), CURRICULA)
def test_bad_curricula_are_refused_in_one_sentence(call, says):
    check_refusal(CurriculumError, call, says)


def test_refused_arrays_are_as_they_were_and_still_writable():
    arrays = {
        "transition": np.array([[[0.0, 0.9]], [[0.0, 1.0]]]),
        "terminal": np.array([False, True]),
        "start": np.array([1.0, 0.0]),
        "index": np.where(INDEX == 4, 8, INDEX),
        "phi": np.full((3, 4), NAN),
    }
    before = {name: array.copy() for name, array in arrays.items()}
    for error, call in [
        (
            TaskError,
            lambda a: FiniteMDP.from_dense(
                a["transition"], [1, 0], terminal=a["terminal"], start=a["start"], discount=0.9
            ),
        ),
        (MappingError, lambda a: StateActionMapping(LINE, LINE, a["index"])),
        (PotentialError, lambda a: StateActionPotential(LINE, a["phi"])),
    ]:
        with pytest.raises(error):
            call(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, before[name])
        assert array.flags.writeable


@pytest.mark.parametrize("wrong", [{"seeds": []}, {"seeds": 2, "trained": "other seeds"}])
def test_a_refused_curriculum_trains_nothing(wrong):
    seen, kept = [], {"chase": learn(CHASE, budget=9)}
    if "trained" in wrong:
        wrong = wrong | {"trained": kept}
    with pytest.raises(cr.CurricleError):
        curriculum().train(**wrong, progress=seen.append)
    assert seen == []
    assert set(kept) == {"chase"}
