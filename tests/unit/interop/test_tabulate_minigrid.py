"""Tables of MiniGrid's levels, beside searches and copies that know nothing of them."""

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from benchmarks.minigrid_levels import shortest
from curricle.errors import TaskError
from curricle.interop import MiniGridState
from curricle.transfer import UNMAPPED

minigrid = pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
LEVELS = {
    "MiniGrid-DoorKey-6x6-v0": 3,
    "MiniGrid-MultiRoom-N4-S5-v1": 7,
    "MiniGrid-KeyCorridorS3R2-v0": 5,
    "MiniGrid-LavaCrossingS9N2-v0": 1,
    "MiniGrid-FourRooms-v0": 4,
    "MiniGrid-Unlock-v0": 9,
}


def optimal_length(task):
    """The steps of the optimal policy, followed in the table."""
    solution = cr.solve(task)
    (state,) = np.flatnonzero(task.mdp.start)
    for steps in range(task.states.size + 1):
        if task.mdp.terminal[state]:
            return steps
        action = solution.action_values[state].argmax()
        state = task.mdp.next_state[task.mdp.outcome_row[state, action], 0]
    raise AssertionError("the optimal policy goes round")


@pytest.mark.parametrize(("name", "seed"), LEVELS.items())
def test_optimal_lengths_are_those_found_by_hand(name, seed):
    task = cr.tabulate(name, discount=0.99, seeds=[seed])
    with gym.make(name) as env:
        env.reset(seed=seed)
        length = shortest(env)
    assert task.exact
    assert task.record.cut == task.record.drawing == 0
    assert cr.solve(task).start_value == pytest.approx(0.99 ** (length - 1), abs=1e-9)
    assert optimal_length(task) == length
    assert task.mdp.time_limit == env.unwrapped.max_steps


@pytest.mark.parametrize("name", ["MiniGrid-DoorKey-5x5-v0", "MiniGrid-LavaGapS5-v0"])
def test_the_fast_way_gives_the_tables_of_copies(name):
    def make():  # the whole grid is seen
        return minigrid.wrappers.FullyObsWrapper(gym.make(name))

    fast, copies = (
        cr.tabulate(make, discount=0.9, state=MiniGridState(copies=way)) for way in (False, True)
    )
    assert fast.states.size >= copies.states.size  # copies that are alike are one
    counterparts = copies.many(fast.observations.batch())
    unique = counterparts != UNMAPPED
    assert unique.mean() > 0.1
    values, known = cr.solve(fast).values, cr.solve(copies).values
    np.testing.assert_allclose(values[unique], known[counterparts[unique]], atol=1e-9)
    assert set(values.round(9)) == set(known.round(9))


def test_states_are_named_after_what_is_in_the_level():
    task = cr.tabulate("MiniGrid-DoorKey-5x5-v0", discount=0.9)
    assert task.states.names == ("x", "y", "direction", "door", "key_x", "key_y")
    assert task.states.component("door").labels[0] == "locked"
    assert [task.actions.label(a) for a in (2, 3)] == ["action=forward", "action=pickup"]
    carried = task.states.decode()["key_x"] == -1
    assert carried.any()
    locked = task.states.decode()["door"] == 0
    assert not task.mdp.terminal[locked].any()


def test_the_reward_of_minigrid_itself_is_paid_where_time_is_part_of_the_state():
    timed = cr.tabulate("MiniGrid-Empty-5x5-v0", discount=0.9, state=MiniGridState(own_reward=True))
    # Two steps, a turn and two steps: the goal at the fifth of 100.
    assert cr.solve(timed).start_value == pytest.approx(0.9**4 * (1 - 0.9 * 5 / 100))
    assert timed.states.component("step").size == 101
    last = timed.states.decode()["step"] == 100
    assert timed.record.cut == (last & ~timed.mdp.terminal).sum() > 0


def test_resets_that_make_one_level_share_its_states():
    same = cr.tabulate("MiniGrid-Empty-Random-5x5-v0", discount=0.9, seeds=5)
    assert same.states.names == ("x", "y", "direction")
    starts = set()
    for seed in range(5):
        with gym.make("MiniGrid-Empty-Random-5x5-v0") as env:
            env.reset(seed=seed)
            base = env.unwrapped
            starts.add((*map(int, base.agent_pos), base.agent_dir))
    assert (same.mdp.start > 0).sum() == len(starts) > 1
    several = cr.tabulate("MiniGrid-DoorKey-5x5-v0", discount=0.9, seeds=3)
    task = cr.tabulate("MiniGrid-DoorKey-5x5-v0", discount=0.9, seeds=[1])
    assert several.states.names[0] == "level"
    begins = np.flatnonzero(several.mdp.start)
    assert begins.size == 3
    values = cr.solve(several).values[begins]
    assert cr.solve(task).start_value == pytest.approx(values[1])


