"""Computed tasks: given by compiled functions instead of tables."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numba import njit
from numba.core.dispatcher import Dispatcher

from curricle.errors import TaskError
from curricle.tasks.generative_models import Functions
from curricle.tasks.mdp import check_parts
from curricle.tasks.spaces import Space

LARGEST = 2**62
"""The most states: larger numbers do not fit the arrays that list them."""


@dataclass(frozen=True, eq=False)
class ComputedMDP:
    """An MDP whose successors are computed by a function, for tasks too large for tables.

    It can be learnt and can be a source or a target of transfer, but :func:`solve` needs tables.

    Parameters
    ----------
    states, actions : Space
        S states and A actions; their numbers are what the functions take and return.
    start : callable
        ``start(data, bits) -> state``: the state an episode starts in. ``bits`` are 64 random
        bits, a uint64; :func:`uniform`, :func:`integers`, :func:`bernoulli` and
        :func:`splitmix64` turn them into numbers.
    step : callable
        ``step(data, state, action, bits) -> (next state, reward, terminated)``. `terminated` must
        depend on the next state alone. Both functions are written in the Python that numba compiles
        (``numba.njit`` applied or not), take state and action as uint64, and must not change
        `data`.
    data : Any
        What the functions read: a number, an array, a NamedTuple of such.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Raises
    ------
    TaskError
        When a space, a function or the horizon is invalid.

    Notes
    -----
    The functions are compiled into the learning loop when a task is first learnt. This takes some
    seconds in each process, as code of a user is not cached on disk.

    Examples
    --------
    A ring of n places with home at 0; a step goes the wrong way with probability 0.1.

    >>> import curricle as cr
    >>> def start(n, bits):
    ...     return 1 + cr.tasks.integers(bits, n - 1)
    >>> def step(n, state, action, bits):
    ...     right = (action == 1) != (cr.tasks.uniform(bits) < 0.1)
    ...     place = (state + (1 if right else n - 1)) % n
    ...     return place, -1.0, place == 0
    >>> ring = ComputedMDP(
    ...     Space([cr.Component("place", 50)]), Space([cr.Component("move", 2)]),
    ...     start, step, data=50, discount=0.99)
    >>> q = cr.learn(ring, budget=200_000).values[0]
    >>> q[[3, 47]].argmax(axis=1)  # home is near, to the left and to the right
    array([0, 1])
    """

    states: Space
    actions: Space
    start: Callable[..., Any]
    step: Callable[..., Any]
    data: Any = 0
    discount: float = 0.99
    time_limit: int | None = 200

    def __post_init__(self) -> None:
        check_parts(self, "computed", "start", "step")
        if self.states.size > LARGEST:
            raise TaskError(
                f"a computed task may have at most 2^62 states: got {self.states.size:,}"
            )

    @property
    def terminal(self) -> None:
        """Unknown: only the step function decides which states end an episode."""

    @cached_property
    def model(self) -> Functions:
        """The generative model for compiled loops."""
        return Functions(_compiled(self.start), _compiled(self.step), self.data)

    def __repr__(self) -> str:
        return (
            f"ComputedMDP({self.states.size:,} states, {self.actions.size} actions, discount "
            f"{self.discount:g})"
        )


def _compiled(function: Callable[..., Any]) -> Any:
    return function if isinstance(function, Dispatcher) else njit(nogil=True)(function)
