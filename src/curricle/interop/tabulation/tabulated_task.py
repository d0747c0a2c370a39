"""A Gymnasium environment as tables, with what is observed in each state."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.display import brief_repr
from curricle.errors import SettingError, TaskError
from curricle.frozen_arrays import Frozen
from curricle.interop.tabulation.observation_table import ObservationTable
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Space
from curricle.text_tables import counted

BATCH = 4096
"""Observations that a model is asked about at once."""


@dataclass(frozen=True)
class TabulationRecord:
    """How tables came about.

    Attributes
    ----------
    environment : str
    seeds : tuple of int
        Those of the resets, each a start as likely as the others.
    samples : int or None
        Steps by which each pair's outcomes were estimated; None if outcomes are exact.
    transitions : int
        Pairs of a state and an action that were tried or listed.
    drawing : int
        Of them those that drew random numbers, and led to one state in each of 8 repetitions all
        the same.
    checked : int
        Steps of episodes in the environment itself that were found in the tables.
    cut : int
        States in which episodes are only ever truncated: every action stays there, with reward 0.
    explored : int
        States found, before those that are alike were made one.
    seconds : float
        Those of the search, by the wall clock.
    observing : float
        Of them those in which states that were found were looked at and described.
    note : str
        What the tables say in another way than the environment, such as rewards.
    cached : bool
        Whether they were found on disk.
    """

    environment: str
    seeds: tuple[int, ...]
    samples: int | None
    transitions: int
    drawing: int = 0
    checked: int = 0
    cut: int = 0
    explored: int = 0
    seconds: float = 0.0
    observing: float = 0.0
    note: str = ""
    cached: bool = False

    __repr__ = brief_repr

    @property
    def transitions_per_second(self) -> float:
        """Pairs a second: saved, restored and stepped, and each step repeated."""
        seconds = self.seconds - self.observing
        return self.transitions / seconds if seconds > 0 else float("inf")


@dataclass(frozen=True, eq=False)
class TabulatedTask(Frozen):
    """A Gymnasium environment as tables of all states that can be reached (:func:`tabulate`).

    It is a :class:`Task`: it is solved, certified, learnt, and mapped by the names of its
    components, like any other.

    Attributes
    ----------
    mdp : FiniteMDP
        The tables, of S states and A actions.
    observations : ObservationTable or None
        What is observed in each state; None where outcomes are listed of states that are no
        observations.
    record : TabulationRecord
        How the tables came about.

    Examples
    --------
    >>> import curricle as cr
    >>> lake = cr.tabulate("FrozenLake-v1", discount=0.99)
    >>> lake
    TabulatedTask(FrozenLake-v1: 16 states, 4 actions, 5 terminal, discount 0.99, ..., exact)
    >>> lake.state(6), lake.states.label(lake.state(6))
    (8, 'row=1 column=2')
    """

    mdp: FiniteMDP
    observations: ObservationTable | None
    record: TabulationRecord

    @property
    def states(self) -> Space:
        """The states, S points."""
        return self.mdp.states

    @property
    def actions(self) -> Space:
        """The actions, A points."""
        return self.mdp.actions

    @property
    def exact(self) -> bool:
        """Whether the tables are the environment's own, not estimates."""
        return self.record.samples is None

    def start_from(self, start: Any) -> Self:
        """Return the task with these probabilities of starting, (S,), for :func:`with_start`."""
        return replace(self, mdp=replace(self.mdp, start=start))

    def state(self, observation: Any) -> int:
        """Return the state that an observation shows; `UNMAPPED` if none does, or several do.

        It is the `encode` of :class:`PotentialShaping` for potentials over these tables.
        """
        return self._observations().state(observation)

    def many(self, observations: Any) -> IntArray:
        """Return the states that n stacked observations show, (n,) int64; as :meth:`state`.

        An :class:`ObservationMapping` reads these tables with it.
        """
        return self._observations().many(observations)

    def policy(self, model: Any, *, deterministic: bool = True) -> IntArray | FloatArray:
        """Return what a model does in each state.

        Parameters
        ----------
        model : object
            With a method ``predict(observations, deterministic=...)`` that returns actions for
            stacked observations, first in a tuple as models of Stable-Baselines3 do, or alone.
        deterministic : bool
            If not, the probability of each action, which Stable-Baselines3 knows of policies with a
            distribution (A2C, PPO).

        Returns
        -------
        (S,) int64 or (S, A) float64 array

        Raises
        ------
        SettingError
            When the model returns what is no action for each observation, or has no distribution.
        """
        table, n_states = self._observations(), self.states.size
        rows = [np.arange(i, min(i + BATCH, n_states)) for i in range(0, n_states, BATCH)]
        if not deterministic:
            return np.concatenate([action_probabilities(model, table.batch(each)) for each in rows])
        chosen = np.concatenate([_actions(model, table.batch(each), len(each)) for each in rows])
        if chosen.min() < 0 or chosen.max() >= self.actions.size:
            raise SettingError(
                f"a model's actions must lie in 0..{self.actions.size - 1}: got "
                f"{chosen.min()}..{chosen.max()}"
            )
        return chosen

    def _observations(self) -> ObservationTable:
        if self.observations is None:
            raise TaskError(
                "a task must know what is observed in its states to look up observations: the "
                f"outcomes of {self.record.environment} are listed of states that are none"
            )
        return self.observations

    def __repr__(self) -> str:
        size = repr(self.mdp).removeprefix("FiniteMDP(").removesuffix(")")
        samples, drawing = self.record.samples, self.record.drawing
        kind = "exact" if samples is None else f"estimated from {counted(samples, 'step')} a pair"
        if drawing:
            kind += f" unless {drawing:,} pairs that draw random numbers rarely use them"
        note = f", {self.record.note}" if self.record.note else ""
        return f"TabulatedTask({self.record.environment}: {size}{note}, {kind})"


def _actions(model: Any, observations: Any, n: int) -> IntArray:
    """Return the actions that a model predicts for n observations, (n,)."""
    found = model.predict(observations, deterministic=True)
    actions = np.asarray(found[0] if isinstance(found, tuple) else found)
    if actions.shape != (n,) or actions.dtype.kind not in "iu":
        raise SettingError(
            f"a model must predict one action for each of {n} observations: got an array of "
            f"{actions.dtype} of shape {actions.shape}"
        )
    return actions.astype(np.int64)


def action_probabilities(model: Any, observations: Any) -> FloatArray:
    """Return the probability of each action under the policy of a model, (n, A)."""
    try:
        policy = model.policy
        tensor, _ = policy.obs_to_tensor(observations)
        found = policy.get_distribution(tensor).distribution.probs
    except AttributeError as error:
        raise SettingError(
            "a policy that is not deterministic must have a distribution over numbered actions, as "
            f"those of A2C and PPO have: a {type(model).__name__} has none ({error})"
        ) from error
    p = found.detach().cpu().numpy().astype(np.float64)
    return np.asarray(p / p.sum(axis=1, keepdims=True))
