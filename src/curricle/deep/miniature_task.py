"""Miniatures: small relatives of a task, solved exactly, that networks are distilled from."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from curricle.checks import instance, number, whole_number
from curricle.deep.knowledge import Knowledge
from curricle.deep.solved_member import Examined, SolvedMember
from curricle.errors import TaskError
from curricle.tasks.observation_task import ObservationTask, made_by

RESETS = 200
"""Resets of each miniature that levels are taken from."""
MOST_STATES = 100_000
"""States of a miniature at most."""
HELD_OUT = 0.2
"""Share of the levels that are held out."""


@dataclass(frozen=True)
class Miniatures(ObservationTask):
    """Small relatives of a task, made by :func:`miniatures`.

    In a :class:`Curriculum` it is a source like any other: it takes no steps, and what it hands on
    is a network of its learner's kind, fitted to exact answers (:func:`distil`).

    Attributes
    ----------
    members : tuple of ObservationTask
    tested_on : tuple of ObservationTask
        Relatives that are solved too, all of whose levels are held out.
    resets : int
    held_out : float
    max_states : int
    shuffled : bool
        Whether each observation has the answer of another: a placebo.
    """

    members: tuple[ObservationTask, ...] = ()
    tested_on: tuple[ObservationTask, ...] = ()
    resets: int = RESETS
    held_out: float = HELD_OUT
    max_states: int = MOST_STATES
    shuffled: bool = False

    def __repr__(self) -> str:
        names = ", ".join(made_by(one.make) for one in self.members)
        placebo = ", shuffled" if self.shuffled else ""
        return f"Miniatures({names}; {self.resets} resets{placebo}, {self.shapes})"

    @cached_property
    def solved(self) -> tuple[SolvedMember, ...]:
        """The members, solved; levels are drawn to be held out."""
        return tuple(self._solved(one, self.held_out) for one in self.members)

    @cached_property
    def solved_tests(self) -> tuple[SolvedMember, ...]:
        """The relatives that are only tested on, solved; all their levels are held out."""
        return tuple(self._solved(one, 1.0) for one in self.tested_on)

    def _solved(self, member: ObservationTask, held_out: float) -> SolvedMember:
        return SolvedMember.of(member, self.resets, held_out, self.max_states)

    def knowledge(self, *, potential: Any = None, seed: int = 0) -> Knowledge:
        """Return what is distilled: exact answers, or what a potential says of these observations.

        `seed` is for the order of shuffled answers.
        """
        parts = [each.knowledge(potential) for each in self.solved]
        known = Knowledge.joined(parts)
        return known.shuffled(seed) if self.shuffled else known

    def examined(self, values: Any) -> tuple[Examined, ...]:
        """Return how a network acts on held-out levels, by each member's tables.

        Those of `tested_on` come last. Returns are exact, and no step is taken.

        Parameters
        ----------
        values : NetworkValues
            Of any network that reads these observations.
        """
        return tuple(each.examined(values) for each in (*self.solved, *self.solved_tests))

    @property
    def transitions(self) -> int:
        """Steps of the small models: each action tried in each state, none of them charged."""
        return sum(each.table.record.transitions for each in self.solved)


def miniatures(
    *members: ObservationTask,
    resets: int = RESETS,
    held_out: float = HELD_OUT,
    max_states: int = MOST_STATES,
    tested_on: Sequence[ObservationTask] = (),
) -> Miniatures:
    """Return small relatives of a task as a source that takes no steps.

    Each member is tabulated (:func:`tabulate`) from so many resets and solved. Resets of the same
    level count once. A level is what can be reached from one reset; a share of the levels is held
    out, to see how well the network does there.

    Parameters
    ----------
    *members : ObservationTask
        With the observations and the actions of the task that is to learn from them.
    resets : int
    held_out : float
        Share of levels, up to 0.9; of each member at least one level is not held out.
    max_states : int
        Of each member; one with more is not small.
    tested_on : sequence of ObservationTask
        Relatives that are only tested on, best of growing size.

    Raises
    ------
    TaskError
        When there is no member, or their spaces or discounts differ. When they are first asked for:
        a member cannot be tabulated.

    Examples
    --------
    >>> from curricle import observation_task
    >>> lakes = miniatures(observation_task("FrozenLake-v1", is_slippery=False), resets=1)
    >>> (lake,) = lakes.solved
    >>> lake.levels, lakes.transitions, float(lakes.knowledge().values.max())
    (1, 44, 1.0)
    """
    if not members:
        raise TaskError("miniatures need at least one member: got none")
    instance("tested_on of miniatures", tested_on, Sequence, TaskError)
    for one in (*members, *tested_on):
        instance("each of miniatures", one, ObservationTask, TaskError)
        if isinstance(one, Miniatures):
            raise TaskError(f"each of miniatures must be one environment: got {one}")
        if (one.observations, one.actions) != (members[0].observations, members[0].actions):
            raise TaskError(
                f"miniatures must have one space of observations and actions: {members[0]} and "
                f"{one} differ; an encoder makes observations alike"
            )
        if one.discount != members[0].discount:
            raise TaskError(f"miniatures must have one discount: {members[0]} and {one} differ")
    if members[0].n_actions is None:
        raise TaskError(f"miniatures need numbered actions: {members[0]} has {members[0].actions}")
    whole_number("resets of miniatures", resets, 1, TaskError)
    whole_number("max_states of miniatures", max_states, 1, TaskError)
    number("held_out of miniatures", held_out, TaskError, low=0, high=0.9)
    first = members[0]
    return Miniatures(
        first.make, first.discount, first.time_limit, tuple(members), tuple(tested_on), resets,
        held_out, max_states,
    )  # fmt: skip
