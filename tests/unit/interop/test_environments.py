"""Tasks as Gymnasium environments: the contract, the ends of episodes, the forms, the pictures."""

import subprocess
import sys
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from curricle import Component, FiniteMDP, GridWorld, Pursuit, Rewards, Space, from_gymnasium
from curricle.errors import SettingError, TaskError
from curricle.interop import register
from curricle.interop.gymnasium import to_gymnasium
from curricle.tasks.mdp import generative_model
from tests.support.refusals import check_values

from .environments import TASKS, WALLED

register()
IDS = ("Curricle/Maze-v0", "Curricle/Pursuit-v0")
NORTH, EAST, SOUTH, WEST = range(4)


def going_on(task):
    """The states in which an episode may start, as far as the task can tell."""
    terminal = generative_model(task).terminal
    return range(task.states.size) if terminal is None else np.flatnonzero(~terminal).tolist()


@pytest.mark.parametrize("form", ["index", "components"])
@pytest.mark.parametrize("name", IDS)
def test_registered_ids_pass_gymnasiums_checks(name, form):
    made = gymnasium.make(name, observation=form, action=form)
    check_env(made.unwrapped)  # pictures of every mode included; a warning would be an error


@pytest.mark.parametrize("form", ["index", "components"])
@pytest.mark.parametrize("name", TASKS)
def test_every_kind_of_task_passes_gymnasiums_checks(name, form):
    # Other modes of rendering are only checked of environments with an id.
    environment = to_gymnasium(TASKS[name], observation=form, render_mode="rgb_array")
    check_env(environment, skip_render_check=True)


@pytest.mark.parametrize("form", ["index", "components"])
@pytest.mark.parametrize("name", IDS)
def test_registered_ids_pass_stable_baselines_checks(name, form):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gymnasium.make(name, observation=form, action=form), warn=True)


def test_ids_are_made_by_module_too_and_with_a_task_s_own_settings():
    maze = gymnasium.make("curricle:Curricle/Maze-v0", map="S..T", rewards={"step": -5}).unwrapped
    assert maze.task == GridWorld("S..T", rewards=Rewards(step=-5))
    hunt = gymnasium.make("Curricle/Pursuit-v0", size=5, predators=3, capture="any").unwrapped
    assert hunt.task == Pursuit(5, 3, capture="any")


def test_registering_imports_nothing_heavy():
    code = (
        "import sys; from curricle.interop import register; register(); "
        "sys.exit(bool({'numba', 'PIL', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_ends_are_told_apart_and_the_tasks_own_limit_is_the_only_one():
    environment = to_gymnasium(GridWorld("S.T", time_limit=2))
    environment.reset()
    assert environment.step(WEST)[2:4] == (False, False)
    assert environment.step(WEST)[2:4] == (False, True)
    environment.reset()
    environment.step(EAST)
    assert environment.step(EAST)[2:4] == (True, False)  # the last step allowed is an end
    made = gymnasium.make("Curricle/Maze-v0", map="S.T", time_limit=3)
    assert made.spec.max_episode_steps is None
    made.reset()
    assert [made.step(WEST)[3] for _ in range(3)] == [False, False, True]
    endless = to_gymnasium(GridWorld("S.T", time_limit=None))
    endless.reset()
    assert not any(endless.step(WEST)[3] for _ in range(300))


@pytest.mark.parametrize(
    "start", [118, np.int64(118), {"prey": 1, "predator_1": "(1,1)", "predator_2": np.int32(1)}]
)
def test_a_start_can_be_named(start):
    hunt = Pursuit(3, 2, capture="all")
    if isinstance(start, dict):
        assert hunt.states.encode(prey=1, predator_1=4, predator_2=1) == 118
    state, info = to_gymnasium(hunt).reset(options={"state": start})
    assert state == info["state"] == 118


def test_a_step_needs_an_episode():
    environment = to_gymnasium(GridWorld("ST"))
    for _ in range(2):
        with pytest.raises(SettingError, match="reset"):
            environment.step(EAST)
        environment.reset()
        environment.step(EAST)
    with pytest.raises(SettingError, match="first reset"):
        _ = to_gymnasium(GridWorld("ST")).state


@pytest.mark.parametrize("name", TASKS)
def test_observation_and_label_are_those_of_the_state(name):
    task = TASKS[name]
    low = [part.low for part in task.states.components]
    by_index = to_gymnasium(task)
    by_part = to_gymnasium(task, observation="components")
    for state in going_on(task):
        index, info = by_index.reset(options={"state": state})
        parts, same = by_part.reset(options={"state": state})
        assert index == state
        assert info == same == {"state": state, "label": task.states.label(state)}
        assert (parts + low).tolist() == [int(v) for v in task.states.decode(state).values()]
        assert by_part.observation_space.contains(parts)


def test_joint_actions_can_be_given_by_component():
    hunt = Pursuit(4, 2)
    joint, apart = to_gymnasium(hunt), to_gymnasium(hunt, action="components")
    for action in range(hunt.actions.size):
        joint.reset(seed=action)
        apart.reset(seed=action)
        moves = np.array([hunt.actions.decode(action)[name] for name in hunt.actions.names])
        assert joint.step(action) == apart.step(moves)


def test_wrong_values_are_refused():
    moves = Space([Component("x", 2), Component("y", 2)], points=[[0, 1], [1, 0]])
    settings = {"terminal": [0, 0], "start": 0, "discount": 0.5, "actions": moves}
    task = FiniteMDP.from_dense(np.full((2, 2, 2), 0.5), np.zeros((2, 2)), **settings)
    with pytest.raises(SettingError, match="every combination"):
        to_gymnasium(task, action="components")
    for options in ({"start": 1}, {"state": 2}, {"state": -1}, {"state": 3}):
        with pytest.raises(SettingError, match=r"hold only 'state'|not terminal|at least 0"):
            to_gymnasium(GridWorld("S.T")).reset(options=options)
    with pytest.raises(TaskError, match="column runs from 0 to 2: got 9"):
        to_gymnasium(GridWorld("S.T")).reset(options={"state": {"row": 0, "column": 9}})
    for form, actions in (("index", [25, [1, 2]]), ("components", [[1, 5], [1, 2, 3]])):
        environment = to_gymnasium(Pursuit(3, 2), action=form)
        environment.reset()
        for action in actions:
            with pytest.raises(SettingError, match="must lie in"):
                environment.step(action)
    settings = {key: ["pixels"] for key in ("observation", "action", "render_mode")}
    check_values(SettingError, partial(to_gymnasium, WALLED), settings)
    blackjack = from_gymnasium("Blackjack-v1", discount=1.0, time_limit=100)
    with pytest.raises(TaskError, match="is an environment already"):
        to_gymnasium(blackjack)
