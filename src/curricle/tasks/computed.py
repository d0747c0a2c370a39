"""Computed tasks: given by compiled functions instead of tables."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit, typeof, types
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from curricle.errors import TaskError
from curricle.tasks.generative_models import FAILURE, STEP, Functions
from curricle.tasks.mdp import check_parts
from curricle.tasks.outcomes import REWARD_RULE
from curricle.tasks.spaces import Space, action_name, state_name
from curricle.text import counted

REAL = (types.Integer, types.Float, types.Boolean)
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
        `data`. States are whole numbers in 0..S-1, rewards finite; each step is checked.
    data : Any
        What the functions read: a number, an array, a NamedTuple of such.
    discount, time_limit
        As in :class:`FiniteMDP`.

    Raises
    ------
    TaskError
        When a space, a function or the horizon is invalid; while learning, when a function does
        not compile, or returns a state that does not exist or a reward that is not finite.

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

    @property
    def model(self) -> Functions:
        """A generative model for the compiled loops of one run."""
        start, step = self._functions
        size = np.uint64(self.states.size)
        return Functions(start, step, self.data, size, np.zeros(1, FAILURE))

    @cached_property
    def _functions(self) -> tuple[Any, Any]:
        """The functions, compiled for the types that loops call them with."""
        try:
            data = typeof(self.data)  # type: ignore[no-untyped-call]
        except ValueError:
            raise TaskError(
                f"the data of a computed task must be of types that numba knows: got {self.data!r}"
            ) from None
        state, action, bits = types.uint64, types.uint64, types.uint64
        start, found = _compiled("start", self.start, data, bits)
        _check_type("start", "a state", found, isinstance(found, REAL))
        step, found = _compiled("step", self.step, data, state, action, bits)
        parts = tuple(getattr(found, "types", ()))
        real = len(parts) == 3 and all(isinstance(part, REAL) for part in parts)
        _check_type("step", "a state, a reward and a flag", found, real)
        return start, step

    def __repr__(self) -> str:
        return (
            f"ComputedMDP({counted(self.states.size, 'state')}, "
            f"{counted(self.actions.size, 'action')}, discount {self.discount:g})"
        )


def _compiled(name: str, function: Callable[..., Any], *given: types.Type) -> tuple[Any, Any]:
    """Return a function compiled for these types, and the type that it returns."""
    compiled = function if isinstance(function, Dispatcher) else njit(nogil=True)(function)
    try:
        template: Any = compiled.get_call_template(given, {})[0]
        return compiled, template.cases[0].return_type
    except NumbaError as error:
        said = " ".join(re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split())
        raise TaskError(
            f"{name} of a computed task must be Python that numba compiles: {said[:400]}"
        ) from error


def _check_type(name: str, wanted: str, found: types.Type, fits: bool) -> None:
    if not fits:
        raise TaskError(f"{name} of a computed task must return {wanted}: it returns {found}")


@contextmanager
def opened(task: ComputedMDP) -> Iterator[Functions]:
    """Return a context with a model that loops can run on, which checks the answers at its end."""
    model = task.model
    yield model
    check_answers(task, model)


def check_answers(task: ComputedMDP, model: Functions) -> None:
    """Raise TaskError if a function of the task has returned what makes no sense."""
    failure = model.failure[0]
    if not failure["by"]:
        return
    last, found = task.states.size - 1, float(failure["next_state"])
    asked = "start of a computed task"
    if failure["by"] == STEP:
        state = state_name(task.states, int(failure["state"]))
        action = action_name(task.actions, int(failure["action"]))
        asked = f"step of a computed task for action {action} in {state}"
    if found.is_integer() and 0 <= found <= last:
        raise TaskError(f"{REWARD_RULE}: {asked} returned {failure['reward']:g}")
    raise TaskError(f"a state must be a whole number in 0..{last}: {asked} returned {found:.20g}")
