"""Live tasks: learning in them, and what goes wrong in an environment surfaces as it is."""

import _thread
import re
import signal
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

import curricle as cr
from curricle.comparison.cost import random_pace
from curricle.errors import TaskError, in_words
from curricle.planning.rollouts import random_rollouts
from curricle.tasks.observation_task import check_observation

from .environments import OFF, TWO, Ring, Watched, watched

TALL = spaces.Box(0, 1, (100,), np.float32)  # so that its observations are cut in an error


def test_each_seed_has_an_environment_of_its_own_and_another_to_be_judged_in():
    log = []
    task = watched(log)
    judged = cr.GreedyEvaluation(episodes=2)
    for evaluation, opened in ((judged, 6), (OFF, 3)):
        log.clear()
        cr.learn(task, budget=50, seeds=3, eval_freq=25, evaluation=evaluation)
        assert log.count("open") == log.count("close") == opened
        assert (log.count("step") > 150) is (evaluation is judged)
        assert len({line for line in log if line.startswith("seed")}) == opened


def test_a_live_task_is_evaluated_by_few_episodes_by_default():
    class Short(Watched):
        def step(self, action):
            return 0, 1.0, True, False, {}

    for evaluation, expected in ((None, 5), (cr.GreedyEvaluation(episodes=8), 8)):
        log = []
        task = cr.from_gymnasium(lambda log=log: Short(log), discount=0.9)
        log.clear()
        cr.learn(task, budget=10, eval_freq=10, evaluation=evaluation)
        # Two checkpoints, and one start for each training step; the last step is none.
        resets = sum(line == "reset" or line.startswith("seed") for line in log)
        assert resets == 2 * expected + 11


class Stay(gym.Env):
    """One place that pays 1 for staying, and cuts every episode off at once."""

    observation_space, action_space = spaces.Discrete(1), spaces.Discrete(1)

    def __init__(self, terminated):
        self.terminated = terminated

    def reset(self, *, seed=None, options=None):
        return 0, {}

    def step(self, action):
        return 0, 1.0, self.terminated, not self.terminated, {}


@pytest.mark.parametrize("learner", [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning])
def test_being_cut_off_is_no_end(learner):
    values, episodes = [], []
    for terminated in (True, False):
        task = cr.from_gymnasium(Stay, discount=0.5, terminated=terminated)
        learnt = cr.learn(task, learner(learning_rate=1.0), 200, evaluation=OFF)
        values.append(learnt.values[0, 0, 0])
        episodes.append(learnt.episodes_used[0])
    assert values == pytest.approx([1.0, 2.0])
    assert episodes == [200, 200]


def test_a_guard_and_a_rollout_see_a_cut_too():
    task = cr.from_gymnasium(Stay, discount=0.5, terminated=False, time_limit=50)
    phi = cr.StateActionPotential(task, [[0.0]])
    shaping = cr.QInitialisation(phi, portfolio=cr.Portfolio())
    rate = cr.QLearning(learning_rate=1.0)
    learnt = cr.learn(task, rate, 100, shaping=shaping, evaluation=OFF)
    assert learnt.episodes_used[0] == 100
    assert learnt.values[0, 0, 0] == pytest.approx(2.0)
    episode = cr.planning.rollout(task, [0])
    assert (len(episode), episode.truncated, episode.terminated) == (1, True, False)


def test_a_time_limit_reaches_the_environment():
    task = cr.from_gymnasium("Taxi-v4", discount=0.9, time_limit=300, live=True)
    env = task.make()
    assert env.spec.max_episode_steps == 300
    result = cr.learn(task, budget=600, evaluation=OFF, learner=cr.QLearning(epsilon=1.0))
    assert result.episodes_used[0] == 2


def lake(**settings):
    return cr.from_gymnasium("FrozenLake-v1", discount=0.95, is_slippery=False, **settings)


