"""Any Gymnasium environment as a task: of numbered states, or seen through observations."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from copy import deepcopy
from operator import index
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec

from curricle.checks import whole_number
from curricle.errors import CurricleError, TaskError
from curricle.interop.encoders import Bins
from curricle.interop.spaces import (
    Number,
    Point,
    counts_from_0,
    is_discrete,
    name_list,
    space_of,
    with_labels,
    with_names,
)
from curricle.interop.tabulation.exploration import time_limit_of
from curricle.interop.tabulation.states import TOY_CONSTANTS, fingerprint, layers_of
from curricle.interop.toy_text import TOY_TEXT, acts_as, has_table, names_of, outcomes_of
from curricle.tasks.live import LiveMDP
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.observation_task import EnvironmentMaker, ObservationTask, check_spaces
from curricle.tasks.spaces import Component, Space

Environment = gym.Env[Any, Any] | str | EnvSpec | EnvironmentMaker | Callable[..., Any]
TimeLimit = int | None | Literal["own"]
GivenStates = Space | tuple[Sequence[str], Sequence[int] | None] | None
"""States as given, or names of their components and sizes that split a number."""
GivenActions = Space | Sequence[str] | None
"""Actions as given, or their labels."""


def from_gymnasium(
    environment: Environment,
    *,
    discount: float,
    time_limit: TimeLimit = "own",
    names: Sequence[str] | None = None,
    sizes: Sequence[int] | None = None,
    states: Space | None = None,
    actions: Space | Sequence[str] | None = None,
    encode: Callable[[Any], Any] | None = None,
    live: bool = False,
    **make_arguments: Any,
) -> FiniteMDP | LiveMDP:
    """Return a Gymnasium environment of discrete spaces as a task: by its table, or live.

    A transition table (``env.unwrapped.P``: FrozenLake, CliffWalking, Taxi) is copied, and the task
    is solved, evaluated and learnt as fast as any :class:`FiniteMDP`. Every other environment, a
    subclass or wrapper with its own `step` too, is a :class:`LiveMDP`: learning calls ``env.step``.

    Parameters
    ----------
    environment : str, gymnasium.EnvSpec, gymnasium.Env or callable
        An id, a specification, an environment (whose specification makes another for each seed),
        or a class or function that makes one.
    discount : float
    time_limit : int, None or "own"
        Steps after which episodes are truncated; None for none. The environment's own by default.
    names : sequence of str, optional
        Of a state's components, in their order: the numbers in an observation.
    sizes : sequence of int, optional
        How many values each of the `names` has, where an observation is one number that stands for
        all of them, the last counting fastest: row * columns + column.
    states : Space, optional
        Needed with an `encode` that has no attribute ``states``. Without `encode`, other names and
        labels for the observations, in their order.
    actions : sequence of str or Space, optional
        A label for each action, or the actions by other names, in their order. States with a
        row and a column are drawn as a grid, with arrows where actions are called north, east,
        south and west, or up, right, down and left.
    encode : callable, optional
        From an observation to a state's number or the tuple of its components' values, such as
        :class:`Bins`.
    live : bool
        Whether to use ``env.step`` even if there is a table.
    **make_arguments
        Arguments of ``gymnasium.make``, or of the class or function.

    Returns
    -------
    FiniteMDP or LiveMDP
        Gymnasium's toy-text environments have named components (row, column; passenger,
        destination; ...) and labelled actions. In others components are called `state` and
        `action`, numbered if there are several, or after the keys of a ``Dict``. Joint actions of a
        MultiDiscrete space have a component for each part.

    Raises
    ------
    TaskError
        When ``gymnasium.make`` fails, a space is not discrete and there is no `encode`, names do
        not fit, or an environment cannot be made again, such as after a change of its `step`.

    Examples
    --------
    >>> lake = from_gymnasium("FrozenLake-v1", discount=0.99)
    >>> lake
    FiniteMDP(16 states, 4 actions, 5 terminal, discount 0.99, time limit 100)
    >>> lake.states.label(6), lake.actions.label(1)
    ('row=1 column=2', 'move=south')
    >>> cart = Bins({"position": [-2.4, 0, 2.4], "velocity": [-1, 0, 1],
    ...              "angle": [-0.2, -0.05, 0, 0.05, 0.2], "spin": [-1, 0, 1]})
    >>> from_gymnasium("CartPole-v1", encode=cart, discount=0.99)
    LiveMDP(32 states, 2 actions, discount 0.99, time limit 500)
    >>> from_gymnasium("Blackjack-v1", discount=0.9, names=["hand", "card", "ace"]).states
    Space(704 points: hand[32] x card[11] x ace[2])
    """
    given = _given_states(states, names, sizes)
    make = maker_of(environment, time_limit, make_arguments)
    if isinstance(environment, gym.Env):
        made: AbstractContextManager[Any] = nullcontext(environment)
    else:
        with refusals_of_make(environment):
            new: Any = make()
        made = closing(checked_environment(environment, new))
    with made as env:
        limit: Any = own_limit(env) if time_limit == "own" else time_limit
        if encode is None and not live and has_table(env):
            world, horizon = env.unwrapped, {"discount": discount, "time_limit": limit}
            return _from_table(world, given, actions, **horizon)
        if make.what is None:
            raise TaskError(
                "an environment without a specification cannot be made again for each seed; give "
                f"a function that makes it: got {environment}"
            )
        if isinstance(environment, gym.Env):
            _check_unchanged(env, make)
        known, moves = names_of(env.unwrapped)
        encode, states = _observations(env.observation_space, encode, given, known)
        act, actions = actions_of(env.action_space, actions, moves)
    return LiveMDP(states, actions, make, encode, act, discount, limit)


def _check_unchanged(env: gym.Env[Any, Any], make: EnvironmentMaker) -> None:
    """Raise TaskError if an environment was changed so that its specification makes another."""
    changed = any({"step", "reset"} & vars(layer).keys() for layer in layers_of(env))
    if not changed and acts_as(env.unwrapped, *TOY_TEXT):
        with refusals_of_make(make), closing(make()) as new:
            tables = [[vars(e.unwrapped).get(name) for name in TOY_CONSTANTS] for e in (env, new)]
        changed = fingerprint(tables[0]) != fingerprint(tables[1])
    if changed:
        raise TaskError(
            "an environment whose step, reset or table was changed cannot be made again for each "
            f"seed; give a function that makes it so: got {env}"
        )


def own_limit(env: gym.Env[Any, Any]) -> int | None:
    """Return the steps after which an environment truncates: its specification's or a wrapper's."""
    limit = None if env.spec is None else env.spec.max_episode_steps
    return time_limit_of(env) if limit is None else limit


def observation_task(
    environment: str | Callable[..., gym.Env[Any, Any]],
    *,
    discount: float = 0.99,
    time_limit: int | None = None,
    encode: Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]] | None = None,
    **make_arguments: Any,
) -> ObservationTask:
    """Return a Gymnasium environment as a task for deep learners, which see its observations.

    Parameters
    ----------
    environment : str or callable
        An id, or a class or function that makes an environment.
    discount : float
        gamma, which environments do not state.
    time_limit : int, optional
        Steps after which episodes are truncated; the environment's own by default.
    encode : callable, optional
        An encoder, from the environment to the same with other observations:
        :class:`MiniGridView`, :class:`MiniGridFullView`, :class:`FlatDict`,
        :class:`StackedFrames`, :class:`FunctionEncoder`, a wrapper's class or a function of one's
        own.
    **make_arguments
        Arguments of ``gymnasium.make``, or of the class or function.

    Raises
    ------
    TaskError
        When ``gymnasium.make`` or the encoder fails, or does not return an environment.

    Examples
    --------
    >>> observation_task("CartPole-v1", discount=0.98)
    ObservationTask(CartPole-v1, discount 0.98, Box(4,) -> Discrete(2))
    """
    make: Callable[[], gym.Env[Any, Any]]
    if isinstance(environment, str) or make_arguments or encode is not None:
        make = EnvironmentMaker(environment, make_arguments, encode)
    else:
        make = environment
    with refusals_of_make(make):
        return ObservationTask(make, discount, time_limit)


def checked_environment(what: Any, made: Any) -> gym.Env[Any, Any]:
    """Return what was made of an environment, or raise TaskError unless it is one with spaces."""
    if not isinstance(made, gym.Env):
        raise TaskError(f"an environment must be a gymnasium.Env: {what!r} made {made!r}")
    check_spaces(made)
    return made


@contextmanager
def refusals_of_make(what: Any) -> Iterator[None]:
    """Raise TaskError for whatever ``gymnasium.make`` raises; a function's errors are its own."""
    try:
        yield
    except CurricleError:
        raise
    except Exception as error:
        what = what.what if isinstance(what, EnvironmentMaker) else what
        if not isinstance(what, str | EnvSpec):
            raise
        name = what if isinstance(what, str) else what.id
        raise TaskError(
            f"an environment must be one that gymnasium.make makes: {name!r} failed with "
            f"{type(error).__name__}: {error}"
        ) from error


