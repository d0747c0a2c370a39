"""Tables of an environment in a file."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import StoreError
from curricle.files import read_saved, write_saved
from curricle.interop import TabulatedTask
from tests.support.worlds_to_tabulate import Corridor

KIND = TabulatedTask.__name__


def lamps(**settings):
    return cr.tabulate(Corridor, discount=0.5, seeds=2, **settings)


@pytest.mark.parametrize(
    "make",
    [lamps, lambda: cr.tabulate("Taxi-v4", discount=0.9, seeds=3, action_masks=True)],
    ids=["copies", "masks"],
)
def test_tables_are_read_again(tmp_path, make):
    task = make()
    again = TabulatedTask.load(task.save(tmp_path / "tables"))
    assert [path.name for path in tmp_path.iterdir()] == ["tables.npz"]
    for name in ("probability", "next_state", "reward", "terminal", "start", "outcome_row"):
        table = getattr(task.mdp, name)
        np.testing.assert_array_equal(table, getattr(again.mdp, name))
        assert table.dtype == getattr(again.mdp, name).dtype
    assert (task.mdp.available is None) == (again.mdp.available is None)
    if task.mdp.available is not None:
        np.testing.assert_array_equal(task.mdp.available, again.mdp.available)
    assert (task.states, task.actions, task.record) == (again.states, again.actions, again.record)
    assert (task.mdp.discount, task.mdp.time_limit) == (again.mdp.discount, again.mdp.time_limit)
    assert [*task.observations.parts] == [*again.observations.parts]
    for name, part in task.observations.parts.items():
        np.testing.assert_array_equal(part, again.observations.parts[name])
        assert part.dtype == again.observations.parts[name].dtype


def test_a_damaged_file_is_refused_and_left_alone(tmp_path):
    path = lamps().save(tmp_path / "lamps")
    whole, about = path.read_bytes(), read_saved(path, KIND).about
    for content in (b"", whole[: len(whole) // 2], whole[:100] + b"x" + whole[101:]):
        path.write_bytes(content)
        with pytest.raises(StoreError, match="was changed since, cut off, or"):
            TabulatedTask.load(path)
        assert path.read_bytes() == content
    del about["kind"], about["format"]
    write_saved(path, KIND, {}, about)
    with pytest.raises(StoreError, match="is not as save\\(\\) writes it"):
        TabulatedTask.load(path)
