"""Ctrl-C while loops train: Python answers at once, and the loops end."""

import signal
import threading
import time

import numpy as np
import pytest

import curricle as cr
from curricle.progress import HALTED

MAZE = cr.GridWorld("S...T", time_limit=100)
EXACT = cr.GreedyEvaluation("exact")
LONG = 10**11
SOON = 20.0
"""Seconds for what takes an hour where nothing ends it: much for a machine that is busy."""


@pytest.fixture
def ctrl_c():
    """Return a function that sends SIGINT after half a second, for Python to raise an interrupt.

    `_thread.interrupt_main` wakes no thread that waits, and packages of other tests leave handlers
    of their own.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    main = threading.main_thread().ident
    yield threading.Timer(0.5, signal.pthread_kill, (main, signal.SIGINT)).start
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    ("learner", "settings"),
    [
        (cr.QLearning(), {}),
        (cr.SARSA(), {"seeds": 3, "workers": 2}),
        (
            cr.QLearning(),
            {"shaping": cr.QInitialisation(np.ones((5, 4)), portfolio=cr.Portfolio())},
        ),
        (cr.learning.OptimisticQLearning(), {}),
        (cr.learning.RMax(), {}),
        (cr.QLearning(), {"evaluation": cr.GreedyEvaluation("rollouts", episodes=10**6)}),
    ],
    ids=["fast", "general", "guarded", "optimistic", "r_max", "rollouts"],
)
def test_an_interrupt_ends_learning(learner, settings, ctrl_c):
    settings = {"evaluation": EXACT, **settings}
    cr.learn(MAZE, learner, 100, eval_freq=100, **{**settings, "evaluation": EXACT})
    threads = threading.active_count()
    ctrl_c()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        cr.learn(MAZE, learner, LONG, eval_freq=LONG, **settings)
    while threading.active_count() > threads and time.monotonic() - began < SOON:
        time.sleep(0.01)
    assert threading.active_count() <= threads
    assert time.monotonic() - began < SOON


def test_what_was_halted_is_no_result():
    found = list[BaseException]()

    def work():
        HALTED.set(np.ones(1, np.bool_))  # of this thread alone
        try:
            cr.learn(MAZE, budget=100, workers=1)
        except BaseException as error:
            found.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert [type(one) for one in found] == [KeyboardInterrupt]
