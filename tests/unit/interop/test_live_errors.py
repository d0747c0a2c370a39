"""What goes wrong in an environment surfaces as it is, and closes what was opened."""

import _thread
import signal

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from curricle.transfer.rollouts import greedy_rollouts

from .environments import OFF, TWO, Ring, watched


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
    phi = cr.StateActionPotential(task, np.zeros((2, 2)))
    for work in (
        lambda: [cr.planning.rollout(task, [0, 0], seed=seed) for seed in range(9)],
        lambda: greedy_rollouts(phi, episodes=100),
        lambda: cr.calibrate(phi),
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


def test_an_interrupt_from_the_keyboard_stops_learning():
    log = []

    def fail(log):
        if log.count("step") == 30:
            _thread.interrupt_main(signal.SIGINT)

    task = watched(log, fail)
    with pytest.raises(KeyboardInterrupt):
        cr.learn(task, budget=10**9, eval_freq=10**6, seeds=2, workers=2)
    assert log.count("open") == log.count("close")


def odd(method, answer):
    """Return a live task whose environment answers this when it is stepped or reset."""
    kind = type("Odd", (Ring,), {method: lambda *_, **__: answer})
    return cr.from_gymnasium(kind, discount=0.9, live=True)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        *((odd("step", answer), "a step of an environment must") for answer in ((0, 1.0), None)),
        *((odd("reset", wrong), "a reset of an environment must") for wrong in (0, (0, {}, {}))),
        *((odd("step", (shown, 1.0, False, False, {})), "encode to a state") for shown in (3, 1.5)),
        (odd("step", (0, None, False, False, {})), "rewards must be finite, .* returned None"),
    ],
)
def test_answers_that_are_not_gymnasiums_are_refused(task, words):
    with pytest.raises(cr.errors.TaskError, match=words):
        cr.learn(task, budget=10, evaluation=OFF)


@pytest.mark.parametrize("turned", [cr.from_gymnasium, cr.tabulate, cr.observation_task])
def test_environments_without_spaces_are_refused(turned):
    class Spaceless(gym.Env):
        pass

    class Half(gym.Env):
        observation_space, action_space = TWO, 2

    with pytest.raises(
        cr.errors.TaskError, match=r"observation_space of an environment must .* has None"
    ):
        turned(Spaceless, discount=0.9)
    with pytest.raises(cr.errors.TaskError, match=r"action_space of an environment must .* has 2"):
        turned(Half, discount=0.9)
