"""Candidates in which chance is removed: every pair has its likeliest outcome alone."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.design.proposals import DesignTarget, Draft, Made, by_number
from curricle.errors import TaskError
from curricle.tasks.cliff_walking import CliffWalking
from curricle.tasks.deep_sea import DeepSea
from curricle.tasks.four_rooms import FourRooms
from curricle.tasks.frozen_lake import FrozenLake
from curricle.tasks.mdp import FiniteMDP, reachable_states
from curricle.tasks.taxi import Taxi
from curricle.transfer.partition_refinement import merged_outcomes

SWITCHES: dict[type, tuple[str, Any]] = {
    FrozenLake: ("slippery", False),
    CliffWalking: ("slippery", False),
    FourRooms: ("slip", 0.0),
    DeepSea: ("slip", 0.0),
    Taxi: ("rainy", False),
}
"""The parameter by which a task says that moves do what they are meant to."""


def likeliest_outcomes(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target without chance, if there is any in it.

    A task with a parameter for slipping has it switched off. In any other each pair goes to its
    likeliest next state, with the mean reward of going there. That is not defined where two next
    states are equally likely in a state that can be reached, as those of a prey that moves at
    random: the draft then fails.

    Examples
    --------
    >>> from curricle.design.proposals import design_target
    >>> from curricle.tasks import FrozenLake
    >>> (draft,) = likeliest_outcomes(design_target(FrozenLake()))
    >>> draft.build()[0].slippery
    False
    """
    if (np.count_nonzero(target.mdp.probability, axis=1) <= 1).all():
        return
    switch = SWITCHES.get(type(target.task))
    if switch and getattr(target.task, switch[0]) != switch[1]:
        build = partial(_switched, target.task, *switch)
        yield Draft("deterministic", "no slipping", "moves do what they are meant to", build, "")
        return
    words = "every action has its likeliest outcome"
    build = partial(_likeliest, target.task, target.mdp)
    yield Draft("deterministic", "likeliest outcomes", words, build, "")


def _switched(task: Any, name: str, value: Any) -> Made:
    source = replace(task, **{name: value})
    return source, by_number(task, source)


def _likeliest(task: Any, mdp: FiniteMDP) -> Made:
    """Return the tables with one outcome a row; TaskError where two are equally likely."""
    after, chances = merged_outcomes(mdp.next_state, mdp.probability)
    best = chances.max(axis=1)
    ties = np.isclose(chances, best[:, None], rtol=1e-9, atol=0).sum(axis=1) > 1
    met = reachable_states(mdp) & ~mdp.terminal
    bad = np.argwhere(ties[mdp.outcome_row] & met[:, None])
    if len(bad):
        raise TaskError(
            "a likeliest outcome must be the only one: state "
            f"{bad[0][0]}, action {bad[0][1]} has several"
        )
    chosen = np.take_along_axis(after, chances.argmax(axis=1)[:, None], axis=1)
    chosen = np.maximum(chosen, 0)  # rows of terminal states may have no outcome: none is used
    source = replace(
        mdp,
        probability=np.ones((len(chosen), 1)),
        next_state=chosen,
        reward=_mean_reward(mdp, chosen),
    )
    return source, by_number(task, source)


def _mean_reward(mdp: FiniteMDP, chosen: IntArray) -> FloatArray:
    """Return the mean reward of each row where it goes to the chosen state, (Y, 1)."""
    share = np.where(mdp.next_state == chosen, mdp.probability, 0.0)
    total = (share * mdp.reward).sum(axis=1, keepdims=True)
    chance = share.sum(axis=1, keepdims=True)
    return np.asarray(total / np.where(chance > 0, chance, 1.0))
