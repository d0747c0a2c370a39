"""Tables of environments: every state that can be reached, and nothing else."""

import itertools
import random
import threading
from copy import deepcopy
from functools import partial
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.wrappers import TimeLimit, TransformReward

import curricle as cr
from curricle.errors import MappingError, SettingError, TaskError
from curricle.interop import DeepCopy, MiniGridState
from curricle.interop.states import SaveAndRestore
from curricle.transfer import UNMAPPED
from tests.support.refusals import check_refusal, check_values
from tests.support.worlds_to_tabulate import (
    Corridor,
    Counting,
    Dark,
    Flickering,
    OldReset,
    OldStep,
    OwnClock,
    Slippery,
    Toggles,
    Uncopyable,
    Unreadable,
    Unseeded,
    assert_same_tables,
)


class Where(NamedTuple):
    place: int
    lit: bool


def save(env):
    return Where(env.place, env.lit)


def restore(env, state):
    env.place, env.lit = state


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("FrozenLake-v1", {"is_slippery": False}),
        ("FrozenLake-v1", {"is_slippery": False, "map_name": "8x8"}),
        ("CliffWalking-v1", {}),
    ],
)
def test_copies_give_the_table_that_an_environment_has(name, settings):
    known = cr.from_gymnasium(name, discount=0.9, **settings)
    task = cr.tabulate(name, discount=0.9, state=DeepCopy(), **settings)
    shown = task.observations.batch()
    assert np.unique(shown).size == task.states.size  # no state twice
    np.testing.assert_allclose(
        cr.solve(task).values, cr.solve(known).values[shown], rtol=0, atol=1e-9
    )
    assert task.mdp.time_limit == known.time_limit


def test_a_listed_table_is_its_reachable_part():
    known = cr.from_gymnasium("FrozenLake-v1", discount=0.9)
    task = cr.tabulate("FrozenLake-v1", discount=0.9)
    assert task.record.drawing == 0
    assert task.exact
    shown = task.observations.batch()
    np.testing.assert_allclose(cr.solve(task).values, cr.solve(known).values[shown], atol=1e-9)
    assert task.states.label(task.state(6)) == known.states.label(6) == "row=1 column=2"


@pytest.mark.parametrize("state", [None, (save, restore)], ids=["copies", "functions"])
def test_states_have_the_names_of_attributes_and_starts_are_those_of_resets(state):
    task = cr.tabulate(Corridor, discount=0.5, seeds=20, state=state)
    assert task.states.names == ("place", "lit")
    assert task.states.size == 8
    assert int(task.mdp.terminal.sum()) == 2
    starts = [int(Corridor().reset(seed=seed)[0][0]) for seed in range(20)]
    for place in range(3):
        begins = task.mdp.start[task.states.encode(place=place, lit=0)]
        assert begins == pytest.approx(starts.count(place) / 20)
    values = cr.solve(task).values
    assert values[task.states.encode(place=2, lit=1)] == 1
    assert values[task.states.encode(place=2, lit=0)] == 0.5
    assert [task.state([p, 1]) for p in range(4)] == [
        task.states.encode(place=p, lit=1) for p in range(4)
    ]


def test_observations_that_several_states_show_show_none():
    task = cr.tabulate(Dark, discount=0.5)
    assert task.states.size == 7  # at the end the lamp makes no difference
    assert [task.state(place) for place in range(3)] == [UNMAPPED] * 3
    assert task.state(17) == UNMAPPED
    assert task.mdp.terminal[task.state(3)]
    np.testing.assert_array_equal(task.observations.ambiguous, ~task.mdp.terminal)


def test_the_same_state_ended_and_not_ended_is_two():
    class Shouting(Corridor):
        """The action 2 ends the episode and changes nothing."""

        def step(self, action):
            if action == 2:
                return self.seen(), 5.0, True, False, {}
            return super().step(action)

    task = cr.tabulate(Shouting, discount=0.5)
    assert task.states.names == ("place", "ended")
    # Each of the three first cells with its ended copy, and the goal, which always ends.
    assert task.states.size == 7
    assert cr.solve(task).start_value == 5