def maker_of(
    environment: Environment, time_limit: TimeLimit, arguments: dict[str, Any]
) -> EnvironmentMaker:
    """Return how environments are made; of None if the one given has no specification."""
    arguments = deepcopy(arguments)
    if isinstance(environment, EnvironmentMaker) and environment.encode is None:
        arguments = {**deepcopy(dict(environment.arguments)), **arguments}
        environment = environment.what
    if isinstance(environment, gym.Env) and arguments:
        raise TaskError(
            f"an environment that is already made takes no arguments: got {', '.join(arguments)}"
        )
    what = environment.spec if isinstance(environment, gym.Env) else environment
    known = isinstance(environment, gym.Env) or isinstance(what, str | EnvSpec)
    if not known and not callable(what):
        raise TaskError(
            "an environment must be an id, a specification, a gymnasium.Env, or a class or "
            f"function that makes one: got {what!r}"
        )
    if time_limit != "own" and time_limit is not None:
        time_limit = whole_number("time_limit in steps", time_limit, 1, TaskError)
    if time_limit != "own" and isinstance(what, str | EnvSpec):
        arguments["max_episode_steps"] = -1 if time_limit is None else time_limit
    return EnvironmentMaker(what, arguments)


def _from_table(
    world: Any, states: GivenStates, actions: GivenActions, **horizon: Any
) -> FiniteMDP:
    """Return the task of an unwrapped environment's table."""
    outcomes = outcomes_of(world)
    n_states = len(outcomes)
    known, moves = names_of(world)
    own = known if known and known.size == n_states else Space([Component("state", n_states)])
    start = np.asarray(world.initial_state_distrib)
    if n_states > start.size:  # the end that `outcomes_of` added
        start = np.append(start, 0.0)
    states = _named_states(states, own)
    _, actions = actions_of(world.action_space, actions, moves)
    return FiniteMDP.from_outcomes(outcomes, start=start, states=states, actions=actions, **horizon)


