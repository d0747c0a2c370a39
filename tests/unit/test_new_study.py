"""`curricle new`: studies of environments, of one's own too, that run as they are."""

import math
import tomllib

import pytest

import curricle as cr
from curricle.errors import ConfigError, TaskError
from curricle.study import StudyResults, read_study
from curricle.study.templates import new_study

ENVIRONMENT = "curricle.study.templates.environment"
OWN = """
import random

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle


class Robot(gym.Env):
    def __init__(self, size=6, slippery=False, max_steps=60):
        self.size, self.slippery, self.max_steps = size, slippery, max_steps
        self.observation_space = spaces.Box(0, size, (2,), dtype=np.int64)
        self.action_space = spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row = self.column = self.steps = 0
        return self.shown(np.array([self.row, self.column])), {}

    def step(self, action):
        self.steps += 1
        if self.slippery and self.np_random.random() < 0.3:
            action = int(self.np_random.integers(4))
        down, right = ((-1, 0), (0, 1), (1, 0), (0, -1))[action]
        self.row = min(max(self.row + down, 0), self.size - 1)
        self.column = min(max(self.column + right, 0), self.size - 1)
        over = self.row == self.column == self.size - 1
        late = self.steps >= self.max_steps
        return self.shown(np.array([self.row, self.column])), float(over), over, late, {}

    def shown(self, at):
        return at


class Icy(Robot):
    def __init__(self, slippery=True, size=4):
        super().__init__(size, slippery)


class Labelled(Icy):
    def __init__(self, slippery=True, size=6):
        super().__init__(slippery, size)
        numbers = {"row": size, "column": size, "area": size**2 + 1}
        self.observation_space = spaces.Dict({n: spaces.Discrete(k) for n, k in numbers.items()})

    def shown(self, at):  # in another order than that of the space
        return {"row": int(at[0]), "column": int(at[1]), "area": self.size**2}


class Numbered(Robot):  # its state is one number
    def __init__(self, size=6):
        super().__init__(size)
        self.observation_space = spaces.Discrete(size**2)
        del self.slippery, self.max_steps

    def reset(self, *, seed=None, options=None):
        gym.Env.reset(self, seed=seed)
        self.cell = 0
        return 0, {}

    def step(self, action):
        row, column = divmod(self.cell, self.size)
        down, right = ((-1, 0), (0, 1), (1, 0), (0, -1))[action]
        row = min(max(row + down, 0), self.size - 1)
        column = min(max(column + right, 0), self.size - 1)
        self.cell = row * self.size + column
        over = self.cell == self.size**2 - 1
        return self.cell, float(over), over, False, {}


class Alone(Robot):  # no argument makes it easier, and one step leads to the goal
    def __init__(self):
        super().__init__(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row = 1
        print("alone again")  # as some classes do, thousands of times
        return np.array([1, 0]), {}


class Dropped(Robot):
    def __init__(self):
        super().__init__(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row = int(self.np_random.integers(3))
        self.colour = int(self.np_random.integers(100))
        return np.array([self.row, 0]), {}


class Faulty(Robot):
    def step(self, action):
        return {}[action]


class Late(Robot):
    def shown(self, at):
        return at - 9 * (self.steps > 0)


class Patient(Robot):
    def step(self, action):
        return super().step(action)[:3] + ({},)


class Astray(Robot):
    def reset(self, **settings):
        return np.array([9, 0]), {}


class Tired(Robot):  # its battery ends random episodes long before the class truncates
    def __init__(self, size=5, battery=9):
        super().__init__(size)
        self.full = battery
        self.observation_space = spaces.MultiDiscrete([size, size, battery + 1])

    def reset(self, *, seed=None, options=None):
        self.battery = self.full
        return np.append(super().reset(seed=seed)[0], self.battery), {}

    def step(self, action):
        place, _, over, _, _ = super().step(action)
        charged = self.row == 1 and self.column == 2
        self.battery = self.full if charged else self.battery - 1
        empty = self.battery == 0
        reward = 10.0 * over - 5.0 * empty - 0.1
        return np.append(place, self.battery), reward, over or empty, self.steps >= 200, {}


class Scaled(Robot):  # its observations are fractions of few values
    def __init__(self, size=6):
        super().__init__(size)
        self.observation_space = spaces.Box(0, 1, (2,), dtype=np.float32)

    def shown(self, at):
        return np.float32(at / self.size)


class Drifting(gym.Env):  # between two walls, the goal at the right one; it never stands still
    def __init__(self, length=24.0):
        self.length = length
        self.observation_space = spaces.Box(0, np.inf, (1,), dtype=np.float64)
        self.action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = self.np_random.random()
        return np.array([self.at]), {}

    def step(self, action):
        drift = self.np_random.random() * (2 * action - 1)
        self.at = min(max(self.at + drift, 0.0), self.length)
        over = self.at == self.length
        return np.array([self.at]), float(over) - 0.1, over, False, {}


class Recorded(Robot, EzPickle):  # whose copies by pickle would be new environments
    def __init__(self):
        EzPickle.__init__(self)
        super().__init__()

    def reset(self, *, seed=None, options=None):
        self.visited = set()
        return super().reset(seed=seed)

    def step(self, action):
        self.visited = self.visited | {self.steps}
        return super().step(action)


class Gusty(Robot):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row = random.randrange(2)
        return np.array([self.row, 0]), {}

    def step(self, action):
        return super().step(action if np.random.random() < 0.9 else 1)


class Rover(Tired):  # whose episodes of random actions all end by its battery
    def __init__(self, size=9, battery=12):
        super().__init__(size, battery)
        self.slippery, self.max_steps = True, 80

    def step(self, action):
        self.battery -= 1
        at, reward, over, late, info = Robot.step(self, action)
        return np.append(at, self.battery), reward, over or not self.battery, late, info


class Leaving(Robot):
    def shown(self, at):
        return at + 9 * (self.steps > 5)


class Older(Robot):
    def reset(self):
        return super().reset()[0]

    def step(self, action):
        at, reward, over, cut, info = super().step(action)
        return at, reward, over or cut, info | {"TimeLimit.truncated": cut}


class Drawn(Robot):
    def __init__(self, seed=None):
        super().__init__()
        self.toll = np.random.default_rng(seed).random()

    def step(self, action):
        at, reward, over, cut, info = super().step(action)
        return at, reward - self.toll, over, cut, info


class Blurred(Drawn):
    def __init__(self, seed=None):
        super().__init__(seed)
        self.observation_space = spaces.Box(0, 9, (5,), np.float64)

    def shown(self, at):
        return np.array([*at, *self.np_random.random(3)])


class Hinted(Robot):
    def reset(self, *, seed=None, options=None):
        at, _ = super().reset(seed=seed)
        return at, {"action_mask": np.ones(4, bool)}

    def step(self, action):
        *answer, info = super().step(action)
        return *answer, {"action_mask": np.arange(4) != self.steps % 3}


class Vast(Robot):  # random, with more states than are found in time
    def __init__(self, size=700):
        super().__init__(size, slippery=True)
        self.observation_space = spaces.Box(0, size, (2,), dtype=np.float32)

    def shown(self, at):
        return np.float32(at)


class Spelt(Robot):  # so that a table of all that its numbers can say would be vast
    def __init__(self):
        super().__init__()
        self.observation_space = spaces.Box(0, 2, (18,), dtype=np.int8)

    def shown(self, at):
        return np.int8([number // 3**digit % 3 for number in at for digit in range(9)])


class Short(Spelt):
    def __init__(self):
        super().__init__()
        self.observation_space = spaces.Box(0, 2, (14,), dtype=np.int8)

    def shown(self, at):
        return super().shown(at)[[*range(7), *range(9, 16)]]


class Needy(Robot):
    def __init__(self, size):
        super().__init__(size)


class Pushed(Robot):
    def __init__(self):
        super().__init__()
        self.action_space = spaces.Box(-1, 1, (2,))

    def step(self, action):
        return super().step(int(action[0] > 0))


def short():
    return gym.wrappers.TimeLimit(Pushed(), 500)


def lasting():
    return gym.wrappers.TimeLimit(Pushed(), 3600)


class Worded(Robot):
    def __init__(self):
        super().__init__()
        self.observation_space = spaces.Dict(at=self.observation_space, word=spaces.Text(9))

    def shown(self, at):
        return {"at": at, "word": "go"}


class Growing(Pushed):  # observations of several lengths, and a counter of steps
    def __init__(self):
        super().__init__()
        self.observation_space = spaces.Sequence(spaces.Discrete(3))

    def shown(self, at):
        return (1,) * ((self.steps + 1) % 3)


class Endless(Vast):
    def __init__(self):
        super().__init__()
        most = np.finfo(np.float32).max
        self.observation_space = spaces.Box(-most, most, (2,), dtype=np.float32)


class Boards(Pushed):  # a number beside a picture that is too small for convolutions
    def __init__(self):
        super().__init__()
        board = spaces.Box(0, 255, (8, 8, 2), np.uint8)
        self.observation_space = spaces.Dict(board=board, battery=spaces.Box(0, 1, (1,)))

    def shown(self, at):
        return {"board": np.zeros((8, 8, 2), np.uint8), "battery": np.ones(1, np.float32)}


class Lamps(gym.Env):
    observation_space, action_space = spaces.MultiBinary(70), spaces.Discrete(2)

    def reset(self, **settings):
        return np.zeros(70, np.int8), {}

    def step(self, action):
        return np.full(70, action, np.int8), float(action), bool(action), False, {}
"""