@pytest.mark.parametrize("wrapper", ["FullyObsWrapper", "ImgObsWrapper"])
def test_observations_are_those_of_the_environment(wrapper):
    def make():
        return getattr(minigrid.wrappers, wrapper)(gym.make("MiniGrid-DoorKey-5x5-v0"))

    task = cr.tabulate(make, discount=0.9)
    with make() as env:
        state, (seen, _), over = int(np.flatnonzero(task.mdp.start)[0]), env.reset(seed=0), False
        for action in np.random.default_rng(0).integers(7, size=200).tolist():
            kept = task.observations.batch([state])
            parts = [(seen, kept)]
            if isinstance(seen, dict):
                parts = [(seen[name], kept[name]) for name in seen]
            assert all(np.array_equal(part, stored[0]) for part, stored in parts)
            if wrapper == "FullyObsWrapper" and not task.observations.ambiguous[state]:
                assert task.state(seen) == state
            if over:
                break
            seen, _, over, _, _ = env.step(action)
            state = task.mdp.next_state[task.mdp.outcome_row[state, action], 0]
            assert over == task.mdp.terminal[state]


class Notes(minigrid.envs.EmptyEnv):
    """Keeps a list of what was toggled, which must not be empty at the goal."""

    def __init__(self, **settings):
        super().__init__(size=4, **settings)

    def reset(self, **settings):
        self.notes = []
        return super().reset(**settings)

    def step(self, action):
        if action == 5 and not self.notes and self.worth_noting():
            self.notes.append(action)
        seen, reward, *rest = super().step(action)
        return seen, reward * len(self.notes), *rest

    def worth_noting(self):
        return True


class FarNotes(Notes):
    """Notes it only where random steps hardly get to."""

    def __init__(self, **settings):
        minigrid.envs.EmptyEnv.__init__(self, size=8, **settings)

    def worth_noting(self):
        return tuple(map(int, self.agent_pos)) == (6, 5)


class Rebound(FarNotes):
    """Puts another list in the place of the first."""

    def step(self, action):
        if action == 5 and not self.notes and self.worth_noting():
            self.notes = [action]
        return super().step(action)


class Equal(minigrid.envs.DoorKeyEnv):
    """Puts an equal list in the place of the first."""

    def __init__(self, **settings):
        super().__init__(size=5, **settings)

    def reset(self, **settings):
        self.path = [0, 1]
        return super().reset(**settings)

    def step(self, action):
        self.path = [0, 1]
        return super().step(action)


def test_what_is_replaced_by_its_equal_is_no_state():
    replaced = cr.tabulate(Equal, discount=0.9, state=MiniGridState())
    plain = cr.tabulate("MiniGrid-DoorKey-5x5-v0", discount=0.9)
    assert cr.solve(replaced).start_value == pytest.approx(cr.solve(plain).start_value)


@pytest.mark.parametrize(("level", "length"), [(Notes, 4), (FarNotes, 12), (Rebound, 12)])
def test_levels_that_keep_a_state_elsewhere_are_saved_by_copies(level, length):
    with pytest.raises(TaskError, match=r"MiniGridState\(copies=True\)|deterministic"):
        cr.tabulate(level, discount=0.9, state=MiniGridState())
    task = cr.tabulate(level, discount=0.9)
    assert cr.solve(task).start_value == pytest.approx(0.9 ** (length - 1))


def test_moving_obstacles_are_refused():
    with pytest.raises(TaskError, match="steps must be deterministic"):
        cr.tabulate("MiniGrid-Dynamic-Obstacles-5x5-v0", discount=0.9)
    name = "MiniGrid-Dynamic-Obstacles-5x5-v0"
    task = cr.tabulate(name, discount=0.9, samples=3, max_states=20_000, n_obstacles=1)
    assert not task.exact
    assert set(np.unique(task.mdp.reward)) == {-1, 0, 1}


class Prized(minigrid.envs.EmptyEnv):
    def _reward(self):
        return 5.0


class Late(minigrid.envs.EmptyEnv):
    """Costs something late in an episode."""

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward - (self.step_count > 60), *rest


class Fading(minigrid.envs.EmptyEnv):
    def _reward(self):
        return 1 - self.step_count / 50


@pytest.mark.parametrize("state", [None, MiniGridState(), MiniGridState(copies=True)])
def test_a_reward_of_a_subclass_is_kept(state):
    task = cr.tabulate(lambda: Prized(size=5), discount=0.9, state=state)
    assert task.mdp.reward.max() == 5
    assert "goal reward" not in repr(task)
    plain = cr.tabulate(lambda: minigrid.envs.EmptyEnv(size=5), discount=0.9, state=state)
    assert repr(plain).endswith("goal reward 1, exact)")
    assert cr.solve(task).start_value == pytest.approx(5 * cr.solve(plain).start_value)


@pytest.mark.parametrize("copies", [False, True])
@pytest.mark.parametrize("world", [Late, Fading])
def test_what_depends_on_the_time_is_refused(world, copies):
    def make():
        return world(size=5, max_steps=100)

    said = "depend on the time only with state=.*led to another reward"
    with pytest.raises(TaskError, match=said):
        cr.tabulate(make, discount=0.9, state=MiniGridState(copies=copies))


@pytest.mark.parametrize("encode", [lambda env: env, cr.interop.MiniGridView()])
def test_a_tabulated_environment_observes_as_before(encode):
    env = encode(gym.make("MiniGrid-DoorKey-5x5-v0"))
    before = vars(env.unwrapped).get("gen_obs")
    cr.tabulate(lambda: env, discount=0.9)
    assert vars(env.unwrapped).get("gen_obs") is before


def test_a_level_may_be_reset_again():
    task = cr.tabulate("MiniGrid-RedBlueDoors-6x6-v0", discount=0.9)  # each seed is, to compare
    assert task.states.size == 198
