"""The studies of networks under benchmarks: DoorKey rooms by their errands, and what files say."""

from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.study.arms import Arms

pytest.importorskip("minigrid", reason="the extra minigrid is not installed")

from benchmarks.networks.door_rooms import ERRANDS, Room, errands, within
from benchmarks.networks.miniatures import ALL, study_of

FOLDER = Path(__file__).parents[2] / "benchmarks" / "networks"


def seen_in(size, steps=2000):
    """Yield what is seen of a room on random steps."""
    room, draws = Room(size), np.random.default_rng(size)
    seen, _ = room.reset(seed=size)
    for _ in range(steps):
        yield seen
        seen, _, terminated, truncated, _ = room.step(draws.integers(5))
        if terminated or truncated:
            seen, _ = room.reset()


def test_offsets_are_clipped_to_what_a_room_can_hold():
    errand = np.arange(3)
    for size, columns in ((5, [0, 1, 2]), (6, [1, 2, 2]), (8, [2, 2, 2])):
        offsets = within(size, errand, np.full(3, 9), np.full(3, -9))
        assert offsets["right"].tolist() == columns
        assert offsets["down"].tolist() == [-2, -2, -2]


@pytest.mark.parametrize("size", [5, 6, 7])
def test_nothing_is_clipped_in_a_room_but_what_lies_beyond_reach(size):
    for seen in seen_in(size, 500):
        own, unlimited = (ERRANDS.decode(errands(seen, side)) for side in (size, 16))
        assert own == unlimited


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.toml")), ids=lambda file: file.stem)
def test_the_studies_of_networks_have_arms_that_are_compared_if_the_file_says_so(file):
    study = cr.read_study(file)
    pytest.importorskip("stable_baselines3", reason="the extra deep is not installed")
    assert bool(Arms.of(study).total) == study.compared


@pytest.mark.parametrize("target", ALL)
def test_the_study_of_miniatures_has_changes_for_every_target(target):
    study = study_of(target, seeds=2)
    assert study.arms["distilled"].tasks["target"].id in ALL[target][0]
