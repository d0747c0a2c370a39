"""The families that come with the library: members are what they say, and map onto each other."""

import numpy as np
import pytest

from curricle import solve
from curricle.errors import MappingError, TaskError
from curricle.tasks import (
    BlockDude,
    CliffWalking,
    DeepSea,
    FourRooms,
    FrozenLake,
    KeyLockPit,
    RiverSwim,
    Taxi,
    block_dude_family,
    cliff_walking_family,
    deep_sea_family,
    four_rooms_family,
    frozen_lake_family,
    goal_distance,
    key_lock_pit_family,
    river_swim_family,
    taxi_family,
)
from curricle.tasks.block_dude import PARTS, part_of_level
from curricle.tasks.built_in import BUILT_IN
from curricle.tasks.frozen_lake import random_lake
from curricle.tasks.mdp import generative_model
from curricle.transfer import ENDED, family_mappings

RELATIVES = {
    "maze": [{"size": 5}, {"size": 3, "start": "uniform"}],
    "pursuit": [{"size": 3}, {"size": 3, "predators": 1}],
    "frozen_lake": [
        {"map": "8x8", "slippery": False},
        {"map": "8x8", "part": 5, "slippery": False},
    ],
    "cliff_walking": [{"columns": 10}, {"columns": 5}],
    "taxi": [{}, {"size": 3, "stands": 2}],
    "four_rooms": [{"start": "uniform"}, {"size": 9, "slip": 0.1}],
    "key_lock_pit": [{"size": 8}, {"size": 6}],
    "block_dude": [{"columns": 12}, {"columns": 10}],
    "river_swim": [{"size": 10}, {"size": 6}],
    "deep_sea": [{"size": 10}, {"size": 6}],
}


def test_the_defaults_are_those_of_the_domains():
    assert frozen_lake_family().task == FrozenLake()
    assert cliff_walking_family().task == CliffWalking()
    assert taxi_family().task == Taxi()
    assert four_rooms_family().task == FourRooms()
    assert key_lock_pit_family().task == KeyLockPit()
    assert block_dude_family().task == BlockDude()
    assert river_swim_family().task == RiverSwim()
    assert deep_sea_family().task == DeepSea()


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_member_maps_onto_itself_pair_by_pair(name):
    family = BUILT_IN[name]
    member = family(**RELATIVES[name][-1])
    (mapping,) = family_mappings(member, member)
    task = generative_model(member.task)
    pairs = np.arange(task.states.size * task.actions.size).reshape(mapping.index.shape)
    assert (mapping.index == np.where(task.terminal[:, None], ENDED, pairs)).all()


@pytest.mark.parametrize("name", BUILT_IN)
def test_easier_members_are_built_and_read(name):
    target, source = (BUILT_IN[name](**given) for given in RELATIVES[name])
    easier = list(BUILT_IN[name].easier(source))
    assert all(one.family == target.family and one != source for one in easier)
    for one in easier[-3:]:
        assert generative_model(one.task).states.size >= 2
        for mapping in family_mappings(target, one):
            assert mapping.coverage().mapped > 0


@pytest.mark.parametrize(
    ("name", "correlation", "agreement"),
    [
        ("maze", 0.99, 0.99),
        ("pursuit", 0.7, 0.6),
        ("frozen_lake", 0.99, 0.99),
        ("cliff_walking", 0.8, 0.95),
        ("taxi", 0.9, 0.8),
        ("four_rooms", 0.9, 0.8),
        ("key_lock_pit", 0.95, 0.99),
        ("block_dude", 0.9, 0.9),
        ("river_swim", 0.9, 0.95),
        ("deep_sea", 0.99, 0.99),
    ],
)
def test_the_values_of_a_relative_are_worth_reading(name, correlation, agreement):
    """Where the mapping reads something: the order of states, and the share of optimal actions."""
    target, source = (BUILT_IN[name](**given) for given in RELATIVES[name])
    own, values = solve(target.task).action_values, solve(source.task).action_values
    read = [f.read(values) for f in family_mappings(target, source)]
    phi = np.ma.masked_invalid(read).mean(axis=0).filled(np.nan)
    known = ~np.isnan(phi).all(axis=1) & ~generative_model(target.task).terminal
    assert known.mean() > 0.2
    phi, own = np.nan_to_num(phi[known], nan=-np.inf), own[known]
    assert np.corrcoef(phi.max(axis=1), own.max(axis=1))[0, 1] > correlation
    best = own[np.arange(len(own)), phi.argmax(axis=1)] > own.max(axis=1) - 1e-6
    assert best.mean() > agreement


