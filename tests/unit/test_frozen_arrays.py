"""Nobody can write to what was checked: neither to arrays handed out, nor to those of copies."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import curricle as cr
from curricle.checks import indices
from curricle.learning import SparseValues, TabularPolicy
from curricle.planning.solution import checked_policy
from curricle.tasks.spaces import Component, Space
from tests.support.tasks import random_mdp

MAZE = cr.GridWorld(["S..", ".FT"])
NEAR = MAZE.crop(rows=(0, 2), columns=(1, 3))
HUNT, CHASE = cr.Pursuit(3, 2), cr.Pursuit(3, 1)
COPIES = {
    "itself": lambda value: value,
    "copied": copy.copy,
    "deeply copied": copy.deepcopy,
    "pickled": lambda value: pickle.loads(pickle.dumps(value)),
    "pickled by protocol 5": lambda value: pickle.loads(pickle.dumps(value, protocol=5)),
}


def mapped():
    edge = cr.Transfer("chase", "hunt", cr.project(HUNT, CHASE, predator="predator_1"))
    return cr.Curriculum({"chase": CHASE, "hunt": HUNT}, [edge], budget=50).train()


OWNERS = {
    "tables": lambda: random_mdp(1),
    "maze": lambda: MAZE.mdp,
    "pursuit": lambda: HUNT.mdp,
    "rules of a pursuit": lambda: HUNT,
    "space": lambda: Space([Component("a", 5)], points=[[0], [3]]),
    "state potential": lambda: cr.StatePotential(MAZE, np.ones((2, 6)), frame_steps=[0, 9]),
    "potential": lambda: cr.StateActionPotential(MAZE, np.ones((6, 4))),
    "mapped potential": lambda: mapped().potentials["hunt"][0],
    "mapping": lambda: cr.same_position(MAZE, NEAR),
    "solution": lambda: cr.solve(MAZE),
    "values of a policy": lambda: cr.evaluate(MAZE, np.ones(6, int)),
    "result": lambda: cr.learn(MAZE, budget=50, snapshots=3),
    "sparse result": lambda: cr.learn(MAZE, budget=50, storage=cr.Storage("sparse")).values[0],
    "rollout": lambda: cr.planning.rollout(MAZE, np.ones(6, int)),
    "curve": lambda: cr.statistics.Curve([0, 1], [[1.0, 2.0]]),
    "interval": lambda: cr.statistics.mean_interval([[1.0, 2.0], [2.0, 4.0]]),
}


def arrays_in(value):
    """Return the arrays in a value's fields and public cached properties, at any depth."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, tuple | list):
        return [array for part in value for array in arrays_in(part)]
    if dataclasses.is_dataclass(value):
        return arrays_in([part for name, part in vars(value).items() if name[0] != "_"])
    return []


@pytest.mark.parametrize("owner", OWNERS)
def test_arrays_cannot_be_made_writable(owner):
    made = OWNERS[owner]()
    if hasattr(made, "model"):
        _ = made.model  # also what is computed and kept
    copies = [way(made) for way in COPIES.values()]
    for copied in copies:
        if hasattr(copied, "model"):
            _ = copied.model
        assert arrays_in(copied)
    for array in (array for copied in copies for array in arrays_in(copied)):
        for shown in (array, array.base, array[...], array.view()):
            if isinstance(shown, np.ndarray):
                assert not shown.flags.writeable
                with pytest.raises(ValueError, match="WRITEABLE"):
                    shown.flags.writeable = True
                with pytest.raises(ValueError, match="read-only"):
                    shown[...] = 0


def test_a_copy_leaves_out_what_is_computed():
    _ = HUNT.mdp
    assert len(pickle.dumps(HUNT)) < 1000


def test_the_array_of_a_caller_is_copied_even_where_it_is_read_only():
    """Its owner can make it writable again."""
    mdp = random_mdp(1)
    mine = mdp.next_state.copy()
    mine.flags.writeable = False
    shown = np.asarray(memoryview(mine))
    of_bytes = pickle.loads(pickle.dumps(mine, protocol=4))
    of_bytes.flags.writeable = False
    changed = [dataclasses.replace(mdp, next_state=array) for array in (mine, shown, of_bytes)]
    mine.flags.writeable = True
    of_bytes.flags.writeable = True  # NumPy allows it
    mine[:] = of_bytes[:] = 10**9
    for changed_mdp in changed:
        np.testing.assert_array_equal(changed_mdp.next_state, mdp.next_state)


class Lazy:
    """An array-like that has other numbers from its n-th reading on, and no bounds."""

    def __init__(self, array, n):
        self.array, self.left = np.asarray(array), n

    def __array__(self, dtype=None, copy=None):
        self.left -= 1
        return np.array(self.array if self.left >= 0 else self.array + 10**8, dtype=dtype)


NUMBERED = {
    **{
        f"{name} of tables": lambda lazy, name=name: dataclasses.replace(MAZE.mdp, **{name: lazy})
        for name in ("outcome_row", "probability", "next_state", "reward", "terminal", "start")
    },
    "points of a space": lambda lazy: dataclasses.replace(MAZE.states, points=lazy),
    "steps of a potential": lambda lazy: cr.StatePotential(MAZE, np.ones((2, 6)), lazy),
    "index of a mapping": lambda lazy: dataclasses.replace(
        cr.same_position(MAZE, NEAR), index=lazy
    ),
}
ARRAYS = {name: getattr(MAZE.mdp, name.split()[0]) for name in NUMBERED if "tables" in name} | {
    "points of a space": np.stack(list(MAZE.states.decode().values()), axis=1),
    "steps of a potential": np.array([0, 9]),
    "index of a mapping": cr.same_position(MAZE, NEAR).index,
}


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("field", NUMBERED)
def test_what_is_kept_is_what_was_checked(field, n):
    """Compiled loops read it without bounds checks; a thread or a lazy array may change it."""
    try:
        made = NUMBERED[field](Lazy(ARRAYS[field], n))
    except cr.CurricleError:
        return
    checked_again = dataclasses.replace(made)
    for ours, again in zip(arrays_in(made), arrays_in(checked_again), strict=True):
        np.testing.assert_array_equal(ours, again)


def test_checked_numbers_are_a_copy():
    mine = np.array([0, 1, 2])
    assert not np.shares_memory(indices("states", mine, 3, cr.errors.SettingError), mine)
    policy = np.ones(6, int)
    assert not np.shares_memory(checked_policy(policy, MAZE.mdp.terminal, 4), policy)
    with pytest.raises(cr.errors.SettingError, match=r"0\.\.3: state 0 has 100000001"):
        cr.planning.rollout(MAZE, Lazy(policy, 1))  # reads its type first


@pytest.mark.parametrize("kind", [np.ndarray, np.memmap])
def test_a_lookup_and_sparse_values_are_copied(kind):
    phi = mapped().potentials["hunt"][0]
    strides = phi.lookup.strides.copy().view(kind)
    ours = dataclasses.replace(phi, lookup=phi.lookup._replace(strides=strides))
    strides[:] = 10**9
    np.testing.assert_array_equal(ours.values, phi.values)
    states = np.arange(3).view(kind)
    policy = TabularPolicy(None, SparseValues(states, np.ones((3, 4))))
    states[:] = 10**9
    assert policy.values.states.tolist() == [0, 1, 2]
