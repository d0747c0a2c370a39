"""Settings that every test shares."""

import gc
import os
import signal

import pytest
from hypothesis import settings

from curricle.learning import trainers
from curricle.learning.schedules import Schedule
from curricle.tasks import mdp

os.environ["CURRICLE_ALLOW"] = "tests"  # for study files whose functions are in the suite

# A first example may compile a kernel, hence no deadline. Every run of the fast tests tries the
# same examples; `make slow` tries others (--hypothesis-profile explore).
settings.register_profile("same", deadline=None, max_examples=50, derandomize=True, print_blob=True)
settings.register_profile("explore", deadline=None, max_examples=200, print_blob=True)
settings.load_profile("same")

# Most of the suite's time is compilation. The library compiles a loop for every number of actions
# up to UNROLLED, another for tables beyond NEAR bytes, for tables without chance and for rates that
# never change; tests compile one for all of these. oracle/test_greedy_actions.py holds that they
# learn the same.
FEWER_LOOPS = (
    (trainers, "UNROLLED", 0),
    (trainers, "NEAR", 2**62),
    (mdp, "learning_model", mdp.table_model),
    (Schedule, "kernel", property(lambda schedule: schedule)),
)
AS_SHIPPED = [(owner, name, vars(owner)[name]) for owner, name, _ in FEWER_LOOPS]
for owner, name, value in FEWER_LOOPS:
    setattr(owner, name, value)


@pytest.fixture
def as_shipped(monkeypatch):
    """Compile loops as the library does, with all their types."""
    for owner, name, value in AS_SHIPPED:
        monkeypatch.setattr(owner, name, value)


# Compiling makes many objects that live; looking through them again and again takes a tenth of it.
gc.set_threshold(50_000, 10, 10)


def pytest_collection_finish():
    """Leave what was imported out of garbage collection while tests run."""
    gc.freeze()


def pytest_unconfigure():
    """Let modules be collected at the end: some report a leak otherwise."""
    gc.unfreeze()


# A shell that starts a job in the background (`make test &` in a script) has it ignore SIGINT, and
# its children inherit that. The tests that interrupt would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
