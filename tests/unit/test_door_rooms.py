"""DoorKey rooms as a family: two ways to see them, and how networks read tables."""

import numpy as np
import pytest

from curricle.errors import MappingError
from curricle.transfer import family_mappings
from tests.refusals import check_refusal

pytest.importorskip("minigrid", reason="the extra minigrid is not installed")

from benchmarks.door_rooms import ERRANDS, Room, door_room, errands, within


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
        found = within(size, errand, np.full(3, 9), np.full(3, -9))
        assert found["right"].tolist() == columns
        assert found["down"].tolist() == [-2, -2, -2]


@pytest.mark.parametrize("size", [5, 6, 7])
def test_nothing_is_clipped_in_a_room_but_what_lies_beyond_reach(size):
    for seen in seen_in(size, 500):
        own, unlimited = (ERRANDS.decode(errands(seen, one)) for one in (size, 16))
        assert own == unlimited


def test_only_tables_of_errands_are_read():
    check_refusal(
        MappingError,
        lambda: family_mappings(door_room(size=6), door_room(size=5)),
        "networks read tables of errands",
    )