def test_a_time_limit_is_no_part_of_a_state():
    plain = cr.tabulate(lambda: TimeLimit(Corridor(), 7), discount=0.5)
    inside = cr.tabulate(
        lambda: TransformReward(TimeLimit(TimeLimit(Corridor(), 9), 7), lambda r: 2 * r),
        discount=0.5,
    )
    assert plain.mdp.time_limit == inside.mdp.time_limit == 7
    assert plain.states.size == inside.states.size == 8
    assert plain.record.cut == inside.record.cut == 0
    assert inside.mdp.reward.max() == 2
    assert cr.tabulate(Corridor, discount=0.5).mdp.time_limit is None
    assert cr.tabulate(Corridor, discount=0.5, time_limit=3).mdp.time_limit == 3


def test_a_clock_of_its_own_is_part_of_a_state_and_truncation_is_no_end():
    task = cr.tabulate(OwnClock, discount=0.5, seeds=[0], max_states=100)
    labels = [task.states.label(s) for s in range(task.states.size)]
    cut = np.array(["taken=3" in label for label in labels])
    ends = task.mdp.terminal
    assert task.record.cut == (cut & ~ends).sum() > 0
    for s in np.flatnonzero(cut & ~ends):
        assert (task.mdp.next_state[task.mdp.outcome_row[s], 0] == s).all()
    assert (cr.solve(task).values[cut] == 0).all()


def test_what_makes_no_difference_is_left_out_or_made_one():
    class Chatty(Corridor):
        """Notes what it was told last, which nobody sees."""

        def step(self, action):
            self.last = int(action)
            return super().step(action)

    ignoring = cr.tabulate(Chatty, discount=0.5, state=DeepCopy(ignore=["last"]))
    task = cr.tabulate(Chatty, discount=0.5)
    assert ignoring.states.size == task.states.size
    assert task.record.explored > task.states.size == 8
    assert task.states.names == ("place", "lit")
    counted = cr.tabulate(Counting, discount=0.5, state=DeepCopy(ignore=["taken"]))
    assert counted.states.names == task.states.names  # as a refusal advises
    assert cr.solve(counted).start_value == cr.solve(task).start_value


def test_a_wrapper_is_read_whole_and_may_read_what_the_lake_draws():
    class Turning(gym.Wrapper):
        """Pays less where the last action was 1, which it keeps under the lake's own name."""

        kept = property(lambda self: self)

        def reset(self, **settings):
            self.lastaction = None
            return self.env.reset(**settings)

        def step(self, action):
            before = self.kept.lastaction
            seen, reward, *rest = self.env.step(action)
            self.lastaction = int(action)
            return seen, reward * (0.1 if before == 1 else 1), *rest

    class Asking(Turning):
        kept = property(lambda self: self.env.unwrapped)

    for kind in (Turning, Asking):
        lake = cr.tabulate(partial(kind, FrozenLakeEnv(is_slippery=False)), discount=0.9)
        assert cr.solve(lake).start_value == pytest.approx(0.9**5)  # of at least 6 steps
        assert lake.record.explored > lake.states.size == 17


def test_an_environment_that_is_given_is_left_alone():
    env = gym.make("FrozenLake-v1", is_slippery=False)
    env.reset(seed=5)
    env.step(1)
    place = env.unwrapped.s
    cr.tabulate(env, discount=0.9, state=DeepCopy())
    assert env.unwrapped.s == place
    assert env.get_wrapper_attr("_elapsed_steps") == 1


PLACES = "environment", "attribute", "standard library", "attribute of an attribute"


@pytest.mark.parametrize("where", [*PLACES, "nobody's"])
def test_random_steps_are_refused_wherever_the_numbers_come_from(where):
    message = r"steps must be deterministic .*outcomes=.*samples="
    if where == "nobody's":  # by chance repeated steps may agree, and a later comparison finds it
        message += "|led elsewhere in"
    with pytest.raises(TaskError, match=message):
        cr.tabulate(lambda: Slippery(where), discount=0.5)


