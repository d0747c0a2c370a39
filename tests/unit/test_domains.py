"""What holds of every domain: it is a value, is the same in a file, and is drawn."""

import copy
import pickle

import numpy as np
import pytest
from matplotlib.figure import Figure

import curricle as cr
from curricle.errors import ConfigError
from curricle.show.grids import draw_potential
from curricle.show.replay import grid_drawing
from curricle.show.views import GridView
from curricle.study.record import ViewRecord
from tests.studies import only, reader

DOMAINS = {
    "four_rooms": (cr.tasks.FourRooms, {"size": 7, "goal": (5, 5), "start": ((1, 1), (1, 4))}),
    "key_lock_pit": (cr.tasks.KeyLockPit, {"map": "S.KL", "needs": ((1,),), "keys_held": True}),
    "block_dude": (cr.tasks.BlockDude, {"level": "E.B<", "exit_reward": 1.0}),
    "river_swim": (cr.tasks.RiverSwim, {"size": 4, "start": (1,)}),
    "deep_sea": (cr.tasks.DeepSea, {"size": 4, "slip": 0.25, "start": "uniform"}),
}
"""Type in a study file -> class, and parameters that differ from the defaults."""
NAMES = sorted(DOMAINS)


def made(name):
    """Return a domain by default, one with other parameters, and that one again."""
    kind, other = DOMAINS[name]
    return kind(), kind(**other), kind(**other)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_value(name):
    default, one, again = made(name)
    assert one == again != default
    assert len({one, again, default}) == 2
    for copied in (pickle.loads(pickle.dumps(one)), copy.deepcopy(one)):
        assert copied == one
        assert np.array_equal(copied.mdp.next_state, one.mdp.next_state)
        assert not copied.mdp.reward.flags.writeable
    assert eval(repr(one), vars(cr.tasks)) == one


@pytest.mark.parametrize("name", NAMES)
def test_tables_and_spaces_agree(name):
    for task in made(name)[:2]:
        assert (task.mdp.states, task.mdp.actions) == (task.states, task.actions)
        assert (task.mdp.discount, task.mdp.time_limit) == (task.discount, task.time_limit)
        assert task.layout.cells.shape == (task.states.size, 2)


@pytest.mark.parametrize("name", NAMES)
def test_a_uniform_start_is_anywhere_but_at_an_end(name):
    task = made(name)[0].with_start("uniform")
    alive = ~task.mdp.terminal
    assert task.mdp.start == pytest.approx(alive / alive.sum())


@pytest.mark.parametrize("name", NAMES)
def test_it_is_the_same_in_a_study_file(name, tmp_path):
    kind, other = DOMAINS[name]
    keys = "\n".join(f"{key} = {toml(value)}" for key, value in other.items())
    text = f'name = "one"\n[tasks.one]\ntype = "{name}"\n{keys}\n'
    study = reader(tmp_path)(text)
    assert only(study, *study.arms).tasks["one"] == kind(**other)
    again = type(study).from_data(study.to_data(), tmp_path)
    assert only(again, *again.arms).tasks["one"] == kind(**other)
    plain = reader(tmp_path)(f'name = "one"\n[tasks.one]\ntype = "{name}"\n')
    assert only(plain, *plain.arms).tasks["one"] == kind()


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('type = "key_lock_pit", needs = 3', "needs must be 'all' or a list of keys for each lock"),
        ('type = "key_lock_pit", needs = [["a"]]', "needs[0][0] must be a whole number: got 'a'"),
        ('type = "four_rooms", goal = 3', "goal must be a hallway or a list of a row and a column"),
        ('type = "four_rooms", goal = [1]', "goal[1] is missing"),
        ('type = "deep_sea", start = [[0, "x"]]', "start[0][1] must be a whole number: got 'x'"),
        ('type = "river_swim", start = true', "start must be 'uniform' or a list of positions"),
        ('type = "pursuit", prey = [["a"]]', "prey[0][0] must be a number: got 'a'"),
    ],
)
def test_what_is_no_word_and_no_list_is_refused_in_one_sentence(tmp_path, keys, said):
    with pytest.raises(ConfigError) as caught:
        reader(tmp_path)(f'name = "one"\ntasks.one = {{ {keys} }}\n')
    (line,) = str(caught.value).splitlines()
    assert f"line 2: tasks.one.{said}" in line


def toml(value):
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(map(toml, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_drawn(name):
    task = made(name)[0]
    solution = cr.solve(task)
    for view in (GridView.of(task), GridView.for_replay(task)):
        assert view.is_map
        assert view.directions is not None
        assert len(set(map(tuple, view.cells.tolist()))) == len(view.states)
        assert (task.layout.cells[view.states] == view.cells).all()
    read = ViewRecord.model_validate_json(ViewRecord.of(view).model_dump_json()).view
    drawn = grid_drawing(view)
    assert grid_drawing(read) == drawn
    assert drawn["markers"][0][0] == "A"
    rows, columns = view.shape
    for marker in view.markers:
        assert marker.cells.shape == (task.states.size,)
        assert marker.cells.max() < rows * columns
    axes = Figure().subplots()
    image = draw_potential(axes, task, solution.values, label="V*")
    shown = image.get_array().compressed()
    alive = view.states[~view.ended]
    assert sorted(shown) == pytest.approx(sorted(solution.values[alive]))