@pytest.fixture
def robots(tmp_path):
    (tmp_path / "robots.py").write_text(OWN)
    return tmp_path


def plan_of(folder, file, text):
    """Return the only curriculum of a study, whose file is written into a folder."""
    (folder / file).write_text(text)
    return next(iter(read_study(folder / file).curricula.values()))


def target_of(text):
    """Return what a study's file says of its target."""
    return tomllib.loads(text)["tasks"]["target"]


def allow(monkeypatch, seconds):
    """Let each search of a new study take so many seconds."""
    for module in ("environment", "variants"):
        for limit in ("SECONDS", "SMALL"):
            monkeypatch.setattr(f"curricle.study.templates.{module}.{limit}", seconds)


def test_a_class_of_ones_own_is_tabulated_and_easier_variants_are_proposed(curricle, robots):
    code, out, complaint = curricle("new", "robots:Robot")
    assert code == 0, complaint
    assert "tabulated: 36 states" in out
    assert "'steps' counts steps and is no part of a state" in out
    assert "easier with size = 3: 9 states instead of 36, learnt in" in out
    assert "slippery" not in out  # true is no easier
    study = read_study(robots / "Robot.toml")
    plan = next(iter(study.curricula.values()))
    target = plan.tasks["target"]
    assert target.states.names == ("row", "column")
    assert target.mdp.time_limit == 60  # where the class truncates
    assert plan.tasks["size_3"].states.size == 9
    quick = [f"--set=tasks.{name}.budget=400" for name in ("target", "size_3")]
    assert curricle("check", "Robot.toml", *quick)[0] == 0
    code, _, complaint = curricle("run", "Robot.toml", "--seeds", "0-1", *quick)
    assert code == 0, complaint
    assert StudyResults(robots / "Robot-results").comparison.verdicts


