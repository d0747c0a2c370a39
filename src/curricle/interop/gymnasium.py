"""Any Gymnasium environment as a task: of numbered states, or seen through observations."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from copy import deepcopy
from operator import index
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec

from curricle.checks import whole_number
from curricle.errors import CurricleError, TaskError
from curricle.interop.bins import Bins
from curricle.interop.spaces import Number, Point, counts_from_0, is_discrete, space_of
from curricle.interop.toy_text import has_table, names_of, outcomes_of, start_of
from curricle.tasks.live import LiveMDP
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.observation_task import EnvironmentMaker, ObservationTask
from curricle.tasks.spaces import Component, Space

Environment = gym.Env[Any, Any] | str | EnvSpec | Callable[..., Any]
TimeLimit = int | None | Literal["own"]


def from_gymnasium(
    environment: Environment,
    *,
    discount: float,
    time_limit: TimeLimit = "own",
    states: Space | None = None,
    actions: Space | None = None,
    encode: Callable[[Any], Any] | None = None,
    live: bool = False,
    **make_arguments: Any,
) -> FiniteMDP | LiveMDP:
    """Return a Gymnasium environment of discrete spaces as a task: by its table, or live.

    A transition table (``env.unwrapped.P``: FrozenLake, CliffWalking, Taxi) is copied, and the task
    is solved, evaluated and learnt as fast as any :class:`FiniteMDP`. Every other environment is a
    :class:`LiveMDP`: each step of learning calls ``env.step``.

    Parameters
    ----------
    environment : str, gymnasium.EnvSpec, gymnasium.Env or callable
        An id, a specification, an environment (whose specification makes another for each seed),
        or a function or class that makes one.
    discount : float
    time_limit : int, None or "own"
        Steps after which episodes are truncated; None for none. The environment's own by default.
    states : Space, optional
        Needed with an `encode` that has no attribute ``states``. Without `encode`, other names for
        the observations, in their order.
    actions : Space, optional
        Other names for the actions, in their order.
    encode : callable, optional
        From an observation to a state's number or the tuple of its components' values, such as
        :class:`Bins`.
    live : bool
        Whether to use ``env.step`` even if there is a table.
    **make_arguments
        Arguments of ``gymnasium.make`` or the callable.

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
        not fit, or an environment cannot be made again.

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
    """
    make = maker_of(environment, time_limit, make_arguments)
    if isinstance(environment, gym.Env):
        made: AbstractContextManager[Any] = nullcontext(environment)
    else:
        with refusals_of_make(environment):
            made = closing(make())
    with made as env:
        if not isinstance(env, gym.Env):
            raise TaskError(f"an environment must be a gymnasium.Env: {environment!r} made {env!r}")
        limit: Any = time_limit
        if time_limit == "own":
            limit = None if env.spec is None else env.spec.max_episode_steps
        if encode is None and not live and has_table(env):
            return _from_table(env.unwrapped, states, actions, discount=discount, time_limit=limit)
        if make.what is None:
            raise TaskError(
                "an environment without a specification cannot be made again for each seed; give "
                f"a function that makes it: got {environment}"
            )
        names = names_of(env.unwrapped)
        encode, states = _observations(env.observation_space, encode, states, names[0])
        act, actions = actions_of(env.action_space, actions, names[1])
    return LiveMDP(states, actions, make, encode, act, discount, limit)


def observation_task(
    environment: str | Callable[[], gym.Env[Any, Any]],
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
        An id, or a function that returns a new environment.
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
        Arguments of ``gymnasium.make``.

    Raises
    ------
    TaskError
        When ``gymnasium.make`` or the encoder fails, or does not return an environment.

    Examples
    --------
    >>> observation_task("CartPole-v1", discount=0.98)
    ObservationTask(CartPole-v1, discount 0.98, Box(4,) -> Discrete(2))
    """
    if isinstance(environment, str):
        with refusals_of_make(environment):
            maker = EnvironmentMaker(environment, make_arguments, encode)
            return ObservationTask(maker, discount, time_limit)
    if make_arguments:
        raise TaskError(
            "arguments go with an id of Gymnasium's registry, not with a function: got "
            f"{', '.join(make_arguments)}"
        )
    if encode is not None:
        environment = EnvironmentMaker(environment, encode=encode)
    return ObservationTask(environment, discount, time_limit)


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
    if isinstance(environment, gym.Env) and arguments:
        raise TaskError(
            f"an environment that is already made takes no arguments: got {', '.join(arguments)}"
        )
    what = environment.spec if isinstance(environment, gym.Env) else environment
    if what is not None and not isinstance(what, str | EnvSpec) and not callable(what):
        raise TaskError(
            "an environment must be an id, a specification, a gymnasium.Env or a function that "
            f"makes one: got {what!r}"
        )
    if time_limit != "own" and time_limit is not None:
        time_limit = whole_number("time_limit in steps", time_limit, 1, TaskError)
    if time_limit != "own" and isinstance(what, str | EnvSpec):
        arguments["max_episode_steps"] = -1 if time_limit is None else time_limit
    return EnvironmentMaker(what, arguments)


def _from_table(
    world: Any, states: Space | None, actions: Space | None, **horizon: Any
) -> FiniteMDP:
    """Return the task of an unwrapped environment's table."""
    outcomes = outcomes_of(world)
    n_states = len(outcomes)
    known, moves = names_of(world)
    if known is None or known.size != n_states:
        known = Space([Component("state", n_states)])
    start = np.asarray(start_of(world))
    if start.ndim and n_states > start.size:  # the end that `outcomes_of` added
        start = np.append(start, 0.0)
    states = _renamed("states", states, known)
    actions = _renamed("actions", actions, moves or space_of(world.action_space, "action"))
    return FiniteMDP.from_outcomes(outcomes, start=start, states=states, actions=actions, **horizon)


def actions_of(
    space: gym.Space[Any], given: Space | None, known: Space | None
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
    return act, _renamed("actions", given, own)


def _observations(
    space: gym.Space[Any],
    encode: Callable[[Any], Any] | None,
    given: Space | None,
    known: Space | None,
) -> tuple[Callable[[Any], Any] | None, Space]:
    """Return the function from observations to states, None if they are states; and the space."""
    if encode is not None:
        states = getattr(encode, "states", None) if given is None else given
        if states is None:
            raise TaskError("an encode function needs the states it encodes to: states not given")
        if isinstance(encode, Bins) and space.shape != (len(encode.edges),):
            raise TaskError(
                f"bins must have edges for each entry of an observation, {space.shape}: they have "
                f"edges for {len(encode.edges)}"
            )
        return encode, states
    if not is_discrete(space):
        raise TaskError(
            "observations must be discrete, or be made so by encode=Bins(...) or a function of "
            f"your own with states=Space(...): got {space}"
        )
    number = None if counts_from_0(space) else Number(space)
    return number, _renamed("states", given, known or space_of(space, "state"))


def _renamed(what: str, given: Space | None, own: Space) -> Space:
    """Return the given space, checked to have as many points as `own`; without one `own`."""
    if given is not None and given.size != own.size:
        raise TaskError(f"{what} must name the environment's {own.size}: got {given.size} of them")
    return own if given is None else given
