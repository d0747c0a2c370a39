"""Candidates for the sources of a target, kind by kind, and which of them are dropped."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest

import curricle as cr
from curricle import FiniteMDP, GridWorld, Pursuit, same_position
from curricle.candidates import SourceCandidate, source_candidates
from curricle.candidates.candidates import KINDS
from curricle.errors import CurriculumError, TaskError
from curricle.paper.mazes import maze as paper_maze
from curricle.tasks.start_states import goal_states
from curricle.transfer import family_mappings
from curricle.transfer.mapping import UNMAPPED, terminal_states
from tests.support.refusals import cases, check_refusal, check_values
from tests.support.renumbering import renumbered
from tests.support.tasks import ring

MAZE = paper_maze(-5.0)
CORRIDOR = GridWorld("S....T")


def only(kind, target, **settings):
    """Return all candidates of one kind."""
    return source_candidates(target, kinds=[kind], **{"most": 1000} | settings)


def names(candidates):
    return [candidate.name for candidate in candidates]


def chain(n=8, slip=0.2, **settings):
    """Return a user's chain without names: right is forward, the last state ends it with 10."""
    outcomes = [
        [
            [(1.0, max(s - 1, 0), -1.0)],
            [(1 - slip, s + 1, 10.0 if s == n - 2 else -1.0), (slip, s, -1.0)],
        ]
        for s in range(n - 1)
    ]
    return FiniteMDP.from_outcomes(
        [*outcomes, [[], []]],
        terminal=np.arange(n) == n - 1,
        start=0,
        **{"discount": 0.9} | settings,
    )


def test_members_are_those_that_are_easier_with_the_familys_mappings():
    target = cr.tasks.pursuit_family(size=3, predators=2)
    candidates = only("member", target)
    assert set(names(candidates)) == {
        "pursuit(size=3, predators=1)",
        "pursuit(size=2)",
        "pursuit(size=2, predators=1)",
    }
    candidate = candidates["pursuit(size=2, predators=1)"]
    declared = family_mappings(target, target.replace(size=2, predators=1))
    assert len(candidate.mappings) == len(declared) == 2
    for mapping, expected in zip(candidate.mappings, declared, strict=True):
        assert (mapping.index == expected.index).all()
    assert candidate.words.endswith("size 2 instead of 3, predators 1 instead of 2")
    with pytest.raises(CurriculumError, match="up to 20,000,000 state-action pairs"):
        source_candidates(cr.tasks.pursuit_family(size=10, predators=2))


def test_a_target_is_cropped_around_its_goal():
    candidates = only("crop", MAZE)
    (treasure,) = [(row, column) for name, row, column in MAZE.objects if name == "treasure"]
    assert len(candidates) >= 6
    for candidate in candidates:
        assert isinstance(candidate.task, GridWorld)
        assert ("treasure", *treasure) in candidate.task.objects
        assert (candidate.mapping.index == same_position(MAZE, candidate.task).index).all()
    sides = {len(candidate.task.map) for candidate in candidates}
    assert sides <= set(range(2, 10))
    assert names(only("crop", cr.tasks.RiverSwim(size=4))) == ["positions 2..3", "positions 1..3"]
    assert names(only("crop", cr.tasks.DeepSea(size=3))) == ["lowest 1 rows", "lowest 2 rows"]
    assert "rows 5..7, columns 5..7" in names(only("crop", cr.tasks.FrozenLake("8x8")))
    assert len(only("crop", cr.tasks.FourRooms(size=9))) > 1


def test_hazards_are_removed_together_and_one_by_one():
    maze = GridWorld(["S.PF", "....", "P..T"])
    candidates = only("removed", maze)
    assert names(candidates)[:3] == ["no hazards", "no fire", "no pit"]
    assert candidates["no hazards"].task.map == ("S...", "....", "...T")
    assert candidates["no pit at (2, 0)"].task.map == ("S.PF", "....", "...T")
    assert candidates["no pit"].mapping.coverage().unmapped == 0
    candidates = only("removed", cr.tasks.FrozenLake("4x4"))
    assert candidates["no hole"].task.map == ("SFFF", "FFFF", "FFFF", "FFFG")
    assert len(candidates) == 5
    candidates = only("removed", Pursuit(size=3, predators=2))
    assert [candidate.task for candidate in candidates] == [Pursuit(size=3, predators=1)]
    read = [dict(candidate.renaming)["predator"] for candidate in candidates["1 predator"].mappings]
    assert read == ["predator_1", "predator_2"]
    rewards = cr.Rewards(pit=5.0)
    with pytest.raises(CurriculumError, match="no candidates of the kinds removed"):
        only("removed", GridWorld(["S.P", "..T"], rewards=rewards))


def test_penalties_are_rewards_below_those_of_most_steps():
    target = cr.tasks.CliffWalking(rows=3, columns=5)
    (candidate,) = only("removed", target)
    assert candidate.name == "no penalties"
    mdp = candidate.task.mdp
    assert set(np.unique(mdp.reward[mdp.outcome_row[~mdp.terminal]])) == {-1.0}
    with pytest.raises(CurriculumError, match="no candidates of the kinds removed"):
        only("removed", chain())


@pytest.mark.parametrize(
    "target", [MAZE, chain(), cr.tasks.RiverSwim(size=9), cr.tasks.Taxi(size=3, stands=2)]
)
def test_start_rings_grow_from_the_goal(target):
    candidates = only("starts", target)
    far = cr.tasks.goal_distance(target, np.flatnonzero(goal_of(target)))
    rings = [far[candidate.task.mdp.start > 0].max() for candidate in candidates]
    assert sorted(rings) == list(range(1, far[target.mdp.start > 0].max()))
    for candidate in candidates:
        live = ~terminal_states(target)
        numbers = np.arange(candidate.mapping.index.size).reshape(candidate.mapping.index.shape)
        assert (candidate.mapping.index[live] == numbers[live]).all()