PROPOSED = [  # of each class what is noted, what its study has, and what neither has
    # more observations than have numbers
    ("Lamps", "tabulated: 2 states", 'type = "tabulated"', None),
    # a record of what was done and a pickled constructor are no part of a state
    ("Recorded", "tabulated: 36 states", 'observed = ["row", "column"]', None),
    # random numbers that all code shares follow the seed
    ("Gusty", "tabulated: 36 states", "samples = 30", "two resets with one seed"),
    # masks that observations do not tell are left out
    ("Hinted", "observations do not tell which actions are available", "", "action_masks"),
    # fractions of few values
    ("Scaled", "tabulated: 36 states", 'type = "tabulated"', None),
]


@pytest.mark.parametrize(("name", "note", "there", "nowhere"), PROPOSED)
def test_what_a_class_keeps_shows_and_draws_is_noted(robots, name, note, there, nowhere):
    _, text, notes = new_study(f"robots:{name}", robots)
    assert notes[0].startswith(note), notes
    assert there in text
    assert not nowhere or nowhere not in text + str(notes)


def test_a_random_class_is_sampled_with_names_of_its_attributes(robots):
    file, text, notes = new_study("robots:Icy", robots)
    assert file == "Icy.toml"
    assert "tabulated: 16 states" in notes[0]
    assert "states that look alike are taken for one, whatever else the class keeps" in notes[1]
    assert 'observed = ["row", "column"]' in text
    assert "samples = 30" in text
    assert any("easier with slippery = false" in note for note in notes), notes
    plan = plan_of(robots, file, text)
    assert plan.tasks["target"].states.names == ("row", "column")


