"""Pursuit as a PettingZoo environment, and what its agents know from hunting alone."""

import subprocess
import sys
import warnings

import numpy as np
import pytest

from curricle import Pursuit, solve
from curricle.errors import MappingError, SettingError
from curricle.interop.environment import to_gymnasium
from curricle.interop.pettingzoo import agent_mappings, to_pettingzoo

pytest.importorskip("pettingzoo")
with warnings.catch_warnings():
    # PettingZoo's tests import a game of its own in a way that it deprecates itself.
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from pettingzoo.utils import parallel_to_aec

FORMS = ["index", "components"]
STAY, NORTH, EAST, SOUTH, WEST = range(5)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("predators", [1, 2, 3, 4])
def test_environments_pass_pettingzoos_checks(predators, form):
    hunt = Pursuit(3, predators)
    parallel_api_test(to_pettingzoo(hunt, observation=form))
    parallel_seed_test(lambda: to_pettingzoo(hunt, observation=form))


@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array")  # but a state's number
def test_agents_may_take_turns_too():
    api_test(parallel_to_aec(to_pettingzoo(Pursuit(3, 2), render_mode="ansi")), num_cycles=50)


def test_agents_have_the_names_of_the_task():
    assert to_pettingzoo(Pursuit(3, 1)).possible_agents == ["predator"]
    hunt = to_pettingzoo(Pursuit(3, 3))
    assert hunt.possible_agents == ["predator_1", "predator_2", "predator_3"]
    assert hunt.agents == []  # none before the first episode
    hunt.reset()
    assert hunt.agents == hunt.possible_agents


def test_each_agent_sees_itself_first():
    hunt = to_pettingzoo(Pursuit(4, 3), observation="components")
    cells = {"prey": 2, "predator_1": 11, "predator_2": 12, "predator_3": 13}
    seen, _ = hunt.reset(options={"state": cells})
    assert {agent: view.tolist() for agent, view in seen.items()} == {
        "predator_1": [11, 2, 12, 13],
        "predator_2": [12, 2, 11, 13],
        "predator_3": [13, 2, 11, 12],
    }
    assert hunt.state().tolist() == [2, 11, 12, 13]
    assert hunt.state_space.contains(hunt.state())


@pytest.mark.parametrize("form", FORMS)
def test_agents_together_are_the_joint_environment(form):
    hunt = Pursuit(3, 2, time_limit=15)
    apart, joint = to_pettingzoo(hunt, observation=form), to_gymnasium(hunt)
    rng = np.random.default_rng(0)
    ends = set()
    for seed in range(20):
        seen, infos = apart.reset(seed=seed)
        joint.reset(seed=seed)
        while apart.agents:
            moves = rng.integers(5, size=2)
            outcomes = apart.step(dict(zip(apart.agents, moves, strict=True)))
            state, *expected, info = joint.step(
                hunt.actions.encode(predator_1=moves[0], predator_2=moves[1])
            )
            seen, *told, infos = outcomes
            for agent in apart.possible_agents:
                assert [each[agent] for each in told] == expected
                assert infos[agent] == info
                if form == "index":
                    assert seen[agent] == state
        assert expected[1] or expected[2]
        ends.add(tuple(expected[1:]))
    assert ends == {(True, False), (False, True)}  # captures and cuts both came


def test_what_one_agent_is_given_is_its_own():
    hunt = to_pettingzoo(Pursuit(3, 2), observation="components")
    seen, infos = hunt.reset(seed=0)
    kept = seen["predator_2"].copy(), dict(infos["predator_2"])
    seen["predator_1"][:] = 0
    infos["predator_1"].clear()
    assert np.array_equal(seen["predator_2"], kept[0])
    assert infos["predator_2"] == kept[1]


@pytest.mark.parametrize(
    "actions",
    [{}, {"predator_1": 0}, {"predator_1": 0, "predator_2": 0, "predator_3": 0}],
)
def test_every_agent_must_act(actions):
    hunt = to_pettingzoo(Pursuit(3, 2))
    hunt.reset()
    with pytest.raises(SettingError, match="each of predator_1, predator_2"):
        hunt.step(actions)