def test_tables_transfer_to_a_live_target():
    tabled, live = lake(), lake(live=True)
    plan = cr.Curriculum(
        tasks={"tabled": tabled, "live": live},
        transfers=[cr.Transfer("tabled", "live", cr.project(live, tabled))],
        budget={"tabled": 5000, "live": 2000},
        learner=cr.QLearning(learning_rate=0.5, epsilon=0.3),
        shaping=cr.QInitialisation(),
        eval_freq={"live": 500},
    )
    result = plan.train(seeds=2)
    assert result["live"].greedy_return[:, 0] == pytest.approx([0.95**5] * 2)
    foreseen = cr.forecast(plan, seeds=1, episodes=5)
    assert foreseen.start.potential == pytest.approx(0.95**5)
    comparison = cr.compare(plan, seeds=2, controls=["negated"])
    assert comparison.arms["transfer"].curve.values[:, 0] == pytest.approx([0.95**5] * 2)
    checked = cr.certify(live, cr.QInitialisation(result.potentials["live"][0]))
    assert checked.theorem


def test_what_needs_tables_is_refused():
    tabled, live = lake(), lake(live=True)
    edge = cr.Transfer("tabled", "live", cr.project(live, tabled))
    plan = cr.Curriculum(tasks={"tabled": tabled, "live": live}, transfers=[edge])
    for work in (
        lambda: cr.solve(live),
        lambda: cr.evaluate(live, np.zeros(16, int)),
        lambda: cr.learn(live, budget=10, evaluation=cr.GreedyEvaluation("exact")),
        lambda: cr.compare(plan, seeds=2, controls=["placebo"]),
    ):
        with pytest.raises(cr.errors.TaskError, match="played live has no tables"):
            work()
    with pytest.raises(cr.errors.SettingError, match="environment chooses the start: got start 3"):
        cr.planning.rollout(live, np.zeros(16, int), start=3)
    with pytest.raises(cr.errors.SettingError, match="in episodes needs a task with a time limit"):
        cr.learn(cr.from_gymnasium(Ring, discount=0.9, live=True), budget=cr.Episodes(3))


class Trouble(Exception):
    pass


ERRORS = [Trouble("x"), KeyboardInterrupt(), SystemExit(3), StopIteration()]
LOOPS = {
    "fast": {},
    "general": {"learner": cr.SARSA()},
    "double": {"learner": cr.DoubleQLearning()},
    "sparse": {"storage": cr.Storage("sparse")},
    "episodes": {"budget": cr.Episodes(10_000)},
}


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_exceptions_of_an_environment_are_raised_unchanged(error, loop, capfd):
    log = []

    def fail(log):
        if log.count("step") == 40:
            raise error

    task = watched(log, fail)
    log.clear()
    with pytest.raises(type(error)) as caught:
        cr.learn(
            task,
            **{"budget": 10**9, "eval_freq": 10**6, "seeds": 3, "evaluation": OFF, **LOOPS[loop]},
        )
    assert caught.value is error
    assert log.count("step") == 40  # at once, and no other seed was begun
    assert log.count("open") == log.count("close") == 1
    assert capfd.readouterr() == ("", "")


def fails_at(line, number):
    def fail(log):
        if sum(entry.startswith(line) for entry in log) == number:
            raise Trouble(line)

    return fail


@pytest.mark.parametrize(("line", "number"), [("seed", 1), ("reset", 1), ("seed", 2), ("step", 3)])
def test_failures_anywhere_close_what_was_opened(line, number):
    log = []
    task = watched(log, fails_at(line, number))
    log.clear()
    with pytest.raises(Trouble, match=line):
        cr.learn(task, budget=10_000)
    assert log.count("open") == log.count("close") > 0