def test_a_dict_names_its_numbers(robots):
    file, text, _ = new_study("robots:Labelled", robots)
    assert "observed = []" in text
    plan = plan_of(robots, file, text)
    assert plan.tasks["target"].states.names == ("row", "column")  # the area is always the same


def test_a_battery_that_falls_with_each_step_is_no_clock(robots):
    _, text, _ = new_study("robots:Rover", robots)
    assert text.count("time_limit = 80") == text.count("[tasks.")


def test_a_class_of_an_older_api_is_played(curricle, robots):
    code, out, complaint = curricle("new", "robots:Older")
    assert code == 0, complaint
    assert "tabulated: 36 states" in out
    assert curricle("check", "Older.toml")[0] == 0


def test_what_a_constructor_draws_is_fixed_by_its_seed(robots):
    _, text, notes = new_study("robots:Drawn", robots)
    assert "all tasks have seed = 0" in notes[0]
    assert text.count("seed = 0") == text.count("[tasks.") + 1  # and the note


def test_what_a_constructor_draws_is_fixed_for_a_network_too(robots, monkeypatch):
    for name in "SECONDS", "SMALL":
        monkeypatch.setattr(f"{ENVIRONMENT}.{name}", 0.0)
    _, text, notes = new_study("robots:Blurred", robots)
    assert any(note.startswith("learnt by a network") for note in notes), notes
    assert target_of(text)["arguments"] == {"seed": 0}


def test_whole_numbers_in_a_box_of_floats_are_states(robots, monkeypatch):
    allow(monkeypatch, 0.5)  # too few for its states
    file, text, notes = new_study("robots:Vast", robots)
    assert any("its numbers are sorted into" in note for note in notes), notes
    assert 'type = "WholeNumbers"' in text
    plan = plan_of(robots, file, text)
    assert [part.low for part in plan.tasks["target"].states.components] == [0, 0]


def test_a_few_numbers_are_binned_and_a_live_relative_is_scored_by_returns(robots, monkeypatch):
    monkeypatch.setattr("curricle.study.templates.environment.QUICK", 0)  # on any machine
    monkeypatch.setattr("curricle.study.templates.environment.SMALL", 0.5)  # it has no table
    file, text, notes = new_study("robots:Drifting", robots)
    assert "its observations are no whole numbers, nor few" in notes[0]
    assert "its numbers are sorted into 20 states" in notes[1]
    assert any("easier with length = 12.0" in note for note in notes), notes
    assert "mean return of its first 2,000 steps, in each of 3 seeds" in text
    plan = plan_of(robots, file, text)
    assert plan.tasks["target"].states == plan.tasks["length_12_0"].states
    edges = cr.interop.Bins(target_of(text)["encode"]["edges"])
    assert plan.tasks["target"].states == edges.states


def test_the_learners_of_a_study_fit_its_tables(curricle, robots, monkeypatch):
    for name in "SECONDS", "QUICK":  # live, and tried at any speed
        monkeypatch.setattr(f"{ENVIRONMENT}.{name}", 0.0)
    file, text, notes = new_study("robots:Spelt", robots)
    assert notes[0].startswith("learnt live"), notes
    (robots / file).write_text(text)
    code, _, complaint = curricle("run", file, "--seeds=0-1", "--set=tasks.target.budget=2000")
    assert code == 0, complaint
    # 12 million pairs would fit into dense tables, which take a hundred times the memory.
    _, text, _ = new_study("robots:Short", robots)
    assert target_of(text)["storage"] == {"kind": "sparse"}
    # What is too slow to be tried, and vast, is for a network.
    monkeypatch.setattr(f"{ENVIRONMENT}.QUICK", math.inf)
    _, text, notes = new_study("robots:Spelt", robots)
    assert 'algorithm = "DQN"' in text
    assert any("few of its 387,420,489 states are met in 20,000 steps" in note for note in notes)