def test_moves_outside_the_space_and_outside_episodes_are_refused():
    hunt = to_pettingzoo(Pursuit(3, 1, moves=4))
    with pytest.raises(SettingError, match="no agents"):
        hunt.step({"predator": 0})
    with pytest.raises(SettingError, match="first reset"):
        hunt.state()
    hunt.reset()
    with pytest.raises(SettingError, match="must lie in"):
        hunt.step({"predator": 4})


def test_unknown_settings_are_refused():
    with pytest.raises(SettingError, match="must be a Pursuit"):
        to_pettingzoo("hunt")
    for setting in ("observation", "render_mode"):
        with pytest.raises(SettingError, match=f"{setting} must be one of"):
            to_pettingzoo(Pursuit(3, 2), **{setting: "pixels"})


@pytest.mark.parametrize("mode", ["rgb_array", "ansi"])
def test_it_is_drawn_as_the_joint_environment_is(mode):
    hunt = Pursuit(3, 2)
    apart, joint = to_pettingzoo(hunt, render_mode=mode), to_gymnasium(hunt, render_mode=mode)
    apart.reset(seed=5)
    joint.reset(seed=5)
    assert np.array_equal(apart.render(), joint.render())


def test_without_pettingzoo_the_error_names_the_extra():
    code = """
import sys
sys.modules["pettingzoo"] = None  # as if it were not installed
from curricle import Pursuit
from curricle.interop.pettingzoo import agent_mappings, to_pettingzoo
assert agent_mappings(Pursuit(3, 2), Pursuit(3, 1))
to_pettingzoo(Pursuit(3, 2))
"""
    tried = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True
    )
    assert tried.stderr.splitlines()[-1] == (
        'ImportError: PettingZoo is not installed: pip install "curricle[agents]"'
    )


# -- one agent's values ------------------------------------------------------------------------


def test_an_agent_reads_the_source_as_if_it_were_alone():
    hunt, chase = Pursuit(3, 3), Pursuit(3, 1)
    q = solve(chase).action_values
    where, moves = hunt.states.decode(), hunt.actions.decode()
    mappings = agent_mappings(hunt, chase)
    assert list(mappings) == list(hunt.predator_names)
    for agent, mapping in mappings.items():
        alone = chase.states.encode(prey=where["prey"], predator=where[agent])
        assert np.array_equal(mapping.read(q), q[alone[:, None], moves[agent][None, :]])


def test_a_source_has_one_predator():
    with pytest.raises(MappingError, match="'predator'"):
        agent_mappings(Pursuit(3, 2), Pursuit(3, 2))


def test_a_smaller_source_leaves_cells_unmapped():
    mapping = agent_mappings(Pursuit(4, 2), Pursuit(3, 1), unmapped_value=-9.0)["predator_2"]
    far = Pursuit(4, 2).states.encode(prey=1, predator_1=0, predator_2=15)
    assert (mapping.read(np.zeros((81, 5)))[far] == -9).all()


def mean_length(hunt, choose, episodes):
    """The mean number of steps of an episode in which each agent chooses by itself."""
    environment, steps = to_pettingzoo(hunt), 0
    for seed in range(episodes):
        seen, _ = environment.reset(seed=seed)
        while environment.agents:
            actions = {agent: choose(agent, seen[agent]) for agent in environment.agents}
            seen, *_ = environment.step(actions)
            steps += 1
    return steps / episodes


def test_agents_that_each_hunt_as_if_alone_do_far_better_than_random_ones():
    hunt, chase = Pursuit(4, 2), Pursuit(4, 1)
    alone = solve(chase).action_values
    own_moves = hunt.actions.decode()
    choice = {
        agent: own_moves[agent][mapping.read(alone).argmax(axis=1)]
        for agent, mapping in agent_mappings(hunt, chase).items()
    }
    rng = np.random.default_rng(0)
    guided = mean_length(hunt, lambda agent, state: choice[agent][state], 300)
    random_return = mean_length(hunt, lambda agent, state: rng.integers(5), 100)
    assert guided < 8  # about 5 steps; the optimum together is 4.6
    assert random_return > 10 * guided