def actions_of(
    space: gym.Space[Any], given: GivenActions, known: Space | None
) -> tuple[Callable[[int], Any], Space]:
    """Return the function from an action's number to the environment's action, and the space.

    Names that are `known` of the environment are left out where a wrapper changed how many actions
    there are.
    """
    if not is_discrete(space):
        raise TaskError(
            f"actions must be discrete (gymnasium.wrappers.DiscretizeAction makes them so): got "
            f"{space}"
        )
    act = index if counts_from_0(space) else Point(space)
    own = space_of(space, "action")
    if known is not None and known.size == own.size:
        own = known
    if given is None or isinstance(given, Space):
        return act, _renamed("actions", given, own)
    return act, with_labels(own, given)


def _observations(
    space: gym.Space[Any],
    encode: Callable[[Any], Any] | None,
    given: GivenStates,
    known: Space | None,
) -> tuple[Callable[[Any], Any] | None, Space]:
    """Return the function from observations to states, None if they are states; and the space."""
    if encode is not None:
        own = given if isinstance(given, Space) else getattr(encode, "states", None)
        if own is None:
            raise TaskError(
                "an encode function needs the states it encodes to, as states=Space(...) or as its "
                f"attribute states: got neither for {encode!r}"
            )
        if isinstance(encode, Bins) and space.shape != (len(encode.edges),):
            raise TaskError(
                f"bins must have edges for each entry of an observation, {space.shape}: they have "
                f"edges for {len(encode.edges)}"
            )
        return encode, own if isinstance(given, Space) else _named_states(given, own)
    if not is_discrete(space):
        raise TaskError(
            "observations must be discrete, or be made so by encode=Bins(...) or a function of "
            f"your own with states=Space(...): got {space}"
        )
    number, own = None if counts_from_0(space) else Number(space), space_of(space, "state")
    return number, _named_states(given, known if known and known.size == own.size else own)


def _given_states(
    states: Space | None, names: Sequence[str] | None, sizes: Sequence[int] | None
) -> GivenStates:
    """Return the states, or the names and sizes of their components; TaskError where both are."""
    if names is None:
        if sizes is not None:
            raise TaskError(f"sizes need names of what has them: got sizes {sizes!r} without names")
        return states
    if states is not None:
        raise TaskError(
            f"names go without states, whose components have names: got both, names {names!r}"
        )
    return name_list(names), sizes


def _named_states(given: GivenStates, own: Space) -> Space:
    """Return states as given, or their own with the names that are given."""
    if given is None or isinstance(given, Space):
        return _renamed("states", given, own)
    names, sizes = given
    if sizes is None and len(own.names) == 1 < len(names):
        raise TaskError(
            f"observations are one number, so sizes must say how many values each of "
            f"{', '.join(names)} has: got names without sizes"
        )
    return with_names(own, names, sizes)


def _renamed(what: str, given: Space | None, own: Space) -> Space:
    """Return the given space, checked to have as many points as `own`; without one `own`."""
    if given is not None and given.size != own.size:
        raise TaskError(f"{what} must name the environment's {own.size}: got {given.size} of them")
    return own if given is None else given