@pytest.mark.parametrize(
    ("error", "name", "said"),
    [
        (TaskError, "Patient", r"must return .*: got .*; .*shimmy"),
        (
            ConfigError,
            "Faulty",
            r"robots:Faulty failed: .*\(raised in step of robots.py, line \d+\)",
        ),
        (TaskError, "Late", r"must lie in the .*observation_space, Box\(.*: got array\(\[-"),
        (TaskError, "Astray", r"must lie in the .*observation_space, Box\(.*: got array\(\[9, 0\]"),
        (TaskError, "Leaving", r"must lie in the .*observation_space, Box\(.*: got"),
        (ConfigError, "Growing", r"of a deep learner must be a Box, .*encode="),
        (
            ConfigError,
            "Needy",
            "1 required positional argument: 'size'; give its arguments defaults, or name a",
        ),
        (ConfigError, "Robots", "robots has no Robots to call, did you mean 'Robot'"),
    ],
)
def test_what_cannot_be_studied_is_refused_in_a_sentence(robots, error, name, said):
    with pytest.raises(error, match=said):
        new_study(f"robots:{name}", robots)


def test_a_network_has_fewer_steps_where_they_are_slow_and_learners_for_its_actions(
    curricle, robots, monkeypatch
):
    file, text, notes = new_study("robots:Pushed", robots)
    assert notes[0] == (
        "learnt by a network, as it is not tabulated: its actions are no whole numbers"
    )
    assert 'factory = "robots:Pushed"' in text
    assert "seeds = 7\n" in text  # fewer give no verdict where several arms are asked
    target = target_of(text)
    assert target["time_limit"] == 60
    assert target["learner"]["settings"]["use_sde"]
    assert target["evaluation"]["sampled"]
    (robots / file).write_text(text)
    code, out, complaint = curricle("check", file)
    assert code == 0, complaint
    assert "scratch, with plain noise" in out
    monkeypatch.setattr(f"{ENVIRONMENT}.Play.seconds_a_step", 1e-2)
    _, text, _ = new_study("robots:Pushed", robots)
    assert 500 < target_of(text)["budget"] < target["budget"]


def test_a_text_beside_a_counter_is_no_number(robots):
    _, text, _ = new_study("robots:Worded", robots)
    assert target_of(text)


def test_bounds_as_far_apart_as_numbers_go_say_nothing(robots, recwarn, monkeypatch):
    allow(monkeypatch, 0.5)
    _, text, _ = new_study("robots:Endless", robots)
    ranges = target_of(text)["encode"]["ranges"]
    assert all(-50 < low < high < 50 for low, high in ranges.values())
    assert not [warned for warned in recwarn if "overflow" in str(warned.message)]


def test_small_pictures_among_numbers_become_numbers(curricle, robots):
    file, text, _ = new_study("robots:Boards", robots)
    assert 'policy = "MlpPolicy"' in text
    (robots / file).write_text(text)
    code, out, complaint = curricle("check", file)
    assert code == 0, complaint
    assert "Box(129,)" in out


@pytest.mark.parametrize(("name", "steps", "usual"), [("short", 500, 40), ("lasting", 3600, 40)])
def test_a_network_is_evaluated_in_fewer_steps_than_it_learns_unless_its_episodes_become_long(
    robots, monkeypatch, name, steps, usual
):
    monkeypatch.setattr(f"{ENVIRONMENT}.Play.seconds_a_step", 1e-6)
    _, text, _ = new_study(f"robots:{name}", robots)
    target = target_of(text)
    checkpoints = target["budget"] // target["eval_freq"]
    assert checkpoints >= 5
    episodes = checkpoints * target["evaluation"]["episodes"]
    assert episodes * usual <= target["budget"]
    assert target["budget"] < episodes * steps <= 3.6 * target["budget"]