def goal_of(target):
    if isinstance(target, cr.tasks.RiverSwim):
        return np.arange(target.size) == target.size - 1
    return goal_states(target)


def test_an_end_is_never_merged_with_what_goes_on():
    candidates = only("coarser", GridWorld(["S....", ".....", ".....", "....T"]))
    candidate = candidates["row, column by 2"]
    assert candidate.task.states.names == ("row", "column", "ended")
    assert candidate.task.mdp.terminal.sum() == 1
    assert names(candidates) == ["row, column by 2", "row by 2", "column by 2"]


def proposed(task, name="mine", target=CORRIDOR, mapping=None):
    index = np.full((target.states.size, target.actions.size), UNMAPPED)
    mapping = mapping or cr.transfer.StateActionMapping(target, task, index)
    return SourceCandidate(name, task, mapping)


def test_a_users_candidates_come_first_and_none_of_ours_repeats_them():
    ring_task = cr.tasks.with_start(CORRIDOR, cr.tasks.GoalDistance(1, 2))
    candidates = source_candidates(CORRIDOR, propose=lambda task: [proposed(ring_task)])
    assert names(candidates)[0] == "mine"
    assert "starts 1..2 from the goal" not in names(candidates)
    assert ("starts 1..2 from the goal", "mine") in [(d.name, d.detail) for d in candidates.dropped]


def test_a_renumbered_target_is_no_candidate():
    copy, *_ = renumbered(CORRIDOR.mdp, np.random.default_rng(0))
    with pytest.raises(CurriculumError, match="1 same as the target"):
        source_candidates(CORRIDOR, kinds=[], propose=lambda task: [proposed(copy)])


@pytest.mark.parametrize(
    ("task", "reason"),
    [
        (GridWorld("S#T"), "goal never reached from the start"),
        (GridWorld("S.....T", time_limit=3), "goal never reached from the start"),
        (
            GridWorld("S.FT", rewards=cr.Rewards(fire=-5000, near_fire=0)),
            "goal avoided by every optimal policy",
        ),
        (
            GridWorld("ST", rewards=cr.Rewards(step=0, treasure=0)),
            "nothing to learn: the random policy is optimal",
        ),
        (
            GridWorld("S..T", rewards=cr.Rewards(step=1), discount=1.0, time_limit=None),
            "no exact solution",
        ),
    ],
)
def test_what_cannot_be_learnt_is_dropped(task, reason):
    candidates = source_candidates(CORRIDOR, propose=lambda target: [proposed(task)])
    assert [
        (candidate.name, candidate.reason)
        for candidate in candidates.dropped
        if candidate.kind == "proposed"
    ] == [("mine", reason)]


def proposing(*candidates):
    return lambda: source_candidates(CORRIDOR, propose=lambda target: candidates)


def made(mappings):
    return lambda: SourceCandidate("a", NEAR, mappings)


NEAR = CORRIDOR.crop(rows=(0, 1), columns=(3, 6))
FAR = proposed(NEAR, target=GridWorld("S.T"))
ALONE = cr.tasks.pursuit_family(size=2, predators=1)
LARGE = Pursuit(size=13, predators=1)
REFUSALS = {
    CurriculumError: {
        "family with one member": (lambda: only("member", ALONE), "than the target: pursuit"),
        "no kinds": (lambda: source_candidates(CORRIDOR, kinds=[]), "at least one kind"),
        "propose returns tasks": (proposing(NEAR), "return SourceCandidates: got GridWorld"),
        "one name twice": (proposing(proposed(NEAR), proposed(NEAR)), "'mine' is there twice"),
        "mapping of another target": (proposing(FAR), "must be from the target: one of 'mine'"),
        "mapping to another task": (made(same_position(CORRIDOR, CORRIDOR)), "lead to its task"),
        "no mapping": (made([]), "needs mappings from the target"),
        "unknown": (lambda: source_candidates(CORRIDOR)["far"], "a candidate must be one of rows"),
    },
    TaskError: {
        "family in place of a member": (
            lambda: source_candidates(cr.tasks.pursuit_family),
            "FiniteMDP",
        ),
        "no tables": (lambda: source_candidates(ring()), "has no tables"),
    },
}


@pytest.mark.parametrize(("error", "call", "says"), cases(REFUSALS))
def test_refusals(error, call, says):
    check_refusal(error, call, says)
    wrong = {"kinds": [["crops"], "crop"], "most": [0], "propose": [5, lambda target: None]}
    check_values(CurriculumError, partial(source_candidates, CORRIDOR), wrong)


def test_every_kind_has_its_turn_in_some_target():
    candidates = source_candidates(cr.tasks.frozen_lake_family(map="8x8"), most=7)
    assert {candidate.kind for candidate in candidates} == set(KINDS)
    assert len(KINDS) == 6
    assert all(a.name != b.name for a, b in pairwise(candidates))
    assert source_candidates(GridWorld(["S...", "....", "...T"], discount=1.0)).candidates
    plain = source_candidates(chain())  # a user's table without names
    assert {candidate.kind for candidate in plain} == {"deterministic", "starts"}
    small = cr.Rewards(step=-1e-13, treasure=1e-12)
    assert names(only("starts", GridWorld("S....T", rewards=small)))