class Thing:
    def __init__(self, owner):
        self.owner = owner


class Healths(Corridor):
    def __init__(self):
        super().__init__()
        self.health = {Thing(self): k for k in range(6)} | {threading.Lock: 0}


class OwnCopy(Slippery):
    """Is copied without the memo, in which its generators would be found."""

    def __deepcopy__(self, memo):
        copy = type(self).__new__(type(self))
        vars(copy).update(deepcopy(vars(self)))
        return copy


def test_dicts_are_read_in_an_order_that_copies_keep():
    task = cr.tabulate(Healths, discount=0.5)
    assert_same_tables(task, cr.tabulate(Corridor, discount=0.5))


@pytest.mark.parametrize(
    ("kind", "where", "state"),
    [
        *itertools.product([Slippery], PLACES, [DeepCopy(), DeepCopy(observed=())]),
        (OwnCopy, "attribute", None),
    ],
)
def test_samples_of_a_step_differ_wherever_the_numbers_come_from(kind, where, state):
    task = cr.tabulate(lambda: kind(where), discount=0.5, state=state, samples=200)
    assert task.mdp.probability[task.mdp.outcome_row[0, 1]].max() == pytest.approx(0.5, abs=0.15)


def test_a_step_is_repeated_from_its_state():
    calls = itertools.count()  # of no environment's state: every second step goes nowhere

    class Fickle(Corridor):
        def step(self, action):
            return super().step(action if next(calls) % 2 else 0)

    with pytest.raises(TaskError, match=r"repeated from one state of .*, led to another state"):
        cr.tabulate(Fickle, discount=0.5)


def test_estimates_say_so_and_come_close():
    settings = {"discount": 0.5, "samples": 500, "state": (save, restore)}
    task = cr.tabulate(lambda: Slippery("attribute", 0.25), **settings)
    assert not task.exact
    here = task.states.encode(place=1, lit=0)
    row = task.mdp.outcome_row[here, 1]
    ahead = task.mdp.next_state[row] == task.states.encode(place=2, lit=0)
    # Five standard deviations of a share of 500.
    assert task.mdp.probability[row][ahead].sum() == pytest.approx(0.75, abs=5 * 0.0194)
    arrived = task.mdp.outcome_row[task.states.encode(place=2, lit=1), 1]
    assert set(task.mdp.reward[arrived][task.mdp.probability[arrived] > 0]) == {0.0, 1.0}
    again = cr.tabulate(lambda: Slippery("attribute", 0.25), **settings)
    np.testing.assert_array_equal(task.mdp.probability, again.mdp.probability)


class Twice(gym.Wrapper):
    """Repeats every step but the last."""

    def step(self, action):
        first = self.env.step(action)
        return first if first[2] else self.env.step(action)


OF_FUNCTIONS = {"state": (save, restore)}
LIES = OF_FUNCTIONS | {"outcomes": lambda s, a: [(1.0, (0, 0), 0.0, False)]}


class Diaries(Toggles):
    def step(self, action):
        self.room1, self.room2 = [self.place], [self.switched, self.place]
        return super().step(action)


NO_FLAG = OF_FUNCTIONS | {"outcomes": lambda s, a: [(1.0, (0, 0), 0.0, "no")]}
REFUSALS = [
    (
        lambda: Twice(TimeLimit(Corridor(), 9)), {},
        "TimeLimit belongs around wrappers that repeat .*: after step 1 .* has counted 2",
    ),
    (Uncopyable, {}, "copying .* failed with TypeError"),
    (Counting, {"max_states": 300}, r"'taken' counts .*, which state=.*\['taken'\]\) leaves out"),
    (Counting, {"max_seconds": 0.2}, "'taken' counts steps"),
    (Counting, {"max_seconds": 0.05}, "within max_seconds, 0.05: "),
    (Toggles, {"max_states": 300}, "more, and 'switched' has the most .*; from_gymnasium plays it"),
    (Diaries, {"max_states": 300}, "more, and 'room2' has the most"),
    (partial(Unseeded, cells=10**6), {}, "resets of .*Unseeded.* with seed 0 differ; let reset"),
    (OldStep, {}, r"must return \(observation, reward, .*: got \(.*shimmy"),
    (lambda: TransformReward(Corridor(), lambda r: np.nan), {}, "must be a finite number: got nan"),
    (Unreadable, {}, r"restore\): a Opaque in it cannot be read .no parts"),
    (Corridor, OF_FUNCTIONS | {"outcomes": lambda s, a: None}, "action 0 in .* lists None"),
    (Corridor, NO_FLAG, "terminated must be True or False: got 'no': action 0 in Where"),
    (Flickering, {}, "led to another observation"),
    (Corridor, {"state": (lambda env: [env.place], restore)}, r"hashable, .*: \[\d\] is a list"),
    (Corridor, LIES, "tables must agree with the environment"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "settings", "said"), REFUSALS)
