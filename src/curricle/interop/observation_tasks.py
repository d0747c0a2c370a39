"""Environments as tasks seen through observations."""

from collections.abc import Callable
from typing import Any

import gymnasium

from curricle.errors import TaskError
from curricle.tasks.observation_task import ObservationTask, Registered

Environment = str | Callable[[], gymnasium.Env[Any, Any]]


def observation_task(
    environment: Environment,
    *,
    discount: float = 0.99,
    time_limit: int | None = None,
    **arguments: Any,
) -> ObservationTask:
    """Return an environment as a task for deep learners, which see its observations.

    Parameters
    ----------
    environment : str or callable
        An id of Gymnasium's registry, or a function that returns a new environment.
    discount : float
        gamma, which environments do not state.
    time_limit : int, optional
        Steps after which an episode is cut off; by default the environment's own affair.
    **arguments
        Passed to ``gymnasium.make``.

    Raises
    ------
    TaskError
        When there is no such environment, or the function does not return one.

    Examples
    --------
    >>> observation_task("CartPole-v1", discount=0.98)
    ObservationTask(CartPole-v1, discount 0.98, Box(4,) -> Discrete(2))
    """
    if isinstance(environment, str):
        try:
            return ObservationTask(Registered(environment, arguments), discount, time_limit)
        except (gymnasium.error.Error, ImportError) as error:
            raise TaskError(
                f"an environment must be one of Gymnasium's registry: {environment!r} failed with "
                f"{type(error).__name__}: {error}"
            ) from error
    if arguments:
        raise TaskError(
            "arguments go with an id of Gymnasium's registry; a function knows its own: got "
            f"{', '.join(arguments)}"
        )
    return ObservationTask(environment, discount, time_limit)