@pytest.mark.parametrize(("name", "checkpoints", "episodes"), [("short", 4, 2), ("lasting", 2, 1)])
def test_a_network_of_slow_steps_is_evaluated_by_few_episodes(
    robots, monkeypatch, name, checkpoints, episodes
):
    monkeypatch.setattr(f"{ENVIRONMENT}.Play.seconds_a_step", 1e-2)
    _, text, _ = new_study(f"robots:{name}", robots)
    target = target_of(text)
    assert target["evaluation"]["episodes"] == episodes
    assert target["budget"] // target["eval_freq"] == checkpoints


def test_a_network_is_studied_where_a_reset_takes_longer_than_the_play_may(robots, monkeypatch):
    monkeypatch.setattr("curricle.interop.play.PLAYED", 0.0)  # no episode has a step
    _, text, _ = new_study("robots:short", robots)
    assert target_of(text)["evaluation"]["episodes"] >= 1


def test_a_variant_that_misleads_is_left_out_and_starts_near_the_goal_stand_in(robots):
    file, text, notes = new_study("FrozenLake-v1", robots)
    # The policy of the lake that is not slippery regains 17 % of the way, and its values nothing.
    assert any("no mapping by components fits: is_slippery = false" in note for note in notes)
    assert "start_states = { distance = [1, 2] }" in text
    assert 'mapping = "identity"' in text
    plan = plan_of(robots, file, text)
    assert plan.tasks["near_the_goal"].mdp.start[0] == 0


@pytest.mark.parametrize("name", ["Numbered", "Robot"])
def test_the_mapping_that_scores_best_is_written(robots, name):
    steps = []
    file, text, notes = new_study(f"robots:{name}", robots, steps.append)
    assert 'aligned = { row = "last", column = "last" }' in text
    assert ("sizes = [6, 6]" in text) == (name == "Numbered")  # state 7 of 6 x 6 is none of 3 x 3
    assert "its mapping regains 100 % of the way to the optimum" in notes[-1]
    assert steps[0] == "playing 6 episodes of random actions (at most 2 s)"
    assert steps[-1].startswith("building the study")
    plan = plan_of(robots, file, text)
    (mapping,) = (edge.mapping for edge in plan.in_edges("target"))
    corner = plan.tasks["target"].states.encode(row=5, column=4)
    source = mapping.index[int(corner), 0] // 4
    last = plan.tasks[plan.in_edges("target")[0].source].states
    assert last.label(source) == last.label(
        int(last.encode(row=last.components[0].high, column=last.components[1].high - 1))
    )


def test_a_study_without_a_relative_ends_in_the_best_learner(curricle, robots):
    code, out, steps = curricle("new", "robots:Alone")
    assert code == 0, steps
    assert "no easier relative was found: the study compares learners without one" in out
    assert "alone again" not in out + steps
    assert "... searching for its states (at most 10 s)" in steps
    code, out, _ = curricle("check", "Alone.toml")
    assert "no forecast: no arm has a source" in out
    curricle("run", "Alone.toml", "--set=tasks.target.budget=400")
    _, out, _ = curricle("show", "Alone-results")
    assert "no arm has a source; the best learner without one is" in out
    assert "transfer" not in out
    assert "costs more" not in out
    assert curricle("report", "Alone-results")[0] == 0


def test_resets_that_differ_are_said_and_tabulated(robots):
    _, text, notes = new_study("robots:Dropped", robots)
    assert any("9 resets; the last half of them brought no new" in note for note in notes), notes
    assert 'reset_seeds = "0-8"' in text


def test_a_proposed_source_can_learn_its_task_within_its_budget(robots):
    file, text, notes = new_study("robots:Tired", robots)
    assert 'ignore = ["steps"]' in text
    # The time limit is where the class truncates, which random play does not live to see.
    assert text.count("time_limit = 200") == text.count("[tasks.") >= 1
    assert "battery_4]" not in text  # the goal is too far, so that there is only a later end
    (robots / file).write_text(text)
    plans = list(read_study(robots / file).curricula.values())
    budgets = {
        name: plan.node(name).most_steps
        for plan in plans
        for name in plan.order
        if name != "target"
    }
    learnt = [int(note.split("learnt in ")[1].split()[0].replace(",", "")) for note in notes[-3:]]
    assert len(budgets) == len(learnt)
    assert all(budget >= steps for budget, steps in zip(budgets.values(), learnt, strict=True))