def test_refusals_are_one_sentence(make, settings, said):
    with pytest.raises(TaskError, match=said) as caught:
        cr.tabulate(make, **{"discount": 0.5, **settings})
    assert "\n" not in str(caught.value)


def test_a_reset_without_a_seed_is_seeded():
    task = cr.tabulate(OldReset, discount=0.5, seeds=4)
    assert_same_tables(task, cr.tabulate(Corridor, discount=0.5, seeds=4))


def test_states_that_look_alike_must_lead_alike():
    seen = cr.tabulate(Counting, discount=0.5, state=DeepCopy(observed=["place", "lit"]))
    assert seen.states.names == ("place", "lit")
    assert_same_tables(seen, cr.tabulate(Corridor, discount=0.5))
    assert repr(seen).endswith(", states that look alike are one, 1 of several resets seen)")
    with pytest.raises(TaskError, match="states must lead alike where they look alike"):
        cr.tabulate(Dark, discount=0.5, state=DeepCopy(observed=()))


def test_settings_are_checked():
    made = partial(cr.tabulate, Corridor)
    check_values(TaskError, made, {"discount": [2]})
    made = partial(made, discount=0.5)
    wrong = {"state": ["deep"], "samples": [10**9], "max_seconds": [-1], "progress": [3]}
    check_values(SettingError, made, wrong)
    check_values(SettingError, MiniGridState, {"own_reward": [3]})
    check_values(SettingError, DeepCopy, {"ignore": ["taken"]})
    with pytest.raises(SettingError, match="nothing in it has takn"):
        made(state=DeepCopy(ignore=["takn"]))
    with pytest.raises(SettingError, match="listed or estimated"):
        made(samples=5, outcomes=lambda s, a: [])
    with pytest.raises(SettingError, match=r"is for MiniGrid's environments: got <Corridor"):
        made(state=MiniGridState())


def test_functions_restore_what_cannot_be_read():
    class Rolling(Unreadable):
        def __init__(self):
            super().__init__()
            self.rolls = np.random.default_rng(3)  # read after what cannot be

    plain = cr.tabulate(Unreadable, discount=0.9, state=(save, restore))
    assert plain.states.size == cr.tabulate(Corridor, discount=0.9).states.size
    access, rolling = SaveAndRestore(save, restore), Rolling()
    access.begin(rolling)
    assert rolling.rolls in access.generators


def test_actions_and_observations_of_several_parts():
    class Board(gym.Env):
        observation_space = gym.spaces.Dict(
            first=gym.spaces.Discrete(3),
            rest=gym.spaces.Tuple([gym.spaces.Box(0, 1, (2,)), gym.spaces.Text(9)]),
        )
        action_space = gym.spaces.MultiDiscrete([2, 2])

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.place = [0, 0]
            return self.seen(), {}

        def seen(self):
            vector = np.array([self.place[1] / 2, 0.5], np.float32)
            return {"first": self.place[0], "rest": (vector, "abc"[self.place[1]])}

        def step(self, action):
            self.place = [min(self.place[i] + int(action[i]), 2) for i in range(2)]
            return self.seen(), -1.0, self.place == [2, 2], False, {}

    task = cr.tabulate(Board, discount=0.9)
    assert task.states.names == ("place_1", "place_2")
    assert task.actions.names == ("action_1", "action_2")
    assert cr.solve(task).start_value == pytest.approx(-1.9)
    for s in range(task.states.size):
        seen = task.observations.batch([s])
        first = {"first": seen["first"][0], "rest": tuple(part[0] for part in seen["rest"])}
        assert task.state(first) == s
        assert task.many(seen).tolist() == [s]
    assert task.state({"first": 0, "rest": (np.zeros(2, np.float32), "z")}) == UNMAPPED
    assert task.state({"first": 0}) == UNMAPPED


