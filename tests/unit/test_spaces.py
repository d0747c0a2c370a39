"""Spaces of named components: numbering, look-up, printing."""

import numpy as np
import pytest

from curricle import Component, Space
from curricle.errors import TaskError

BOX = Space([Component("row", 2, low=5), Component("column", 3)])
LISTED = Space(
    [Component("x", 3, low=-1), Component("y", 2)], points=[[1, 0], [-1, 1], [0, 0], [1, 1]]
)


def test_encode_broadcasts_and_decode_keeps_the_shape():
    numbers = BOX.encode(row=np.array([[5], [6]]), column=np.arange(3)[None, :])
    assert numbers.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert BOX.decode(numbers)["column"].shape == (2, 3)
    assert BOX.encode(row=6, column=2).shape == ()
    assert LISTED.encode(x=[[1], [0]], y=[[0, 1]]).tolist() == [[0, 3], [2, -1]]


def test_points_print_and_components_are_found_by_name():
    move = Component("move", 2, low=1, labels=("left", "right"))
    assert Space([move, Component("n", 2)]).label(2) == "move=right n=0"
    assert LISTED.label(1) == "x=-1 y=1"
    assert BOX.component("row").low == 5
    with pytest.raises(TaskError, match=r"one of row, column: got 'z'"):
        BOX.component("z")


def test_spaces_are_equal_when_components_and_points_are():
    again = Space([Component("row", 2, low=5), Component("column", 3)])
    assert again == BOX
    assert hash(again) == hash(BOX)
    assert Space(BOX.components, points=[[5, 0]]) != BOX
    assert Space(LISTED.components, points=[[1, 0]]) != LISTED
    assert Space([Component("row", 2), Component("column", 3)]) != BOX
    assert BOX != "a space"