def test_failures_outside_of_learning_surface_too():
    task = watched([], fails_at("step", 4))
    for work in (
        lambda: [cr.planning.rollout(task, [0, 0], seed=seed) for seed in range(9)],
        lambda: random_rollouts(task, episodes=100, length=9),
    ):
        task.make().log.clear()
        with pytest.raises(Trouble):
            work()

    class Unclosable(Ring):
        def close(self):
            raise Trouble("close")

    spaces_of_ring = cr.Space([cr.Component("s", 3)]), cr.Space([cr.Component("a", 2)])
    with pytest.raises(Trouble, match="close"):
        cr.learn(cr.tasks.LiveMDP(*spaces_of_ring, Unclosable), budget=10)

    def nothing():
        raise Trouble("make")

    with pytest.raises(Trouble, match="make"):
        cr.learn(cr.tasks.LiveMDP(*spaces_of_ring, nothing), budget=10)
    with pytest.raises(TaskError, match="make of a live task must return an environment: got 0"):
        cr.learn(cr.tasks.LiveMDP(*spaces_of_ring, int), budget=10)


def odd(method, answer):
    """Return a live task whose environment answers this when it is stepped or reset."""
    kind = type("Odd", (Ring,), {method: lambda *_, **__: answer})
    return cr.from_gymnasium(kind, discount=0.9, live=True)


@pytest.mark.parametrize(
    ("task", "message"),
    [
        *((odd("step", answer), "a step of an environment must") for answer in ((0, 1.0), None)),
        *((odd("reset", wrong), "a reset of an environment must") for wrong in (0, (0, {}, {}))),
        *((odd("step", (shown, 1.0, False, False, {})), "encode to a state") for shown in (3, 1.5)),
        *(
            (odd("step", (0, reward, False, False, {})), "rewards must be finite")
            for reward in (None, np.nan, -np.inf, 1e101, 10**400)
        ),
        *(
            (
                odd("step", (0, 1.0, *ends, {})),
                rf"^{name} must be True or False: got {got} for action [01] in state 0$",
            )
            for name, got, ends in (
                ("terminated", "'no'", ("no", False)),
                ("truncated", "None", (False, None)),
                ("terminated", "2", (2, False)),
                ("truncated", r"array\(\[0, 1\]\)", (True, np.arange(2))),
            )
        ),
    ],
)
def test_answers_that_are_not_gymnasiums_are_refused(task, message):
    with pytest.raises(cr.errors.TaskError, match=message):
        cr.learn(task, budget=10, evaluation=OFF)


@pytest.mark.parametrize("end", [1, np.True_, np.array([True]), SimpleNamespace(item=lambda: 1.0)])
def test_flags_may_be_numbers(end):
    task = odd("step", (0, 1.0, end, 0, {}))
    assert cr.learn(task, budget=10, evaluation=OFF).episodes_used[0] == 10


class Untold(Exception):
    def __str__(self):
        raise RuntimeError


def failing(method, error):
    def fails(self, *_, **__):
        raise error

    return type("Fails", (Ring,), {method: fails})


PLACE = r"\(raised in fails of test_live.py, line \d+"


@pytest.mark.parametrize(
    ("method", "error", "words"),
    [
        ("step", KeyError("no"), rf"KeyError: 'no' {PLACE}, for action [01] in state 0\)"),
        ("step", GeneratorExit(), rf"GeneratorExit {PLACE}, for action [01] in state 0\)"),
        ("step", Untold(), rf"Untold, which has no text {PLACE}, for action [01] in state 0\)"),
        ("reset", KeyError("no"), rf"KeyError: 'no' {PLACE}\)"),
    ],
)
def test_an_error_of_an_environment_has_a_place(method, error, words):
    with pytest.raises(Exception) as caught:  # noqa: PT011 - of several kinds
        cr.learn(cr.from_gymnasium(failing(method, error), discount=0.9, live=True), budget=50)
    assert re.fullmatch(words, in_words(caught.value))
    assert error in (caught.value, caught.value.__cause__)  # with the user's traceback


