"""The identity between tasks of one shape: each pair reads the same pair of the source."""

from typing import Any, overload

import gymnasium as gym
import numpy as np

from curricle.arrays import IntArray
from curricle.errors import MappingError
from curricle.tasks.observation_task import ObservationTask, space_text
from curricle.tasks.spaces import Component, Space
from curricle.tasks.task import Task, generative_model
from curricle.transfer.mapping import StateActionMapping, pair_mapping
from curricle.transfer.observation_mapping import ObservationMapping

RULE = "identity needs tasks of one shape"


@overload
def identity(
    target: ObservationTask, source: ObservationTask | None = None
) -> ObservationMapping: ...
@overload
def identity(target: Task, source: Task | None = None) -> StateActionMapping: ...
def identity(target: Any, source: Any = None) -> Any:
    """Return the mapping of each state and action to the same one of a task of the same shape.

    Of one shape are tasks whose states and actions have as many components, with the same values in
    the same order, whatever they are called: a slippery lake and one that is not. Observations must
    have the same shape. Without a source it is the mapping of a task onto itself.

    Parameters
    ----------
    target, source : Task or ObservationTask
        Both with numbered states, or both seen through observations.

    Returns
    -------
    StateActionMapping or ObservationMapping

    Raises
    ------
    MappingError
        When the shapes differ, saying how.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> easy, hard = GridWorld("S.T"), GridWorld("SPT")
    >>> identity(hard, easy).index[0]
    array([0, 1, 2, 3])
    >>> identity(hard, GridWorld("S..T"))
    Traceback (most recent call last):
    curricle.errors.MappingError: identity needs tasks of one shape: the target's states have
    column[3], the source's column[4]; project maps by name what both have
    """
    source = target if source is None else source
    if isinstance(target, ObservationTask):
        check_same_observations(target, source)
        return ObservationMapping(target, source)
    to, of = generative_model(target), generative_model(source)
    for what, own, other in (("states", to.states, of.states), ("actions", to.actions, of.actions)):
        _check(what, own, other)
    states, actions = np.arange(to.states.size), np.arange(to.actions.size)
    return pair_mapping(target, source, states[:, None], actions)


def _check(what: str, target: Space, source: Space) -> None:
    """Raise MappingError unless two spaces have the same points."""
    hint = "project maps by name what both have"
    if len(target.components) != len(source.components):
        raise MappingError(
            f"{RULE}: the target's {what} have {', '.join(target.names)}, the source's "
            f"{', '.join(source.names)}; {hint}"
        )
    for own, other in zip(target.components, source.components, strict=True):
        mine, yours = _values(own), _values(other)
        if mine != yours:
            raise MappingError(
                f"{RULE}: the target's {what} have {own.name}{mine}, the source's "
                f"{other.name}{yours}; {hint}"
            )
        labels = own.labels or (), other.labels or ()
        if labels[0] != labels[1] and set(labels[0]) == set(labels[1]):
            raise MappingError(
                f"{RULE}: values of {own.name} are {', '.join(labels[0])} in the target and "
                f"{', '.join(labels[1])} in the source; {hint}"
            )
    if (target.is_box and source.is_box) or np.array_equal(_points(target), _points(source)):
        return
    raise MappingError(
        f"{RULE}: {what} of {', '.join(target.names)} are {target.size:,} in the target and "
        f"{source.size:,} in the source, not the same ones in the same order; {hint}"
    )


def _points(space: Space) -> IntArray:
    return np.stack(list(space.decode().values()), axis=1)


def _values(component: Component) -> str:
    """Return a component's values in short: how many, and from which if not from 0."""
    low = f" from {component.low}" if component.low else ""
    return f"[{component.size}{low}]"


def check_same_observations(target: ObservationTask, source: Any) -> None:
    """Raise MappingError where a source is seen through observations of another shape."""
    if not isinstance(source, ObservationTask):
        return
    mine, yours = target.observations, source.observations
    if _form(mine) != _form(yours):
        raise MappingError(
            f"{RULE}: the target's observations are {space_text(mine)}, the source's "
            f"{space_text(yours)}; a function of observations maps others"
        )


def _form(space: gym.Space[Any]) -> Any:
    """Return what must agree of two spaces of observations: their parts and shapes."""
    if isinstance(space, gym.spaces.Dict):
        return {key: _form(part) for key, part in space.spaces.items()}
    if isinstance(space, gym.spaces.Tuple):
        return [_form(part) for part in space.spaces]
    counts = getattr(space, "n", None), getattr(space, "nvec", None)
    return type(space).__name__, space.shape, str(counts)
