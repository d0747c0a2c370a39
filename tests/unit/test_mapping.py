"""Mappings between tasks: source pairs, unmapped pairs, coverage, the identity; refusals."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from curricle import (
    CurricleError,
    Curriculum,
    FiniteMDP,
    GridWorld,
    Pursuit,
    Transfer,
    from_function,
    learn,
    project,
    same_position,
)
from curricle.errors import CurriculumError, MappingError
from curricle.interop.gymnasium import observation_task
from curricle.transfer import (
    ENDED,
    UNMAPPED,
    FunctionValues,
    ObservationMapping,
    ObservationPotential,
    StateActionMapping,
    identity,
    relative_objects,
)
from tests.support.refusals import check_refusal
from tests.support.studies import CORNER, only

LINE = GridWorld("S..T")
END = LINE.crop(rows=(0, 1), columns=(2, 4))


def source_states(mapping):
    """The source state each target state reads its first action from, or UNMAPPED or ENDED."""
    first = mapping.index[:, 0]
    return np.where(first >= 0, first // mapping.source.actions.size, first).tolist()


def test_same_position_by_hand():
    mapping = same_position(LINE, END)
    assert source_states(mapping) == [UNMAPPED, UNMAPPED, 0, ENDED]
    assert mapping.index[2].tolist() == [0, 1, 2, 3]
    open_field, walled = GridWorld(["S.", ".T"]), GridWorld(["S#", ".T"])
    assert source_states(same_position(open_field, walled)) == [0, UNMAPPED, 1, ENDED]
    assert source_states(same_position(walled, open_field)) == [0, 2, ENDED]
    deadly, mild = GridWorld("SPT"), GridWorld("SPT", ends=("treasure",))
    assert source_states(same_position(mild, deadly)) == [0, ENDED, ENDED]
    assert source_states(same_position(deadly, mild)) == [0, ENDED, ENDED]


def test_relative_objects_by_hand():
    target = GridWorld(["S....", "..F.T"])
    source = GridWorld(["F.T", "S.."])  # fits with its top row on the target's bottom row
    assert np.array(source_states(relative_objects(target, source))).reshape(2, 5).tolist() == [
        [UNMAPPED] * 5,
        [UNMAPPED, UNMAPPED, 0, 1, ENDED],
    ]
    mapping = relative_objects(GridWorld("SF..T"), GridWorld("SF.T"))
    assert source_states(mapping)[:4] == [UNMAPPED] * 4
    assert mapping.coverage().mapped == 0
    assert mapping.coverage().mean_readers == 0
    assert relative_objects(GridWorld("SF.PT"), GridWorld("SP.T")).coverage().mapped == 0


def test_relative_objects_takes_the_smallest_shift_that_maps_a_cell():
    target, source = GridWorld("T.S.T", ends=()), GridWorld("S.T", ends=())
    # Shift -2 (treasure at 0) reaches only column 0; shift 2 (treasure at 4) columns 2, 3, 4.
    assert source_states(relative_objects(target, source)) == [2, UNMAPPED, 0, 1, 2]
    both, wide = GridWorld("T.T.S", ends=()), GridWorld("S.T..", ends=())
    # Shift -2 maps columns 0, 1, 2 and comes first; shift 0 adds 3 and 4.
    assert source_states(relative_objects(both, wide)) == [2, 3, 4, 3, 4]


def test_from_function_gets_broadcastable_components():
    shapes = {}

    def coarse(state, action):
        shapes.update(column=state["column"].shape, move=action["move"].shape)
        return {"row": state["row"], "column": state["column"] + 2}, action

    mapping = from_function(END, LINE, coarse)
    assert shapes == {"column": (2, 1), "move": (1, 4)}
    assert source_states(mapping) == [UNMAPPED, ENDED]


def test_from_function_may_map_actions_by_state_and_does_not_round():
    def mirrored(state, action):
        east_is_west = np.array([0, 3, 2, 1])[action["move"]]
        return state, {"move": np.where(state["column"] == 0, east_is_west, action["move"])}

    mapping = from_function(LINE, LINE, mirrored)
    assert mapping.index[:2].tolist() == [[0, 3, 2, 1], [4, 5, 6, 7]]

    def half(state, action):
        return {**state, "column": state["column"] / 2}, action

    with pytest.raises(CurricleError):
        from_function(LINE, LINE, half)


def test_reading_by_hand():
    q = np.arange(8.0).reshape(2, 4) + 10
    read = same_position(LINE, END, unmapped_value=-7).read(q)
    assert read.tolist() == [[-7] * 4, [-7] * 4, [10, 11, 12, 13], [0] * 4]
    q = np.arange(24.0).reshape(3, 2, 4)
    assert same_position(LINE, END).read(q).shape == (3, 4, 4)
    assert same_position(LINE, END).read(q)[2, 2].tolist() == [16, 17, 18, 19]
    assert (same_position(LINE, END).index >= 0).any(axis=1).tolist() == [False, False, True, False]


def test_rows_of_terminal_target_states_do_not_count():
    index = np.array([[0] * 4, [1] * 4, [2] * 4, [999] * 4])
    mapping = StateActionMapping(LINE, END, index)
    assert mapping.index[3].tolist() == [ENDED] * 4
    assert index[3].tolist() == [999] * 4


def chain(n=3, name="place", low=0, labels=("left", "right"), points=None):
    """A chain whose states have a name; entering the last one ends the episode."""
    states = cr.Space([cr.Component(name, n, low)], points)
    size = states.size
    outcomes = [[[(1.0, min(s + 1, size - 1), -1.0)]] * 2 for s in range(size)]
    terminal = np.arange(size) == size - 1
    actions = cr.Space([cr.Component("move", 2, labels=labels)])
    return FiniteMDP.from_outcomes(
        outcomes, terminal=terminal, start=0, discount=0.9, states=states, actions=actions
    )


def test_each_pair_reads_the_same_pair_whatever_names_are():
    target, source = chain(), chain(name="cell")
    mapping = identity(target, source)
    assert mapping.target is target
    assert mapping.source is source
    assert mapping.index.tolist() == [[0, 1], [2, 3], [ENDED, ENDED]]
    target, source = cr.GridWorld("S.PT", ends=["treasure"]), cr.GridWorld("S.PT")
    assert identity(target, source).index[2].tolist() == [ENDED] * 4


def test_live_tasks_and_tables_may_be_mixed():
    lake = {live: cr.from_gymnasium("FrozenLake-v1", discount=0.9, live=live) for live in (0, 1)}
    assert identity(lake[1], lake[0]).coverage().ended > 0
    assert identity(lake[0], lake[1]).coverage().mapped == 1


def test_observations_of_one_shape_are_left_as_they_are():
    slow, fast = (cr.observation_task("MountainCar-v0", goal_velocity=v) for v in (0, 0.01))
    mapping = identity(fast, slow)
    assert mapping.is_identity
    assert mapping.source == slow
    assert identity(slow).target == slow
    assert "as they are" in repr(mapping)


def test_dicts_of_observations_must_have_the_same_keys():
    def boxes(**parts):
        return cr.observation_task(lambda: Shown(gym.spaces.Dict(parts)))

    box = gym.spaces.Box(0, 1, (2,))
    assert identity(boxes(a=box), boxes(a=gym.spaces.Box(0, 5, (2,)))).is_identity
    with pytest.raises(MappingError, match="identity needs tasks of one shape"):
        identity(boxes(a=box), boxes(b=box))


class Shown(gym.Env):
    """Only its spaces are looked at."""

    def __init__(self, space):
        self.observation_space, self.action_space = space, gym.spaces.Discrete(2)


FIVE = cr.GridWorld("S...T")
LAST_THREE = FIVE.crop(rows=(0, 1), columns=(2, 5))
VALUES = {"end": np.full((1, 3, 4), -4.0), "line": np.full((1, 5, 4), -2.0)}


def curriculum(unmapped_value=None, **settings):
    """Return two sources of `far`: one knows its end, the other all of it."""
    mapping = cr.same_position(FIVE, LAST_THREE, unmapped_value=unmapped_value)
    edges = [Transfer("end", "far", mapping), Transfer("line", "far", identity(FIVE))]
    return cr.Curriculum({"end": LAST_THREE, "line": FIVE, "far": FIVE}, edges, **settings)


def potential(plan, sources=("end", "line")):
    learnt = {
        name: cr.curriculum.SourceValues(plan.tasks[name], (0,), VALUES[name], np.array([0]))
        for name in sources
    }
    edges = [edge for edge in plan.in_edges("far") if edge.source in sources]
    (phi,) = plan.potentials("far", learnt, transfers=edges)
    return phi.values[:, 0].tolist()


def test_one_value_stands_where_no_source_knows_anything():
    assert potential(curriculum(0.0)) == [-1, -1, -3, -3, 0]  # as published: 0 is a vote
    assert potential(curriculum(), ["end"]) == [0, 0, -4, -4, 0]
    for value in (-9.0, {"far": -9}):
        plan = curriculum(unknown_value=value)
        assert potential(plan, ["end"]) == [-9, -9, -4, -4, 0]  # and 0 where the episode has ended
        assert potential(plan) == [-2, -2, -3, -3, 0]
    with pytest.raises(CurriculumError, match="unknown_value of far must be finite: got nan"):
        curriculum(unknown_value={"far": np.nan})
    with pytest.raises(MappingError, match="unmapped_value must be finite: got inf"):
        curriculum(np.inf)


def test_a_users_aggregate_skips_or_has_the_values_stated():
    def median(potentials):
        return np.median(potentials, axis=0)

    with pytest.raises(CurriculumError, match=r"must skip NaN.*median returned nan at state 0"):
        potential(curriculum(aggregate=median))
    assert potential(curriculum(0.0, aggregate=median)) == [-1, -1, -3, -3, 0]


def test_a_study_file_states_either(read):
    plan = only(read(CORNER))
    assert plan.transfers[0].mapping.unmapped_value is None
    assert plan.setting("unknown_value", "maze") == 0
    as_published = only(read(CORNER + "unmapped_value = 0\n"))
    assert as_published.transfers[0].mapping.unmapped_value == 0
    plan = only(read(CORNER, set=["tasks.maze.unknown_value=-9"]))
    assert plan.setting("unknown_value", "maze") == -9


def test_observations_without_counterpart_are_skipped_too():
    car = observation_task("MountainCar-v0")
    speed = FunctionValues(state_values=lambda cars: cars[:, 1])
    everywhere = ObservationMapping(car, car)
    to_the_left = ObservationMapping(car, car, status=lambda cars: cars[:, 0] < 0)
    to_the_right = ObservationMapping(car, car, status=lambda cars: cars[:, 0] > 0.25)

    def phi(*mappings, **settings):
        edges = [Transfer("source", "car", f, scale=10.0**i) for i, f in enumerate(mappings)]
        potential = ObservationPotential(car, edges, [speed] * len(edges), **settings)
        return potential.v(np.array([[-1.0, 1.0], [0.125, 1.0], [0.5, 1.0]])).tolist()

    assert phi(everywhere, to_the_left) == [5.5, 1, 1]
    assert phi(to_the_left, to_the_right, function=cr.maximum) == [1, 0, 10]
    assert phi(to_the_left, unknown_value=-3.0) == [1, -3, -3]
    assert phi(to_the_left, unknown_value=-3.0, scale=2.0, shift=1.0) == [3, -5, -5]


ROW, PIT = GridWorld("S.T"), GridWorld("SPT")
HUNT, CHASE = Pursuit(size=2, predators=2), Pursuit(size=2, predators=1)
FIRST = project(HUNT, CHASE, predator="predator_1")
INDEX = identity(ROW).index


def pursuits(**changes):
    settings = {"tasks": {"chase": CHASE, "hunt": HUNT}, "budget": 50}
    settings["transfers"] = [Transfer("chase", "hunt", FIRST)]
    return Curriculum(**(settings | changes))


def around(*names):
    """A pursuits of one task under several names, each the source of the next, in a ring."""
    here = identity(ROW)
    edges = [Transfer(s, t, here) for s, t in zip(names, names[1:] + names[:1], strict=True)]
    return Curriculum(dict.fromkeys(names, ROW), edges)


CAR = observation_task("MountainCar-v0")
FLAT = from_function, LINE, END, lambda s, a: ({k: v.ravel() for k, v in s.items()}, a)
HALVES = cr.Space([cr.Component("a", 2), cr.Component("b", 2, low=2)])
MAPPINGS = [
    (lambda: FLAT[0](*FLAT[1:]), r"\(S, A\) being \(4, 4\): got \(4,\)"),
    (
        lambda: ObservationMapping(CAR, CAR, status=lambda o: np.full(len(o), -7)).coverage(
            np.zeros((2, 2))
        ),
        "UNMAPPED, ENDED or 0: got -7",
    ),
    (lambda: StateActionMapping(ROW, ROW, INDEX[:2]), r"\(3, 4\): got int64 of shape \(2, 4\)"),
    (lambda: StateActionMapping(ROW, ROW, INDEX * 1.0), "integer array .*got float64"),
    (lambda: StateActionMapping(ROW, ROW, np.where(INDEX == 5, 12, INDEX)), r"action 1 has 12"),
    (lambda: StateActionMapping(ROW, ROW, np.where(INDEX == 2, -3, INDEX)), "action 2 has -3"),
    (lambda: StateActionMapping(ROW, ROW, np.where(INDEX == 4, 8, INDEX)), "at source state 2"),
    (lambda: identity(ROW).read(np.ones((4, 3))), r"\(3, 4\): got \(4, 3\)"),
    (lambda: same_position(ROW, CHASE), "GridWorld: the source is Pursuit"),
    (lambda: project(HUNT, CHASE), "must be read .*prey, predator_1, predator_2.*got 'predator'"),
    (lambda: project(LINE, END, x="row"), "of the source, column, move, row: got 'x'"),
    (
        lambda: project(chain(low=5), chain(4)),
        "map some pair: no value is in both tasks: place of the target runs from 5 to 7, and place "
        "of the source from 0 to 3; give both",
    ),
    (
        lambda: project(chain(), chain(labels=("up", "down"))),
        "move of the target runs from left to right, and move of the source from up to down; give",
    ),
    (
        lambda: project(chain(4), replace(chain(4), states=HALVES), a="place", b="place"),
        "map some pair: a component of the target has no value that is in all .*; give",
    ),
    (
        lambda: project(chain(9, points=[[0], [2], [8]]), chain(9, points=[[1], [3], [8]])),
        "map some pair: none of the 6 target pairs reads a source pair",
    ),
    (
        lambda: from_function(LINE, END, lambda s, a: ({"row": s["colunm"]}, a)),
        "row, column: got 'colunm'",
    ),
    (
        lambda: from_function(LINE, END, lambda s, a: (s, {"move": a["step"]})),
        "actions, move: got 'step'",
    ),
    (lambda: from_function(ROW, ROW, lambda s, a: ({"row": s["row"]}, a)), "column: got row"),
    (
        lambda: from_function(cr.Pursuit(10, predators=3), ROW, lambda s, a: (s, a)),
        "lists all pairs of the target, at most 1,000,000,000: it has 12,500,000,000",
    ),
    (lambda: identity(HUNT, CHASE), "prey, predator_1, predator_2, the source's prey, predator; "),
    (lambda: identity(chain(4), chain()), r"have place\[4\], the source's place\[3\]; "),
    (lambda: identity(chain(low=1), chain()), r"place\[3 from 1\], the source's place\[3\]; "),
    (
        lambda: identity(GridWorld("S#.T"), GridWorld("S.#T")),
        "states of row, column are 3 in the target and 3 in the source, not the same points in the",
    ),
    (lambda: identity(chain(), chain(labels=("right", "left"))), "and right, left in the source; "),
    (lambda: identity(chain(), chain(labels=("right", "stay"))), "and right, stay in the source; "),
    (
        lambda: identity(observation_task("MountainCar-v0"), observation_task("CartPole-v1")),
        r"target's observations are Box\(\[-1.2  -0.07\].*, the source's Box\(.*; a function of",
    ),
]


CURRICULA = [
    (lambda: Curriculum({}), "at least one task"),
    (lambda: pursuits(transfers=[Transfer("x", "hunt", FIRST)]), "one of chase, hunt: got 'x'"),
    (lambda: pursuits(transfers=[Transfer("hunt", "chase", FIRST)]), "'hunt' in hunt -> chase"),
    (
        lambda: Curriculum(
            {"mild": PIT, "odd": LINE}, [Transfer("mild", "odd", relative_objects(LINE, PIT))]
        ),
        "in mild -> odd none of the 16 target pairs reads a source pair",
    ),
    (lambda: around("a", "b", "c"), "cycle: (a -> b -> c -> a|b -> c -> a -> b|c -> a -> b -> c)$"),
    (lambda: pursuits(budget={"x": 9}), "budget .*chase, hunt: got 'x'"),
    (lambda: Transfer("chase", "hunt", FIRST, scale=np.nan), "chase -> hunt must be finite"),
    (lambda: pursuits().train(trained={"hunt": learn(CHASE, budget=9)}), "'hunt' is Learning"),
    (lambda: pursuits().train(2, trained={"chase": learn(CHASE, budget=9)}), r"'chase' has \(0,\)"),
    (lambda: pursuits().train()["x"], "one of chase, hunt: got 'x'"),
]


@pytest.mark.parametrize(
    ("error", "call", "says"),
    [*((MappingError, *row) for row in MAPPINGS), *((CurriculumError, *row) for row in CURRICULA)],
)
def test_bad_mappings_and_curricula_are_refused_in_one_sentence(error, call, says):
    check_refusal(error, call, says)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.uint64])
def test_an_index_of_any_whole_type_is_read(kind):
    index = np.arange(16).reshape(4, 4)
    mapping = StateActionMapping(LINE, LINE, index.astype(kind))
    np.testing.assert_array_equal(mapping.index, StateActionMapping(LINE, LINE, index).index)


@pytest.mark.parametrize("wrong", [{"seeds": []}, {"seeds": 2, "trained": "other seeds"}])
def test_a_refused_curriculum_trains_nothing(wrong):
    seen, kept = [], {"chase": learn(CHASE, budget=9)}
    if "trained" in wrong:
        wrong = wrong | {"trained": kept}
    with pytest.raises(cr.CurricleError):
        pursuits().train(**wrong, progress=seen.append)
    assert seen == []
    assert set(kept) == {"chase"}