def square(n, form=np.array, private=True):
    """Return the class of a square of n x n cells, where it is kept privately or under no name."""

    class Square(gym.Env):
        observation_space, action_space = (gym.spaces.MultiDiscrete([n, n]), gym.spaces.Discrete(4))

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.put([n - 1, 0])
            return form(self.at()), {}

        def put(self, at):
            if private:
                self._at = at
            else:  # in nothing that has a name
                self._world = {"at": at}

        def at(self):
            return self._at if private else self._world["at"]

        def step(self, action):
            move = ((0, 1), (1, 0), (0, -1), (-1, 0))[int(action)]
            self.put([min(max(x + d, 0), n - 1) for x, d in zip(self.at(), move, strict=True)])
            over = self.at() == [0, 0]
            return form(self.at()), float(over), over, False, {}

    return Square


@pytest.mark.parametrize(
    ("form", "private", "names"),
    [
        (np.array, True, ("at_1", "at_2")),
        (np.array, False, ("state_1", "state_2")),
        (tuple, False, ("state_1", "state_2")),
        (lambda at: {"place": np.array(at)}, False, ("place_1", "place_2")),
    ],
)
def test_private_attributes_and_observations_give_names_to_map_by(form, private, names):
    small, large = (cr.tabulate(square(n, form, private), discount=0.9) for n in (3, 5))
    assert small.states.names == names
    assert cr.project(large, small).coverage().mapped == 32 / 96


def test_states_in_the_order_of_discovery_are_never_mapped_by_name():
    def of_reals(at):
        return np.array(at) + 0.5

    small, large = (cr.tabulate(square(n, of_reals, private=False), discount=0.9) for n in (3, 5))
    assert small.states.names == ("state",)
    said = "numbers states as found cannot be read by name: got 'state' for 'state'"
    with pytest.raises(MappingError, match=said):
        cr.project(large, small)
    plain = cr.FiniteMDP.from_dense(np.eye(9)[:, None], np.zeros(9), terminal=np.zeros(9, bool),
                                    start=0, discount=0.9)  # fmt: skip
    for target, source in ((small, plain), (plain, small)):
        with pytest.raises(MappingError, match=said):
            cr.project(target, source, action="action")
    named = cr.tabulate(square(3, of_reals, private=False), discount=0.9, names=["cell"])
    with pytest.raises(MappingError, match="cannot be read by name"):
        cr.project(large, named, cell="state")


def test_a_state_that_is_one_number_is_split_by_sizes():
    of_one = square(3, lambda at: 3 * at[0] + at[1], private=False)
    split = partial(cr.tabulate, of_one, discount=0.9)
    task = split(names=["row", "column"], sizes=[3, 3])
    assert task.states.label(task.state(7)) == "row=2 column=1"
    assert cr.project(task, split(names=["row", "column"], sizes=[4, 3])).coverage().mapped == 1
    for settings, said in (
        ({"names": ["row", "column"], "sizes": [2, 3]}, "the product of sizes must be"),
        ({"sizes": [3, 3]}, "sizes need the names of their components"),
    ):
        with pytest.raises(TaskError, match=said):
            split(**settings)


def test_resets_that_differ_are_said_to_be_some_of_several():
    task = cr.tabulate(Corridor, discount=0.5)
    assert repr(task).endswith(", 1 of several resets seen)")
    assert cr.tabulate(Corridor, discount=0.5, seeds=5).record.several
    assert repr(cr.tabulate(square(3), discount=0.5)).endswith(", exact)")
    listed = cr.tabulate("Taxi-v4", discount=0.9)
    assert repr(listed).endswith(", 1 of several resets seen)")
    sampled = cr.tabulate(Corridor, discount=0.5, samples=3)
    assert repr(sampled).endswith("estimated from 3 steps a pair, 1 of several resets seen)")