def test_an_error_of_a_tabulated_environment_has_a_place():
    with pytest.raises(KeyError) as caught:
        cr.tabulate(failing("step", KeyError("no")), discount=0.9)
    assert re.search(rf"{PLACE}, for action 0 in state 0 \(.*\)\)$", in_words(caught.value))


@pytest.mark.parametrize(
    ("space", "fits", "differs"),
    [
        (spaces.Box(0, 255, (2,), np.uint8), [3.0, 255], np.array([300, 0])),
        (spaces.Discrete(5), np.int8(2), 2.5),
        (spaces.Box(-9, 9, (2,), np.float32), np.array([0.1, 1e-41]), ["3", 1]),
        (spaces.Box(-9, 9, (1,), np.float16), [np.pi], [10]),
        (spaces.MultiBinary(2), [True, False], [0.5, 1]),
        (spaces.Dict(a=TWO, w=spaces.Text(4)), {"w": "go", "a": 1}, {"w": "go", "a": 0.5}),
        (spaces.Tuple([TWO, spaces.Text(4)]), [1, "go"], (0.5, "go")),
    ],
)
def test_observations_are_compared_before_they_are_converted(space, fits, differs):
    check_observation(space, fits)
    with pytest.raises(TaskError, match="observation must lie in"):
        check_observation(space, differs)


@pytest.mark.parametrize(
    ("space", "observation", "said"),
    [
        (TALL, np.r_[np.zeros(98), 7, 1], "where number 99, 7, is not in [0, 1]; let obser"),
        (spaces.Dict(a=TWO, b=TALL), {"a": 0, "b": np.full(100, np.nan)}, "number 1, nan, is"),
        (spaces.Dict(a=TWO, b=TALL), {"a": 0}, "got {'a': 0}, which has no 'b'; let observation_"),
        (TALL, np.zeros(99), "of shape (99,) instead of (100,); let observation_space state all"),
        (spaces.Box(0, 1, (2,)), [3, "x"], "got [3, 'x']; let observation_space state all"),
    ],
)
def test_what_does_not_fit_in_a_refused_observation_is_said(space, observation, said):
    with pytest.raises(TaskError, match=re.escape(said)):
        check_observation(space, observation)


def test_an_observation_without_a_part_is_refused_at_the_first_reset():
    class Partial(Ring):
        def __init__(self):
            super().__init__()
            self.observation_space = spaces.Dict(a=TWO, b=TWO)

        def reset(self, **_):
            return {"a": 0}, {}

    task = cr.from_gymnasium(Partial, discount=0.9, live=True)
    says = r"observation_space, Dict\('a': Discrete\(2\), 'b': .*: got \{'a': 0\}"
    for refused in (
        lambda: cr.learn(task, budget=10, evaluation=OFF),
        lambda: random_pace(cr.observation_task(Partial, discount=0.9)),
    ):
        with pytest.raises(cr.errors.TaskError, match=says):
            refused()


@pytest.mark.parametrize("turned", [cr.from_gymnasium, cr.tabulate, cr.observation_task])
def test_environments_without_spaces_are_refused(turned):
    class Spaceless(gym.Env):
        pass

    class Half(gym.Env):
        observation_space, action_space = TWO, 2

    with pytest.raises(cr.errors.TaskError, match=r"observation_space of an .* has None"):
        turned(Spaceless, discount=0.9)
    with pytest.raises(cr.errors.TaskError, match=r"action_space of an environment must .* has 2"):
        turned(Half, discount=0.9)


def test_an_interrupt_from_the_keyboard_stops_learning():
    log = []

    def fail(log):
        if log.count("step") == 30:
            _thread.interrupt_main(signal.SIGINT)

    task = watched(log, fail)
    with pytest.raises(KeyboardInterrupt):
        cr.learn(task, budget=10**9, eval_freq=10**6, seeds=2, workers=2)
    assert log.count("open") == log.count("close")
