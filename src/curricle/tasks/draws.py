"""Compiled random draws: 64 random bits, and what is made of them.

A random stream is a (1,) uint64 counter. Drawing adds a constant and scrambles the sum
(SplitMix64; Steele, Lea, Flood 2014), so that the n-th draw is a function of where the stream
started and of n alone.
"""

from typing import Any

import numpy as np
from numba import njit

INLINED: Any = {
    "nogil": True,
    "forceinline": True,  # a call with arrays would cost more than most of these pieces do
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "_nrt": False,  # pieces make no arrays: no references to count, 80 ns a step if they were
}
"""How a piece of a compiled loop is compiled: into its caller, without a Python entry."""
inlined = njit(**INLINED)

STRIDE = np.uint64(0x9E3779B97F4A7C15)
LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)


@inlined
def splitmix64(number):
    """Return a 64-bit number whose bits all depend on all bits of `number`, one to one."""
    z = number
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def splitmix64_number(number: int) -> int:
    """Return what :func:`splitmix64` makes of a number, outside compiled code."""
    mask = 2**64 - 1
    z = ((number ^ (number >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


@inlined
def draw(stream):
    """Return 64 random bits and advance `stream`."""
    stream[0] += STRIDE
    return splitmix64(stream[0])


@inlined
def uniform(bits):
    """Return a float in [0, 1) made of the upper 53 bits."""
    return np.float64(bits >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inlined
def integers(bits, n):
    """Return a whole number from 0 to n - 1 made of the lower 32 bits."""
    return ((bits & LOW) * np.uint64(n)) >> HALF


@inlined
def bernoulli(bits, probability):
    """Return whether an event of this probability happens, by the upper 32 bits."""
    return np.float64(bits >> HALF) < probability * 4294967296.0


@inlined
def first_above(rising, value):
    """Return the first place of a rising array whose entry exceeds `value`, by bisection."""
    low, high = np.uint64(0), np.uint64(rising.shape[0])
    while low < high:
        middle = (low + high) >> np.uint64(1)
        if rising[middle] > value:
            high = middle
        else:
            low = middle + np.uint64(1)
    return low
