"""Tables: made of explored states, and kept in a file that the user names."""

import os
import re
import sys
from collections.abc import Collection, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.errors import StoreError
from curricle.files import digest_of, read_saved, write_saved
from curricle.interop.tabulation.exploration import Explored
from curricle.interop.tabulation.states import Environment, Words, fingerprint, layers_of
from curricle.interop.tabulation.tabulated_task import (
    ObservationTable,
    TabulationRecord,
    stacked_observations,
)
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Component, Space
from curricle.transfer.partition_refinement import merged_outcomes, numbered_rows

WIDEST = 10_000
"""Values of a component that is numbered from its lowest to its highest value."""
ABSENT = "absent"
"""The value of a component in states that lack it."""


ANY = "any"
"""The value of a component that makes no difference in a state."""
Part = tuple[Component, IntArray]
"""A component, and its value in each state."""


class Tables(NamedTuple):
    """The tables of S states and A actions; each pair has an outcome row of its own."""

    states: Space
    probability: FloatArray  # (S A, O)
    next_state: IntArray  # (S A, O)
    reward: FloatArray  # (S A, O)
    terminal: BoolArray  # (S,)
    start: FloatArray  # (S,)
    first: IntArray  # the state that each reset leads to
    observations: ObservationTable | None

    def mdp(self, actions: Space, discount: float, time_limit: int | None) -> FiniteMDP:
        """Return the task of these tables."""
        n_pairs = len(self.probability)
        return FiniteMDP(
            states=self.states,
            actions=actions,
            outcome_row=np.arange(n_pairs).reshape(-1, actions.size),
            probability=self.probability,
            next_state=self.next_state,
            reward=self.reward,
            terminal=self.terminal,
            start=self.start,
            discount=discount,
            time_limit=time_limit,
        )


def assembled(found: Explored, n_actions: int, *, sampled: bool, merge: bool) -> Tables:
    """Return the tables of explored states."""
    observations = None
    if all(one is not None for one in found.observations):
        observations = stacked_observations(found.observations, found.terminal)
    rows = _outcome_rows(found, n_actions, sampled)
    terminal = np.array(found.terminal, dtype=bool)
    start = np.zeros(len(terminal))
    start[list(found.start)] = list(found.start.values())
    space, first = Space([Component("state", len(terminal))]), np.array(found.first)
    tables = Tables(space, *rows, terminal, start, first, observations)
    blocks = np.arange(len(terminal))
    if merge and observations is not None:
        blocks = alike(tables, n_actions)
        tables = _merged(tables, blocks, n_actions)
    words, vague = words_of_blocks(found.words, blocks)
    space = named_states(words, tables.terminal, vague)
    return tables._replace(states=space)


