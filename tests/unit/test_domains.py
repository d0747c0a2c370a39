"""What holds of every domain: it is a value, keeps its rules, is the same in a file, is drawn."""

import copy
import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from matplotlib.figure import Figure

import curricle as cr
from curricle.errors import ConfigError, TaskError
from curricle.pictures.views import GridView
from curricle.show.plots import draw_potential
from curricle.show.replay import grid_drawing
from curricle.study.record import ViewRecord
from curricle.study_file.schema import tags
from curricle.study_file.task_tables import DOMAIN_TASKS
from curricle.tasks.domain import Domain
from curricle.tasks.family import rules_of
from tests.support.refusals import check_values
from tests.support.studies import only, reader

DOMAINS = {
    "maze": (cr.GridWorld, {"map": "S.FT", "ends": ("treasure",), "start": ((0, 1),)}),
    "frozen_lake": (cr.tasks.FrozenLake, {"map": ("SFH", "FFG"), "slippery": False}),
    "cliff_walking": (cr.tasks.CliffWalking, {"rows": 3, "columns": 5, "start": ((2, 11),)}),
    "taxi": (cr.tasks.Taxi, {"size": 3, "stands": 2, "rainy": True}),
    "pursuit": (cr.Pursuit, {"size": 2, "predators": 1, "torus": True}),
    "four_rooms": (cr.tasks.FourRooms, {"size": 7, "goal": (5, 5), "start": ((1, 1), (1, 4))}),
    "key_lock_pit": (cr.tasks.KeyLockPit, {"map": "S.KL", "keys_held": True}),
    "river_swim": (cr.tasks.RiverSwim, {"size": 4, "start": (1,)}),
    "deep_sea": (cr.tasks.DeepSea, {"size": 4, "slip": 0.25, "start": "uniform"}),
}
"""Type in a study file -> class, and parameters that differ from the defaults."""
NAMES = sorted(DOMAINS)


def made(name):
    """Return a domain as it is by default, with other parameters, and with these again."""
    kind, other = DOMAINS[name]
    default = kind("S.T") if name == "maze" else kind()
    return default, kind(**other), kind(**other)


def test_every_public_domain_is_among_them():
    public = {getattr(cr.tasks, name) for name in cr.tasks.__all__}
    domains = {kind for kind in public if isinstance(kind, type) and issubclass(kind, Domain)}
    assert {kind for kind, _ in DOMAINS.values()} == domains


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_value(name):
    default, task, again = made(name)
    assert task == again != default
    assert len({task, again, default}) == 2
    for copied in (pickle.loads(pickle.dumps(task)), copy.deepcopy(task)):
        assert copied == task
        assert np.array_equal(copied.mdp.next_state, task.mdp.next_state)
        assert not copied.mdp.reward.flags.writeable
    assert eval(repr(task), vars(cr.tasks)) == task


@pytest.mark.parametrize("name", NAMES)
def test_each_field_is_held_to_its_annotation(name):
    """A value just within a range is taken, one beyond or of another type is refused by name."""
    task, checked = made(name)[1], 0
    wrong = {int: [0.5, "4", None], float: ["x", float("nan")], bool: [1, "yes"]}
    for field, (kind, rule, optional) in rules_of(type(task)).items():
        if field not in type(task).__dataclass_fields__ or kind not in wrong:
            continue
        values = [value for value in wrong[kind] if value is not None or not optional]
        values += [] if rule.low is None else [rule.low - 1]
        values += [] if rule.high is None else [rule.high + 1]
        check_values(TaskError, partial(replace, task), {field: values})
        checked += len(values)
    assert checked >= 7  # those of discount and time_limit alone


@pytest.mark.parametrize("name", NAMES)
def test_tables_and_spaces_agree(name):
    for task in made(name)[:2]:
        assert (task.mdp.states, task.mdp.actions) == (task.states, task.actions)
        assert (task.mdp.discount, task.mdp.time_limit) == (task.discount, task.time_limit)
        if name != "pursuit":
            assert task.layout.cells.shape == (task.states.size, 2)


@pytest.mark.parametrize("name", sorted({*NAMES} - {"cliff_walking", "pursuit", "taxi"}))
def test_a_uniform_start_is_anywhere_but_at_an_end(name):
    task = made(name)[0].with_start("uniform")
    alive = ~task.mdp.terminal
    assert task.mdp.start == pytest.approx(alive / alive.sum())


IN_FILES = sorted(tags(DOMAIN_TASKS))
"""Types in a study file whose keys are those of the class."""


@pytest.mark.parametrize("name", IN_FILES)
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
        ('type = "four_rooms", goal = 3', "goal must be a hallway or a list of a row and a column"),
        ('type = "four_rooms", goal = [1]', "goal[1] is missing"),
        ('type = "deep_sea", start = [[0, "x"]]', "start[0][1] must be a whole number: got 'x'"),
        ('type = "river_swim", start = true', "start must be 'uniform' or a list of positions"),
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


@pytest.mark.parametrize("name", sorted({*NAMES} - {"pursuit"}))
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
