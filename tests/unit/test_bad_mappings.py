"""Mappings and curricula that make no sense: each is refused in one sentence."""

import numpy as np
import pytest

import curricle as cr
from curricle import (
    SARSA,
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
from curricle.transfer import StateActionMapping, compose, identity, relative_objects
from tests.refusals import cases, check_refusal

NAN, INF = float("nan"), float("inf")
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


MAPPINGS = {
    "shape": (
        lambda: StateActionMapping(LINE, LINE, INDEX[:2]),
        r"\(3, 4\): got int64 of shape \(2, 4\)",
    ),
    "floats": (lambda: StateActionMapping(LINE, LINE, INDEX * 1.0), "integer array .*got float64"),
    "booleans": (lambda: StateActionMapping(LINE, LINE, INDEX > 0), "got bool"),
    "too high": (
        lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 5, 12, INDEX)),
        r"0\.\.11.*state 1, action 1 has 12",
    ),
    "too low": (
        lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 2, -3, INDEX)),
        "state 0, action 2 has -3",
    ),
    "onto a terminal": (
        lambda: StateActionMapping(LINE, LINE, np.where(INDEX == 4, 8, INDEX)),
        "terminal source state.*state 1, action 0 points at source state 2",
    ),
    "unmapped_value": (lambda: same_position(LINE, LINE, unmapped_value=NAN), "finite: got nan"),
    "values of another shape": (
        lambda: identity(LINE).read(np.ones((4, 3))),
        r"\(3, 4\): got \(4, 3\)",
    ),
    "edge values": (
        lambda: Transfer("chase", "hunt", FIRST).potential(np.ones((3, 3))),
        r"\(16, 5\): got \(3, 3\)",
    ),
    "position of pursuit": (lambda: same_position(LINE, CHASE), "GridWorld: the source is Pursuit"),
    "objects of pursuit": (
        lambda: relative_objects(CHASE, LINE),
        "GridWorld: the target is Pursuit",
    ),
    "component needs a name": (
        lambda: project(HUNT, CHASE),
        "'predator' must be read .*prey, predator_1, predator_2.*got 'predator'",
    ),
    "unknown target component": (
        lambda: project(HUNT, CHASE, predator="wolf"),
        r"\(prey, predator_1, predator_2\): got 'wolf'",
    ),
    "unknown source component": (
        lambda: project(HUNT, CHASE, wolf="prey"),
        "components of the source, predator, prey: got 'wolf'",
    ),
    "function without components": (
        lambda: from_function(LINE, LINE, lambda s, a: ({"row": s["row"]}, a)),
        "state components row, column: got row",
    ),
    "function of a large target": (
        lambda: from_function(cr.Pursuit(10, predators=3), LINE, lambda s, a: (s, a)),
        "lists all pairs of the target, at most 1,000,000,000: it has 12,500,000,000",
    ),
    "function of other actions": (
        lambda: from_function(LINE, LINE, lambda s, a: (s, {"jump": a["move"]})),
        "action components move: got jump",
    ),
    "function of another shape": (
        lambda: from_function(LINE, LINE, lambda s, a: ({"row": 0, "column": 0}, {"move": 0})),
        r"shape \(3, 4\): got int64 of shape \(\)",
    ),
    "no way from one to the next": (
        lambda: compose(identity(LINE), FIRST),
        "source to be the second's",
    ),
}

CURRICULA = {
    "no tasks": (lambda: Curriculum({}), "at least one task"),
    "unknown source": (
        lambda: curriculum(transfers=[Transfer("x", "hunt", FIRST)]),
        "a transfer's source must be one of chase, hunt: got 'x'",
    ),
    "unknown target": (
        lambda: curriculum(transfers=[Transfer("chase", "x", FIRST)]),
        "a transfer's target must be one of chase, hunt: got 'x'",
    ),
    "mapping of other tasks": (
        lambda: curriculum(transfers=[Transfer("hunt", "chase", FIRST)]),
        "source is not the task 'hunt' in hunt -> chase",
    ),
    "cycle of one": (lambda: around("a"), "no cycle: a -> a"),
    "cycle of three": (
        lambda: around("a", "b", "c"),
        "no cycle: (a -> b -> c -> a|b -> c -> a -> b|c -> a -> b -> c)$",
    ),
    "settings of unknown tasks": (
        lambda: curriculum(budget={"x": 9}),
        "budget .*chase, hunt: got 'x'",
    ),
    "learner of unknown tasks": (lambda: curriculum(learner={"x": SARSA()}), "learner .*got 'x'"),
    "scale": (
        lambda: Transfer("chase", "hunt", FIRST, scale=NAN),
        "scale of chase -> hunt must be finite: got nan",
    ),
    "shift": (
        lambda: Transfer("chase", "hunt", FIRST, shift=INF),
        "shift of chase -> hunt must be finite: got inf",
    ),
    "aggregate of another shape": (
        lambda: curriculum(aggregate=lambda phi: phi).train(),
        r"shape \(64, 25\): <lambda> returned \(1, 64, 25\)",
    ),
    "aggregate of NaN": (
        lambda: curriculum(aggregate=lambda phi: phi[0] * NAN).train(),
        "finite values: <lambda> returned nan at state 0, action 0",
    ),
    "result of an unknown task": (
        lambda: curriculum().train(trained={"x": learn(CHASE, budget=9)}),
        "belong to a task of the curriculum: 'x'",
    ),
    "result of another task": (
        lambda: curriculum().train(trained={"hunt": learn(CHASE, budget=9)}),
        "'hunt' does not",
    ),
    "result of other seeds": (
        lambda: curriculum().train(2, trained={"chase": learn(CHASE, budget=9)}),
        r"seeds asked for, \(0, 1\): 'chase' has \(0,\)",
    ),
    "unknown node": (lambda: curriculum().train()["x"], "one of chase, hunt: got 'x'"),
}


@pytest.mark.parametrize(
    ("error", "call", "says"), cases({MappingError: MAPPINGS, CurriculumError: CURRICULA})
)
def test_bad_input_is_refused_in_one_sentence(error, call, says):
    check_refusal(error, call, says)


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
