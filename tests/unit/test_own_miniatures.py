"""Miniatures of a class of one's own: counters of steps, prices, and what will not fit."""

import re
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiBinary

import curricle as cr
from curricle.cli.output import total_words
from curricle.deep import miniatures
from curricle.errors import TaskError
from curricle.interop import DeepCopy, search
from curricle.interop.play import without_counters
from curricle.interop.states import time_before
from curricle.progress import Bars, compilation

LIMIT = 20
MOVES = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]])


class KeyDoor(gymnasium.Env):
    """Two rooms: take the key, go through the door; what the counter does is an argument."""

    action_space = Discrete(4)
    observation_space = Box(0, 1, (7,), np.float32)
    asked = 0  # steps of all environments

    def __init__(self, counts="nothing", size=4):
        self.counts, self.size = counts, size

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        wall, self.key_taken, self.door = self.size // 2, False, int(self.np_random.integers(2))
        self.key, self.place = self.np_random.integers(0, [self.size, wall], (2, 2))
        self.goal = np.array([int(self.np_random.integers(self.size)), self.size - 1])
        if self.counts != "never":
            self.steps = 0
        return self.seen(), {}

    def step(self, action):
        type(self).asked += 1
        if self.counts != "never":
            self.steps += 1
        now = getattr(self, "steps", 0)
        new = np.clip(self.place + MOVES[action], 0, self.size - 1)
        if new[1] != self.size // 2 or (new[0] == self.door and self.key_taken):
            self.place = new
        self.key_taken |= bool((self.place == self.key).all())
        there = bool((self.place == self.goal).all())
        reward = float(there) - 0.01 * now * (self.counts == "rewards")
        over = there or (self.counts == "ends" and now >= LIMIT)
        return self.seen(), reward, over, 0 < LIMIT <= now, {}

    def seen(self):
        shown = getattr(self, "steps", 0) / LIMIT if self.counts == "shown" else 0.0
        numbers = [*self.place, *self.key, self.goal[0], self.door + 2 * self.key_taken]
        return np.array([*np.array(numbers) / self.size, shown], np.float32)


def small(counts, resets=3, size=4, **settings):
    door = cr.observation_task(partial(KeyDoor, counts, size), discount=0.9, time_limit=LIMIT)
    return miniatures(door, resets=resets, **settings)


def test_counters_of_steps_add_no_states_and_no_charged_steps():
    without, (counted,) = small("never"), small("nothing").solved
    assert small("nothing").cost == without.cost
    for name in ("next_state", "reward", "terminal", "start"):
        ours, theirs = (getattr(of.table.mdp, name) for of in (counted, without.solved[0]))
        np.testing.assert_array_equal(ours, theirs)


def test_what_is_left_out_can_be_said_as_to_tabulate():
    whole = small("nothing", 1, state=DeepCopy())
    assert whole.cost > 5 * small("nothing", 1).cost
    assert small("nothing", state=DeepCopy(ignore=["steps"])).cost == small("never").cost
    with pytest.raises(cr.errors.SettingError, match=r"state must be .*: got 'steps'"):
        small("nothing", state="steps")
    with pytest.raises(cr.errors.SettingError, match=r"nothing in it has step$"):
        _ = small("nothing", 1, state=DeepCopy(ignore=["step"])).solved


@pytest.mark.parametrize(("counts", "said"), [("rewards", "deterministic"), ("ends", "agree with")])
def test_a_counter_that_matters_is_not_left_out_in_silence(counts, said):
    way_out = "may depend on steps only with state=DeepCopy()"
    with pytest.raises(TaskError, match=f"{said}.*{way_out}"):
        _ = small(counts).solved
    assert small(counts, 1, state=DeepCopy()).solved


def test_a_counter_that_is_seen_stays():
    assert without_counters(KeyDoor("shown")) is None
    assert without_counters(KeyDoor("never")) is None
    assert without_counters(KeyDoor()).counters == {"steps": 0}


def test_a_repeated_step_finds_a_counter_at_any_time_before_the_end():
    times = [time_before(k, LIMIT) for k in range(200)]
    assert {*times} == {*range(LIMIT - 1)}
    assert min(abs(np.diff(times))) > LIMIT // 4


REFUSED = r"may have max_states, .* and take max_seconds, .*: by the first of its resets .*KeyDoor"


class Hesitates(KeyDoor):
    """Every other step, on average, leaves all as it is."""

    def step(self, action):
        return super().step(action) if self.np_random.integers(2) else (self.seen(), 0, 0, 0, {})


