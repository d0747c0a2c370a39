"""A renumbered crop is found again in its renumbered maze."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import MappingError
from curricle.paper import mazes
from curricle.paper.settings import maze
from curricle.transfer import TaskPair, auto_mapping, by_common_part, score_mapping
from tests.renumbering import renumbered

MAZE = maze(-5)
CROP = mazes.corner(MAZE, 5)


def renumbered_crop(seed):
    """Return the maze and the crop, renumbered, and the crop's state for each of the maze's."""
    rng = np.random.default_rng(seed)
    target, new, _ = renumbered(MAZE.mdp, rng)
    source, there, _ = renumbered(CROP.mdp, rng)
    by_hand = CROP.states_at(MAZE.cells[:, 0], MAZE.cells[:, 1])
    truth = np.full(len(new), -1)
    truth[new] = np.where(by_hand >= 0, there[by_hand], -1)
    return target, source, truth


@pytest.mark.parametrize("seed", range(4))
def test_a_renumbered_crop_is_found_in_its_maze(seed):
    target, source, truth = renumbered_crop(seed)
    best = auto_mapping(target, source)
    assert best.how.startswith("common part")
    by_hand = score_mapping(cr.same_position(MAZE, CROP))
    assert best.scores.regained >= 0.95 * by_hand.regained
    state = np.where(best.mapping.index >= 0, best.mapping.index // 4, -1)
    inside = (truth >= 0) & ~target.terminal
    assert (state[inside] == truth[inside, None]).all()


def test_parts_are_one_to_one_and_agree_in_reward():
    target, source, _ = renumbered_crop(0)
    proposal = next(iter(by_common_part(TaskPair(target, source))))
    pairs = np.argwhere(proposal.mapping.index >= 0)
    read = {(int(s), int(proposal.mapping.index[s, a]) // 4) for s, a in pairs}
    assert len({s for s, _ in read}) == len({u for _, u in read}) == len(read)


def test_equal_searches_agree():
    target, source, _ = renumbered_crop(1)
    one, other = (
        [each.mapping.index for each in by_common_part(TaskPair(target, source))] for _ in range(2)
    )
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_refusals():
    with pytest.raises(MappingError, match="deterministic tasks: one is random"):
        list(by_common_part(TaskPair(MAZE, cr.Pursuit(2, 1))))
    poor = cr.GridWorld("S.T", rewards=cr.Rewards(step=-7, treasure=3, pit=-8))
    with pytest.raises(MappingError, match="no reward in common"):
        list(by_common_part(TaskPair(MAZE, poor)))
    large = cr.GridWorld(["." * 20] * 20 + ["S" + "." * 18 + "T"])
    with pytest.raises(MappingError, match="sources of up to 250 states: got 420"):
        list(by_common_part(TaskPair(large, large)))