def _outcome_rows(
    found: Explored, n_actions: int, sampled: bool
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return probabilities, successors and rewards, (S A, O) each; a terminal state has none."""
    pair, after = np.array(found.pair, np.int64), np.array(found.next_state, np.int64)
    chance, reward = np.array(found.probability), np.array(found.reward)
    if sampled:
        key, which = np.unique(np.stack([pair, after]), axis=1, return_inverse=True)
        pair, after = key
        earned = np.bincount(which, weights=chance * reward)
        chance = np.bincount(which, weights=chance)
        reward = earned / chance
    order = np.argsort(pair, kind="stable")
    pair, after, chance, reward = pair[order], after[order], chance[order], reward[order]
    n_pairs = len(found.terminal) * n_actions
    counts = np.bincount(pair, minlength=n_pairs)
    place = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    shape = n_pairs, max(1, int(counts.max(initial=0)))
    p, s, r = np.zeros(shape), np.zeros(shape, np.int64), np.zeros(shape)
    p[pair, place], s[pair, place], r[pair, place] = chance, after, reward
    return p, s, r


# -- states that are alike ------------------------------------------------------------------------


def alike(tables: Tables, n_actions: int) -> IntArray:
    """Return the block of each state in the coarsest partition that keeps all that matters, (S,).

    States of a block show the same observation, and every action has the same rewards and leads to
    the same blocks with the same probabilities (stochastic bisimulation: Givan, Dean, Greig 2003).
    Blocks are numbered in the order of their first states.
    """
    assert tables.observations is not None
    seen = _observation_rows(tables.observations)
    blocks = _in_order(numbered_rows(np.column_stack([seen, tables.terminal])))
    different, rewards = np.unique(tables.reward, return_inverse=True)
    while True:
        outcomes = blocks[tables.next_state] * len(different) + rewards.reshape(tables.reward.shape)
        after, chance = merged_outcomes(outcomes, tables.probability)
        bits = chance.round(12).view(np.int64)  # equal where the rounded chances are
        pairs = numbered_rows(np.column_stack([after, bits])).reshape(-1, n_actions)
        finer = _in_order(numbered_rows(np.column_stack([blocks, pairs])))
        if finer.max() == blocks.max():
            return finer
        blocks = finer


def _observation_rows(observations: ObservationTable) -> npt.NDArray[Any]:
    """Return the observations as rows of which equal ones are equal, (S, n)."""
    each = [
        np.unique(part.reshape(len(part), -1), axis=0, return_inverse=True)[1].reshape(-1, 1)
        for part in observations.parts.values()
    ]
    return np.concatenate(each, axis=1)


def _in_order(labels: IntArray) -> IntArray:
    """Return labels renumbered in the order in which they first appear."""
    _, first, which = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[which.reshape(-1)]


def _merged(tables: Tables, blocks: IntArray, n_actions: int) -> Tables:
    """Return the tables of blocks instead of states; the first state stands for its block."""
    first = np.unique(blocks, return_index=True)[1]
    pairs = (first[:, None] * n_actions + np.arange(n_actions)).ravel()
    seen = tables.observations
    assert seen is not None
    return Tables(
        tables.states,
        tables.probability[pairs],
        blocks[tables.next_state[pairs]],
        tables.reward[pairs],
        tables.terminal[first],
        np.asarray(np.bincount(blocks, weights=tables.start), dtype=np.float64),
        blocks[tables.first],
        ObservationTable(
            {name: part[first] for name, part in seen.parts.items()}, seen.terminal[first]
        ),
    )


# -- names ----------------------------------------------------------------------------------------


def words_of_blocks(words: Sequence[Words], blocks: IntArray) -> tuple[list[Words], set[str]]:
    """Return the words of each block, `ANY` where they differ, and the names of which some do."""
    found = dict[int, dict[str, int | str]]()
    vague = set[str]()
    for each, block in zip(words, blocks.tolist(), strict=True):
        mine = found.setdefault(block, dict(each))
        for name in {**mine, **each}:
            if mine.get(name) != each.get(name):
                mine[name] = ANY
                vague.add(name)
    return [found[block] for block in sorted(found)], vague


def named_states(words: Sequence[Words], terminal: BoolArray, vague: Collection[str]) -> Space:
    """Return the space whose components are what differs between states.

    Where several states have the same values they are told apart by those with an underscore, then
    those that are vague, by whether they end the episode, `ended`, then by a number, `variant`.
    """
    names = dict.fromkeys(name for each in words for name in each)
    parts = list[Part]()
    for name in sorted(names, key=lambda name: 2 if name in vague else name.startswith("_")):
        public = name not in vague and not name.startswith("_")
        if not public and _count(parts) == len(words):
            break
        values = [each.get(name, ABSENT) for each in words]
        part = _component(_free(name.lstrip("_") or name, parts), values)
        # Of the rest only what tells states apart that are alike so far.
        if part[0].size > 1 and (public or _count([*parts, part]) > _count(parts)):
            parts.append(part)
    if not parts:
        return Space([Component("state", len(words), arbitrary=True)])
    if _copy_numbers(parts).any() and terminal.any() and not terminal.all():
        ended = Component(_free("ended", parts), 2, labels=("no", "yes"))
        parts.append((ended, terminal.astype(np.int64)))
    copies = _copy_numbers(parts)
    if copies.any():
        size = int(copies.max()) + 1
        parts.append((Component(_free("variant", parts), size, arbitrary=True), copies))
    points = np.stack([values for _, values in parts], axis=1)
    return Space([component for component, _ in parts], points)


def _component(name: str, values: Sequence[int | str]) -> Part:
    """Return the component of these values, one a state, and the values as its numbers."""
    if not any(isinstance(value, str) for value in values):
        given = np.array(values, dtype=np.int64)
        low, size = int(given.min()), int(given.max()) - int(given.min()) + 1
        if size <= WIDEST:
            return Component(name, size, low), given
    labels = list(dict.fromkeys(map(str, values)))
    number = {label: i for i, label in enumerate(labels)}
    numbers = np.array([number[str(value)] for value in values], dtype=np.int64)
    return Component(name, len(labels), labels=tuple(labels)), numbers


def _count(parts: Sequence[Part]) -> int:
    """Return how many states are told apart."""
    return int((_copy_numbers(parts) == 0).sum()) if parts else 1


def _copy_numbers(parts: Sequence[Part]) -> IntArray:
    """Return how many states before each have the same values, (S,)."""
    which = numbered_rows(np.stack([values for _, values in parts], axis=1))
    order = np.argsort(which, kind="stable")
    counts = np.bincount(which)
    found = np.empty_like(which)
    found[order] = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    return found


def _free(name: str, parts: Sequence[Part]) -> str:
    """Return a name that no component has yet."""
    return _free(f"{name}_", parts) if name in [part.name for part, _ in parts] else name


KIND = "TabulatedTask"
OBSERVED = "observed "
"""Begins the names of arrays of observations."""
ARRAYS = ("probability", "next_state", "reward", "terminal", "start", "first")
Made = tuple[Tables, TabulationRecord]


def read_tables(path: Path, made_of: dict[str, Any]) -> Made | None:
    """Return the tables of a file, None if there is no file."""
    if not path.exists():
        if not os.access(path.parent, os.W_OK):
            raise StoreError(f"a cache must be a file in a folder that can be written to: {path}")
        return None
    file = read_saved(path, KIND)
    for what, value in made_of.items():
        if file.about.get(what) != value:
            raise StoreError(
                f"a cache must hold tables of the same {what}, or another file be named: {path} "
                f"has {file.about.get(what)}, got {value}"
            )
    try:
        return _tables(file.arrays, file.about)
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{path} is not as tabulate() writes it: {error!r}") from None


def write_tables(
    path: Path, made_of: dict[str, Any], tables: Tables, record: TabulationRecord
) -> None:
    """Write tables, and what they were made of."""
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(tables, name) for name in ARRAYS}
    if tables.states.points is not None:
        arrays["points"] = tables.states.points
    if tables.observations is not None:
        for part, array in tables.observations.parts.items():
            arrays[OBSERVED + part] = array
    about = {
        "components": [asdict(component) for component in tables.states.components],
        "observed": tables.observations is not None,
        "record": asdict(record),
    }
    write_saved(path, KIND, arrays, about | made_of)


def made_of(
    env: Environment, name: str, seeds: Sequence[int], ways: Sequence[Any]
) -> dict[str, Any]:
    """Return what tables are made of, as JSON has it: not the code of environments or functions.

    `ways` are how states are saved and outcomes found. The environment is reset.
    """
    layers = layers_of(env)
    classes = [f"{type(layer).__module__}.{type(layer).__qualname__}" for layer in layers]
    content = b""  # arguments are in it too, of an environment that is no id but a function or made
    for seed in seeds:
        env.reset(seed=seed)
        content += fingerprint(layers, {"_np_random_seed"})
    packages = {"curricle", "gymnasium", type(env.unwrapped).__module__.partition(".")[0]}
    shown = [getattr(way, "__qualname__", repr(way)) for way in ways]
    # MiniGrid's space of missions prints a function with its address, another in every process.
    spaces = re.sub(r" at 0x\w+", "", f"{env.observation_space} {env.action_space}")
    return {
        "environment": name,
        "classes": classes,
        "spaces": spaces,
        "seeds": list(seeds),
        "settings": shown,
        "content after a reset": digest_of(content),
        "versions": {
            package: str(getattr(sys.modules[package], "__version__", ""))
            for package in sorted(packages)
        },
    }


def _tables(arrays: dict[str, npt.NDArray[Any]], about: Any) -> Made:
    """Return tables and their record; KeyError, TypeError or ValueError where they are none."""
    components = [
        Component(**{**component, "labels": component["labels"] and tuple(component["labels"])})
        for component in about["components"]
    ]
    observations = None
    if about["observed"]:
        parts = {
            name.removeprefix(OBSERVED): array
            for name, array in arrays.items()
            if name.startswith(OBSERVED)
        }
        observations = ObservationTable(parts, arrays["terminal"])
    states = Space(components, arrays.get("points"))
    plain: dict[str, Any] = {name: arrays[name] for name in ARRAYS}
    tables = Tables(states=states, observations=observations, **plain)
    record = TabulationRecord(**{**about["record"], "seeds": tuple(about["record"]["seeds"])})
    return tables, replace(record, cached=True)