def test_random_steps_are_estimated_and_each_is_charged():
    doors = cr.observation_task(partial(Hesitates, "never"), discount=0.9, time_limit=LIMIT)
    with pytest.raises(TaskError, match=r"steps must be deterministic .* or samples="):
        miniatures(doors, resets=1).knowledge()
    asked, estimated = Hesitates.asked, miniatures(doors, resets=1, samples=40)
    (solved,), sure = estimated.solved, small("never", 1).solved[0]
    assert estimated.cost == 40 * sure.table.record.transitions
    assert Hesitates.asked - asked > 0.45 * estimated.cost  # those that do not hesitate
    # An action moves after two steps on average: V = .5 (.9 V' + .9 V), V' one move nearer.
    moves = np.round(np.log(sure.solution.start_value) / np.log(0.9))
    expected = (0.5 / (1 - 0.5 * 0.9)) * (0.45 / (1 - 0.45)) ** moves
    assert solved.solution.start_value == pytest.approx(expected, rel=0.25)


def test_too_many_states_are_foreseen_from_the_first_reset():
    KeyDoor.asked = 0
    (member,) = small("nothing", 40).solved
    asked, KeyDoor.asked = KeyDoor.asked, 0
    assert member.table.states.size > 400
    with pytest.raises(TaskError, match=f"{REFUSED}.*fewer take less"):
        _ = small("nothing", 40, max_states=100).solved
    assert KeyDoor.asked < asked / 2


def test_too_long_a_search_is_foreseen_from_the_first_reset():
    KeyDoor.asked = 0
    with pytest.raises(TaskError, match=REFUSED):
        _ = small("nothing", 200, 14, max_seconds=4, state=DeepCopy(ignore=["steps"])).solved
    assert KeyDoor.asked < 10_000  # of about 300,000: 200 levels, 180 states, 4 actions, twice


class Lamps(gymnasium.Env):
    """Each action switches a lamp, so that states are soon many more than are done."""

    action_space = Discrete(16)
    observation_space = MultiBinary(16)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.lamps = np.zeros(16, np.int8)
        return self.lamps.copy(), {}

    def step(self, action):
        self.lamps[action] ^= 1
        return self.lamps.copy(), 0.0, False, False, {}


def test_a_search_ends_as_soon_as_what_it_has_found_takes_too_long(monkeypatch):
    monkeypatch.setattr(search, "WARM", 0.2)
    with pytest.raises(TaskError, match=r"within max_seconds, 9: .* states in [1-8] s and done "):
        cr.tabulate(Lamps, discount=0.9, max_seconds=9)


def test_the_price_is_said_beforehand_and_on_the_way(monkeypatch, capsys):
    monkeypatch.setattr(compilation(), "prints", True)
    monkeypatch.setattr(compilation(), "noted", -np.inf)
    for name in ("DELAY", "INTERVAL"):
        monkeypatch.setattr(search, name, 0.0)
    monkeypatch.setattr("curricle.progress.BETWEEN_LINES", 0.0)
    found = small("nothing", 40)
    (states,) = (member.table.states.size for member in found.solved)
    before, *later = (line for line in capsys.readouterr().err.splitlines() if "tabulating" in line)
    said = re.search(r" takes about ([\d,]+) states, ([\d,]+) steps and ", before)
    foreseen = [int(number.replace(",", "")) for number in said.groups()]
    assert foreseen == pytest.approx([states, found.transitions], rel=0.5)
    assert later[-1].startswith("curricle: tabulating ")
    assert f"{states:,} states, " in later[-1]
    assert " steps in " in later[-1]


def test_a_line_waits_for_the_last(monkeypatch, capsys):
    monkeypatch.setattr(compilation(), "prints", True)
    monkeypatch.setattr(compilation(), "noted", -np.inf)
    for text in ("first", "second"):
        Bars().at("search", 1, text=text)
    Bars().say("at once")
    assert capsys.readouterr().err.splitlines() == ["curricle: first", "curricle: at once"]


STUDY = """
name = "doors"
seeds = 1
[tasks.small]
type = "distilled"
members = [{ factory = "tests.unit.test_own_miniatures:KeyDoor" }]
ignore = ["steps"]
max_seconds = 60.0
[tasks.large]
type = "observation_task"
factory = "tests.unit.test_own_miniatures:KeyDoor"
arguments = { size = 6 }
time_limit = 30
budget = 800
[learner]
type = "deep"
algorithm = "PPO"
[[transfers]]
source = "small"
target = "large"
mapping = "identity"
[arms.distilled]
"""


@pytest.mark.parametrize(
    ("line", "state"),
    [
        ('ignore = ["steps"]', DeepCopy(ignore=["steps"])),
        ("ignore = []", DeepCopy()),
        ("observed = []", DeepCopy(observed=[])),
        ("", None),
    ],
)
def test_a_study_file_says_how_states_are_saved(read, line, state):
    made = read(STUDY.replace('ignore = ["steps"]', line))
    plan = next(iter(made.curricula.values())).tasks["small"].plan
    assert (plan.state, plan.max_seconds, plan.max_states) == (state, 60.0, 100_000)


def test_sources_dearer_than_their_target_are_said():
    for budget, total, dear in ((8_000, 16_000, False), (8_000, 96_800, True)):
        words = total_words("large", budget, total, 100, sources=True)
        assert words.startswith(f"every arm spends {total:,} steps: 8,000 of large, ")
        assert ("sources may take more than large: " in words) == dear