def test_parts_of_lakes():
    whole, part = frozen_lake_family(map="8x8"), frozen_lake_family(map="8x8", part=4)
    assert part.task == FrozenLake("8x8").crop(rows=(4, 8), columns=(4, 8))
    (mapping,) = family_mappings(whole, part)
    row, column = whole.task.layout.cells.T
    inside = (row >= 4) & (column >= 4)
    assert ((mapping.index != -1).all(axis=1) == inside | whole.task.mdp.terminal).all()
    drawn = frozen_lake_family(map="random", size=6, seed=9, frozen_share=0.7)
    assert drawn.task.map == random_lake(6, 0.7, 9)
    easier = frozen_lake_family.easier(frozen_lake_family(slippery=False))
    assert [one["part"] for one in easier] == [2, 3]


@pytest.mark.parametrize("seeds", [(None, 3), (3, None), (3, 4), (3, 3)])
def test_right_moves_are_read_as_right_moves(seeds):
    target, source = (
        deep_sea_family(size=n, mapping_seed=seed) for n, seed in zip((6, 4), seeds, strict=True)
    )
    (mapping,) = family_mappings(target, source)
    states = np.flatnonzero((mapping.index >= 0).all(axis=1))
    assert len(states) == 4 * 5 // 2
    read = mapping.index[states, target.task.right[states]]
    assert (read % 2 == source.task.right[read // 2]).all()


@pytest.mark.parametrize(("size", "smaller"), [(13, 9), (13, 7), (20, 13), (9, 13)])
def test_hallways_are_read_as_hallways(size, smaller):
    target, source = four_rooms_family(size=size), four_rooms_family(size=smaller)
    (mapping,) = family_mappings(target, source)
    for name, (row, column) in target.task.hallways.items():
        pair = mapping.index[target.task.states.encode(row=row, column=column), 0]
        if name == "east":
            assert pair == ENDED
        else:
            cell = source.task.states.points[pair // 4]
            assert tuple(cell) == source.task.hallways[name]


@pytest.mark.parametrize("size", range(4, 12))
def test_keys_pits_and_locks_are_read_as_such(size):
    target, source = key_lock_pit_family(size=11), key_lock_pit_family(size=size)
    (mapping,) = family_mappings(target, source)
    own, other = target.task, source.task
    key = mapping.index[own.states.encode(row=1, column=1, key=0, lock=0), 4]
    assert other.states.label(key // 6) == "row=1 column=1 key=lying lock=locked"
    lock = mapping.index[own.states.encode(row=10, column=10, key=1, lock=0), 5]
    assert other.mdp.terminal[other.mdp.next_state[other.mdp.outcome_row.ravel()[lock], 0]]


@pytest.mark.parametrize("level", [1, 3])
def test_parts_of_levels_are_those_with_a_way_to_the_exit(level):
    solvable = []
    for columns in range(2, 20):
        part = part_of_level(level, columns=columns)
        task, blocks = part.mdp, sum(line.count("B") for line in part.level)
        if (
            blocks
            and task.terminal.any()
            and goal_distance(task, task.terminal)[task.start_states[0]] > 0
        ):
            solvable.append(columns)
    assert solvable == [columns for columns in PARTS[level] if columns < 20]
    members = block_dude_family.members(level=level, columns=range(2, 20))
    assert [member["columns"] for member in members] == solvable


def test_a_level_reads_no_more_blocks_than_it_has():
    with pytest.raises(MappingError, match="a level reads levels with at most its 1 blocks"):
        family_mappings(block_dude_family(columns=10), block_dude_family())


def test_stands_are_read_as_stands():
    target, source = taxi_family(), taxi_family(size=3)
    (mapping,) = family_mappings(target, source)
    for own, other in zip(target.task.stand_cells, source.task.stand_cells, strict=True):
        row, column = np.divmod(own, 5)
        state = target.task.states.encode(row=row, column=column, passenger=4, destination=1)
        read = mapping.index[state, 0]
        if read == ENDED:
            continue
        values = source.task.states.decode(read // 6)
        assert values["row"] * 3 + values["column"] == other


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: frozen_lake_family(map="4x4", part=4), "than the lake's 4 rows: got frozen_lake"),
        (lambda: frozen_lake_family(map="random", size=5, part=6), "less than the lake's 5 rows"),
        (lambda: frozen_lake_family(size=6), "size of frozen_lake is of random lakes"),
        (lambda: river_swim_family(forward=0.7, back=0.5), "be at most 1 together: got river_swim"),
        (lambda: block_dude_family(columns=7), "must be one of 10, 11, .* no way to the exit: got"),
    ],
)
def test_bad_members_are_refused_in_a_sentence(wrong, said):
    with pytest.raises(TaskError, match=said):
        wrong()
