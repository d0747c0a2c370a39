"""The draws of tasks give the same numbers in plain Python and compiled, and never crash."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numba import njit

from curricle.errors import TaskError
from curricle.tasks import bernoulli, integers, splitmix64, uniform

BITS = st.integers(0, 2**64 - 1)


@njit
def compiled(bits, n, probability):
    return splitmix64(bits), uniform(bits), integers(bits, n), bernoulli(bits, probability)


@given(BITS, st.integers(1, 2**32), st.floats(0, 1))
def test_plain_and_compiled_draws_are_the_same(bits, n, probability):
    plain = splitmix64(bits), uniform(bits), integers(bits, n), bernoulli(bits, probability)
    assert plain == compiled(np.uint64(bits), n, probability)
    assert 0 <= plain[1] < 1
    assert 0 <= plain[2] < n


@given(BITS)
def test_numbers_of_numpy_are_bits_too(bits):
    assert splitmix64(np.uint64(bits)) == splitmix64(bits)


@pytest.mark.parametrize("bits", [-1, 2**64, 10**100, 0.5, True, None, "x", [1], np.zeros(2)])
@pytest.mark.parametrize("draw", [uniform, splitmix64, lambda bits: integers(bits, 3)])
def test_what_is_no_64_bits_is_refused(draw, bits):
    with pytest.raises(TaskError, match=r"must be a whole number in 0\.\.2\^64 - 1"):
        draw(bits)


@pytest.mark.parametrize("n", [0, -1, 2**32 + 1, 2**70, 0.5, float("nan"), None, "x"])
def test_a_draw_among_no_numbers_is_refused(n):
    with pytest.raises(TaskError, match="n must"):
        integers(1, n)


@pytest.mark.parametrize("chance", [-0.1, 1.1, float("nan"), None, "x"])
def test_what_is_no_probability_is_refused(chance):
    with pytest.raises(TaskError, match="probability must"):
        bernoulli(1, chance)


def test_calls_from_python_do_not_end_the_interpreter():
    """They did by a segmentation fault, so this runs in a process of its own."""
    calls = "import curricle.tasks as t; t.uniform(7); t.integers(7, 3); t.splitmix64(7)"
    ended = subprocess.run([sys.executable, "-c", calls + "; t.bernoulli(7, 0.5)"], check=False)
    assert ended.returncode == 0


def test_no_public_name_is_a_compiled_function():
    """Those of the library have no entry from Python: calling one ends the process."""
    import curricle

    for face in curricle.tasks, curricle.planning, curricle.learning, curricle.transfer, curricle:
        for name in face.__all__:
            assert not hasattr(getattr(face, name), "py_func"), name
