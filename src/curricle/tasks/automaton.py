"""A task times a finite automaton of events: reward machines and temporal goals.

A reward may depend on what happened before: an office pays only after coffee was fetched. The
automaton remembers it, as a further component of the states of the product, which is a task again.

Sources: Toro Icarte, Klassen, Valenzano, McIlraith, "Reward machines", JAIR 73, 2022; Camacho et
al., "LTL and beyond", IJCAI 2019.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, Frozen, IntArray
from curricle.checks import number, text
from curricle.errors import TaskError
from curricle.tasks.grid import GridLayout
from curricle.tasks.mdp import FiniteMDP, tables
from curricle.tasks.spaces import Component, Decoded, Space


@dataclass(frozen=True)
class Automaton:
    """A deterministic finite automaton with rewards on its edges.

    An event without an edge changes nothing and pays nothing.

    Parameters
    ----------
    edges : sequence of tuples
        ``(state, event, next_state)`` or ``(state, event, next_state, reward)``, at most one for a
        state and an event, none in terminal states.
    event : callable
        From the decoded states before, actions, and states after a step, each a dict of component
        -> (n,) int64, to the events as (n,) str, "" for no event.
    start : str, optional
        The state in which episodes start; by default that of the first edge.
    terminal : sequence of str
        States that end the episode.
    name : str
        The component of a state that says in which state the automaton is.

    Raises
    ------
    TaskError
        Naming the state or the edge that breaks a rule.

    Examples
    --------
    >>> there = lambda before, action, after: np.where(after["cell"] == 0, "west", "")
    >>> Automaton([("away", "west", "home", 1.0)], there, terminal=["home"]).states
    ('away', 'home')
    """

    edges: Sequence[Any]
    event: Callable[[Decoded, Decoded, Decoded], npt.ArrayLike]
    start: str | None = None
    terminal: Sequence[str] = ()
    name: str = "automaton"

    def __post_init__(self) -> None:
        for name in ("edges", "terminal"):
            listed = getattr(self, name)
            if isinstance(listed, str) or not isinstance(listed, Sequence):
                raise TaskError(f"{name} of an automaton must be a list: got {listed!r}")
        if not callable(self.event):
            raise TaskError(f"event of an automaton must be a function: got {self.event!r}")
        edges = list[tuple[str, str, str, float]]()
        for edge in self.edges:
            if not isinstance(edge, tuple | list) or len(edge) not in (3, 4):
                raise TaskError(
                    f"an edge must be (state, event, next_state), or with a reward: got {edge!r}"
                )
            state, event, next_state, reward = (*edge, 0.0)[:4]
            for part in (state, event, next_state):
                text(f"a state or an event of edge {edge}", part, TaskError)
            if (state, event) in [made[:2] for made in edges]:
                raise TaskError(f"an event has one edge at most in a state: {edge} is another")
            if state in self.terminal:
                raise TaskError(f"an edge must not leave a terminal state: got {edge}")
            paid = number(f"the reward of edge {edge}", reward, TaskError)
            edges.append((state, event, next_state, paid))
        start = edges[0][0] if self.start is None and edges else self.start
        text("the start of an automaton", start, TaskError)
        fields = {"edges": (*edges,), "terminal": (*self.terminal,), "start": start}
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        for state in self.terminal:
            if state == start or state not in self.states:
                raise TaskError(
                    "terminal states of an automaton must be states of edges, and not the start: "
                    f"got {state!r}"
                )

    @property
    def states(self) -> tuple[str, ...]:
        """The U states: the start, then in the order of the edges."""
        ends = [end for edge in self.edges for end in (edge[0], edge[2])]
        return tuple(dict.fromkeys([str(self.start), *ends]))


@dataclass(frozen=True, repr=False)
class TaskWithAutomaton(Frozen):
    """The product that :func:`with_automaton` makes."""

    task: Any
    automaton: Automaton

    @cached_property
    def mdp(self) -> FiniteMDP:
        """The tables of the product: the state of number s U + u is s and u."""
        mdp, automaton = tables(self.task), self.automaton
        follows, paid = _moves(mdp, automaton)
        row, n_automaton = mdp.outcome_row, len(automaton.states)
        labels, points = Component(automaton.name, n_automaton, labels=automaton.states), None
        if mdp.states.points is not None:
            values = np.tile(np.arange(n_automaton), mdp.states.size)[:, None]
            points = np.hstack([np.repeat(mdp.states.points, n_automaton, axis=0), values])
        # The product's pairs in the order (S, U, A), outcomes last.
        after = mdp.next_state[row][:, None] * n_automaton + follows.swapaxes(0, 1)
        reward = mdp.reward[row][:, None] + paid.swapaxes(0, 1)
        chance = np.broadcast_to(mdp.probability[row][:, None], after.shape)
        shape = mdp.states.size * n_automaton, mdp.actions.size, after.shape[-1]
        start = mdp.start[:, None] * (np.arange(n_automaton) == 0)
        ends = mdp.terminal[:, None] | np.isin(automaton.states, automaton.terminal)
        open_ = None if mdp.available is None else np.repeat(mdp.available, n_automaton, axis=0)
        return FiniteMDP.one_row_a_pair(
            Space([*mdp.states.components, labels], points),
            mdp.actions,
            chance.reshape(shape),
            after.reshape(shape),
            reward.reshape(shape),
            terminal=ends.ravel(),
            start=start.ravel(),
            discount=mdp.discount,
            time_limit=mdp.time_limit,
            available=open_,
        )

    states = property(lambda self: self.mdp.states, doc="The task's, and the automaton's state.")
    actions = property(lambda self: self.mdp.actions, doc="The action space of the task.")

    @cached_property
    def layout(self) -> GridLayout:
        """Where the states lie; AttributeError if the task does not say."""
        layout: GridLayout = self.task.layout
        times = len(self.automaton.states)
        markers = {name: np.repeat(at, times, axis=0) for name, at in layout.markers.items()}
        return replace(layout, cells=np.repeat(layout.cells, times, axis=0), markers=markers)

    def __repr__(self) -> str:
        return f"TaskWithAutomaton({self.task!r}, {len(self.automaton.states)} states)"


def with_automaton(task: object, automaton: Automaton) -> TaskWithAutomaton:
    """Return the product of a task and an automaton of events.

    The event of a step moves the automaton; the reward of the edge is added to the task's. The
    episode ends in terminal states of either.

    Parameters
    ----------
    task : Task
        Any task with tables.
    automaton : Automaton

    Raises
    ------
    TaskError
        When the task has no tables, the events are not (n,) str, no edge can be taken, or the
        task has a component of the automaton's name.

    Examples
    --------
    Go to the west end, then to the treasure in the east:

    >>> from curricle import GridWorld, Rewards
    >>> from curricle.planning import solve
    >>> line = GridWorld(".S.T", rewards=Rewards(step=0.0, treasure=0.0), discount=0.5)
    >>> ends = lambda before, action, after: np.select(
    ...     [after["column"] == 0, after["column"] == 3], ["west", "east"], "")
    >>> task = with_automaton(line, Automaton([("0", "west", "1"), ("1", "east", "1", 8.0)], ends))
    >>> float(solve(task).start_value)  # four steps, the last of which pays
    1.0
    """
    made = TaskWithAutomaton(task, automaton)
    _ = made.mdp  # checks it
    return made


def _moves(mdp: FiniteMDP, automaton: Automaton) -> tuple[IntArray, FloatArray]:
    """Return the automaton's next state, and what its edge pays, at each outcome, (U, S, A, O)."""
    states, row = automaton.states, mdp.outcome_row
    possible = (mdp.probability[row] > 0) & ~mdp.terminal[:, None, None]
    state, action, _ = np.nonzero(possible)
    after, decoded = mdp.next_state[row][possible], mdp.states.decode
    event = automaton.event(decoded(state), mdp.actions.decode(action), decoded(after))
    happened = np.asarray(event)
    if happened.shape != after.shape or happened.dtype.kind != "U":
        raise TaskError(
            f"event must return an array of text of shape {after.shape}: got {happened.dtype} of "
            f"shape {happened.shape}"
        )
    kinds, number_of = np.unique(happened, return_inverse=True)
    names = {edge[1]: None for edge in automaton.edges}
    if names and names.keys().isdisjoint(kinds.tolist()):
        raise TaskError(
            f"an automaton needs an event that can happen: its edges have {', '.join(names)}, the "
            f"task has {', '.join(filter(None, kinds.tolist())) or 'none'}"
        )
    follows = np.tile(np.arange(len(states))[:, None], len(kinds))
    paid = np.zeros(follows.shape)
    for at, name, next_state, reward in automaton.edges:
        place = states.index(at), kinds == name
        follows[place], paid[place] = states.index(next_state), reward
    shape = len(states), *possible.shape
    moves = np.zeros(shape, np.int64), np.zeros(shape)
    moves[0][:, possible], moves[1][:, possible] = follows[:, number_of], paid[:, number_of]
    return moves
