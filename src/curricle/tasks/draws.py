"""Compiled random draws: 64 random bits, and the numbers made of them.

A random stream is a (1,) uint64 counter. Drawing adds a constant and mixes the bits of the sum
(SplitMix64; Steele, Lea, Flood 2014), so that the n-th draw depends only on n and on where the
stream started.
"""

import hashlib
from numbers import Integral
from typing import Any

import numpy as np

from curricle.checks import number, whole_number
from curricle.errors import TaskError
from curricle.tasks.overloads import compiled_as, inlined

STRIDE = np.uint64(0x9E3779B97F4A7C15)
"""What a draw adds to the counter."""
LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
ALL = 2**64 - 1


def _mixed(number):
    z = number
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@compiled_as(_mixed)
def splitmix64(number: int) -> int:
    """Return a 64-bit number whose bits all depend on all bits of `number`, one to one.

    In compiled code as in plain Python, like the other functions of this module that are public.

    Examples
    --------
    >>> splitmix64(1)
    6238072747940578789
    """
    z = _bits("number", number)
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & ALL
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & ALL
    return z ^ (z >> 31)


def stream_start(seed: int, stream: str) -> int:
    """Return where the random stream of this seed and name starts, a 64-bit number."""
    return int.from_bytes(hashlib.blake2b(f"{seed}/{stream}".encode(), digest_size=8).digest())


@inlined
def draw(stream):
    """Return 64 random bits and advance `stream`."""
    stream[0] += STRIDE
    return splitmix64(stream[0])


def _uniform(bits):
    return np.float64(bits >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled_as(_uniform)
def uniform(bits: int) -> float:
    """Return a float in [0, 1) made of the upper 53 bits.

    Examples
    --------
    >>> uniform(2**63)
    0.5
    """
    return (_bits("bits", bits) >> 11) / 2**53


def _integers(bits, n):
    return ((bits & LOW) * np.uint64(n)) >> HALF


@compiled_as(_integers)
def integers(bits: int, n: int) -> int:
    """Return a whole number from 0 to n - 1 made of the lower 32 bits; n is at most 2^32.

    Examples
    --------
    >>> integers(splitmix64(2), 6)
    1
    """
    number("n", whole_number("n", n, 1, TaskError), TaskError, high=2**32)
    return ((_bits("bits", bits) & (2**32 - 1)) * int(n)) >> 32


def _bernoulli(bits, probability):
    return np.float64(bits >> HALF) < probability * 4294967296.0


@compiled_as(_bernoulli)
def bernoulli(bits: int, probability: float) -> bool:
    """Return True with this probability, by the upper 32 bits.

    Examples
    --------
    >>> bernoulli(2**63 - 1, 0.5), bernoulli(2**63, 0.5)
    (True, False)
    """
    chance = number("probability", probability, TaskError, low=0, high=1)
    return (_bits("bits", bits) >> 32) < chance * 2**32


def _bits(name: str, given: Any) -> int:
    """Return 64 bits as an int, or raise TaskError."""
    whole = isinstance(given, Integral) and not isinstance(given, bool)
    if not whole or not 0 <= int(given) <= ALL:
        raise TaskError(f"{name} must be a whole number in 0..2^64 - 1: got {given!r}")
    return int(given)


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
