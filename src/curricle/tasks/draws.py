"""Compiled random draws: 64 random bits, and the numbers made of them.

A random stream is a (1,) uint64 counter. Drawing adds a constant and mixes the bits of the sum
(SplitMix64; Steele, Lea, Flood 2014), so that the n-th draw depends only on n and on where the
stream started.
"""

import hashlib

import numpy as np

from curricle.tasks.overloads import inlined

STRIDE = np.uint64(0x9E3779B97F4A7C15)
"""What a draw adds to the counter."""
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
    """Return :func:`splitmix64` of a number, outside compiled code."""
    mask = 2**64 - 1
    z = ((number ^ (number >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def stream_start(seed: int, stream: str) -> int:
    """Return where the random stream of this seed and name starts, a 64-bit number."""
    return int.from_bytes(hashlib.blake2b(f"{seed}/{stream}".encode(), digest_size=8).digest())


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
    """Return True with this probability, by the upper 32 bits."""
    return np.float64(bits >> HALF) < probability * 4294967296.0


@inlined
def first_above(rising, value):
    """Return the first index of a rising array whose entry exceeds `value`, by bisection."""
    low, high = np.uint64(0), np.uint64(rising.shape[0])
    while low < high:
        middle = (low + high) >> np.uint64(1)
        if rising[middle] > value:
            high = middle
        else:
            low = middle + np.uint64(1)
    return low
