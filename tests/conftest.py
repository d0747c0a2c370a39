"""Settings that every test shares."""

import os
import signal

from hypothesis import settings

from curricle.learning import run

# A first example may compile a kernel, hence no deadline. CI repeats the same examples every time.
settings.register_profile("local", deadline=None, max_examples=50)
settings.register_profile("ci", deadline=None, max_examples=50, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")

# Most of the suite's time is compilation, and loops are compiled for each number of actions up to
# UNROLLED and anew for tables beyond NEAR bytes. Here they are compiled once for all of them;
# oracle/test_greedy_actions.py holds that this changes no result.
UNROLLED, NEAR = run.UNROLLED, run.NEAR
run.UNROLLED, run.NEAR = 0, 2**62

# A shell that starts a job in the background (`make test &` in a script) has it ignore SIGINT, and
# its children inherit that. The tests that interrupt would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