@pytest.mark.parametrize("draw", [random.random, np.random.random])
def test_draws_from_global_generators_are_repeated_and_given_back(draw):
    class Slipping(Corridor):
        def reset(self, *, seed=None, options=None):
            return super().reset(seed=0)

        def step(self, action):
            return super().step(action if draw() >= self.chance else 0)

    def slipping(chance):
        made = Slipping()
        made.chance = chance
        return made

    for seed in range(5):
        seed_all(seed)
        with pytest.raises(TaskError, match=r"steps must be deterministic|led elsewhere"):
            cr.tabulate(lambda: slipping(0.3), discount=0.5)
    never = cr.tabulate(lambda: slipping(0.0), discount=0.5)
    assert never.record.drawing == never.record.transitions > 0
    sampled = []
    for seed in range(2):
        seed_all(seed)
        before = drawn_next()
        seed_all(seed)
        sampled.append(cr.tabulate(lambda: slipping(0.3), discount=0.5, samples=20))
        assert drawn_next() == before
    np.testing.assert_array_equal(*(task.mdp.probability for task in sampled))


def seed_all(seed):
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - the global generator is what this is about


def drawn_next():
    return random.random(), np.random.random()  # noqa: NPY002


class Cell(NamedTuple):
    row: int
    column: int


FORMS = {
    "arrays": (np.array, np.array),
    "tuples for arrays": (np.array, tuple),
    "named tuples": (lambda at: Cell(*at), lambda at: Cell(*at)),
    "arrays for named tuples": (lambda at: Cell(*at), np.array),
    "dicts of arrays": (lambda at: {"at": np.array(at)}, lambda at: {"at": np.array(at)}),
}


@pytest.mark.parametrize("name", FORMS)
def test_listed_outcomes_take_observations_of_every_form(name):
    form, listed = FORMS[name]

    def outcomes(state, action):
        place = state["at"] if isinstance(state, dict) else state
        if name.endswith("named tuples"):
            assert state.row == place[0]
        env = square(3)()
        env.put([int(x) for x in place])
        _, reward, over, *_ = env.step(action)
        return [(np.float32(0.9), listed(env.at()), np.float32(reward), over),
                (np.float32(0.1), listed(list(place)), 0.0, False)]  # fmt: skip

    class Sticky(square(3, form)):
        def step(self, action):
            return super().step(action) if self.np_random.random() < 0.9 else self.stay()

        def stay(self):
            return form(self.at()), 0.0, False, False, {}

    task = cr.tabulate(Sticky, discount=0.9, outcomes=outcomes)
    check_refusal(
        TaskError,
        lambda: cr.tabulate(Sticky, discount=0.9, outcomes=lambda *pair: outcomes(*pair)[:1]),
        r"sums to 0\.(9|89)",
    )
    assert task.exact
    assert task.states.size == 9
    assert task.record.checked > 100
    assert [task.state(form([x, y])) for x in range(3) for y in range(3)].count(UNMAPPED) == 0
    arrive = 0.9 / (1 - 0.1 * 0.9)  # discounted, at a next cell
    assert cr.solve(task).start_value == pytest.approx(arrive * (arrive * 0.9))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", [np.float32, lambda r: np.array([r]), lambda r: np.array([[r]])])
def test_rewards_are_numbers_of_every_kind(kind):
    def make():
        return TransformReward(Corridor(), kind)

    task = cr.tabulate(make, discount=0.5)
    plain = cr.tabulate(Corridor, discount=0.5)
    np.testing.assert_array_equal(task.mdp.reward, plain.mdp.reward)
    learnt = [
        cr.learn(cr.from_gymnasium(maker, discount=0.5, time_limit=20), budget=300, seeds=1).values
        for maker in (make, Corridor)
    ]
    np.testing.assert_array_equal(*learnt)
