"""MiniGrid's observations as zeros and ones, beside loops that know nothing of arrays."""

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError, TaskError
from curricle.interop import MiniGridFullView, MiniGridView

minigrid = pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
CROSSING = "MiniGrid-SimpleCrossingS9N1-v0"
DOOR = "MiniGrid-DoorKey-6x6-v0"
SESAME = {"image": np.zeros((7, 7, 3), int), "direction": 0, "mission": "open sesame"}


def one_hot(codes):
    """The cells of a view as a list of zeros and ones."""
    numbers = []
    for column in codes.tolist():
        for thing, colour, state in column:
            cell = [0.0] * 20
            cell[thing] = cell[11 + colour] = cell[17 + state] = 1.0
            numbers += cell
    return numbers


@pytest.mark.parametrize("name", [CROSSING, DOOR, "BabyAI-GoToLocal-v0"])
def test_the_view_is_one_hot(name):
    env, plain = MiniGridView(mission=False)(gym.make(name)), gym.make(name)
    assert env.observation_space == gym.spaces.Box(0, 1, (984,), np.float32)
    rng = np.random.default_rng(0)
    for seed in range(3):
        seen, raw = env.reset(seed=seed)[0], plain.reset(seed=seed)[0]
        for _ in range(20):
            direction = [float(d == raw["direction"]) for d in range(4)]
            assert seen.tolist() == one_hot(raw["image"]) + direction
            assert seen in env.observation_space
            action = int(rng.integers(6))
            seen, raw = env.step(action)[0], plain.step(action)[0]


def test_the_picture_has_the_same_numbers():
    env, flat = MiniGridView(picture=True)(gym.make(DOOR)), MiniGridView()(gym.make(DOOR))
    seen, vector = env.reset(seed=2)[0], flat.reset(seed=2)[0]
    assert seen.shape == env.observation_space.shape == (24, 7, 7)
    for x in range(7):
        for y in range(7):
            begins = 20 * (7 * x + y)
            assert seen[:20, y, x].tolist() == vector[begins : begins + 20].tolist()
            assert seen[20:, y, x].tolist() == vector[-4:].tolist()


def test_the_mission_is_a_bag_of_words():
    name = "MiniGrid-Fetch-5x5-N2-v0"
    env, plain = MiniGridView(mission=True)(gym.make(name)), gym.make(name)
    bags = dict[str, list[float]]()
    for seed in range(20):
        mission = plain.reset(seed=seed)[0]["mission"]
        seen = env.reset(seed=seed)[0]
        assert seen in env.observation_space
        bag = seen[984:].tolist()
        assert sum(bag) == len(set(mission.split()))
        assert bags.setdefault(mission, bag) == bag
    assert len({tuple(bag) for bag in bags.values()}) == len(bags) > 3


@pytest.mark.parametrize(
    ("name", "differ"),
    [("Fetch-5x5-N2", True), ("GoToDoor-5x5", True), ("KeyCorridorS3R1", True),
     ("DoorKey-5x5", False), ("MultiRoom-N2-S4", False)],
)  # fmt: skip
def test_missions_are_seen_by_default_where_they_differ(name, differ):
    plain, env = (f(gym.make(f"MiniGrid-{name}-v0")) for f in (lambda x: x, MiniGridView()))
    missions = {plain.reset(seed=seed)[0]["mission"] for seed in range(20)}
    assert (len(missions) > 1) == differ
    assert env.reset(seed=0)[0].shape == env.observation_space.shape == (984 + 59 * differ,)
    assert MiniGridView(mission=False)(plain).observation_space.shape == (984,)
    wide = MiniGridFullView(25, 25)(plain).observation_space
    assert wide.shape == (25 * 25 * 20 + 4 + 59 * differ,)
    assert MiniGridView(picture=True)(plain).observation_space.shape == (24, 7, 7)
    babyai = gym.make("BabyAI-GoToLocal-v0")
    assert MiniGridView()(babyai).observation_space.shape == (984 + 59,)


def test_the_full_view_has_every_cell_in_the_middle():
    env = MiniGridFullView(11, 9)(gym.make(CROSSING))
    seen = env.reset(seed=0)[0][:-4].reshape(11, 9, 20)
    base = env.unwrapped
    assert (seen[[0, 10], :, 0] == 1).all()  # unseen columns to the left and right
    codes = base.grid.encode()
    for x in range(9):
        for y in range(9):
            here = (x, y) == tuple(base.agent_pos)
            objects = {int(codes[x, y, 0])} | ({10} if here else set())
            assert set(np.flatnonzero(seen[x + 1, y, :11])) == objects


def test_what_is_carried_is_seen():
    env = MiniGridFullView(6, 6)(gym.make(DOOR))
    env.reset(seed=0)
    base = env.unwrapped
    (key,) = [thing for thing in base.grid.grid if thing is not None and thing.type == "key"]
    base.grid.set(*key.cur_pos, None)
    base.carrying = key
    cells = env.observation(base.gen_obs())[:-4].reshape(6, 6, 20)
    assert cells[..., 5].sum() == cells[tuple(base.agent_pos)][5] == 1


@pytest.mark.parametrize(
    ("encode", "shape"),
    [
        (MiniGridView(), (984,)),
        (MiniGridView(picture=True), (24, 7, 7)),
        (MiniGridView(mission=True), (984 + 59,)),
        (MiniGridFullView(9, 11), (9 * 11 * 20 + 4,)),
        (MiniGridFullView(9, 11, picture=True), (24, 11, 9)),
    ],
)
def test_tables_of_a_level_have_the_observations_of_the_networks_task(encode, shape):
    task = cr.observation_task(CROSSING, encode=encode)
    table = cr.tabulate(task.make, discount=0.99, seeds=3)
    plain = cr.tabulate(CROSSING, discount=0.99, seeds=3)
    stacked = table.observations.batch()
    assert stacked.shape == (table.states.size, *shape)
    assert task.observations.shape == shape
    assert all(observation in task.observations for observation in stacked)
    assert cr.solve(table).start_value == cr.solve(plain).start_value
    env = task.environment()
    seen, _ = env.reset(seed=1)
    assert (stacked == seen).reshape(len(stacked), -1).all(axis=1).any()


def test_minigrids_own_limit_is_the_tasks():
    assert cr.observation_task(CROSSING, encode=MiniGridView()).longest == 324
    assert cr.observation_task(CROSSING, time_limit=50).longest == 50
    assert cr.observation_task(CROSSING, max_steps=60).longest == 60
    # A level of BabyAI decides on its limit at a reset.
    assert cr.observation_task("BabyAI-GoToLocal-v0").longest is None


@pytest.mark.parametrize(
    ("made", "error", "sentence"),
    [
        (lambda: MiniGridView(picture=1), SettingError, "picture of an encoder"),
        (lambda: MiniGridView(picture=True, mission=True), SettingError, "picture has no mission"),
        (lambda: MiniGridView()(gym.make("CartPole-v1")), TaskError, "is for MiniGrid's"),
        (
            lambda: MiniGridView(mission=True)(gym.make(CROSSING)).observation(SESAME),
            TaskError,
            "got 'sesame' in 'open sesame'",
        ),
        (
            lambda: [
                MiniGridView()(minigrid.wrappers.FullyObsWrapper(gym.make(DOOR))).reset(seed=seed)
                for seed in range(20)
            ],
            TaskError,
            r"must be below \(11, 6, 3\): got up to \[10, ., 3\]",
        ),
    ],
)
def test_a_mistake_is_one_sentence(made, error, sentence):
    with pytest.raises(error, match=sentence) as caught:
        made()
    assert "\n" not in str(caught.value)
