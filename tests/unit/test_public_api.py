"""The public names: they resolve, are documented, load lazily, and hand out frozen things."""

import dataclasses
import inspect
import subprocess
import sys

import numpy as np
import pytest

import curricle
from curricle import (
    Curriculum,
    FiniteMDP,
    GridWorld,
    Pursuit,
    StateActionPotential,
    StatePotential,
    Transfer,
    learn,
    same_position,
    solve,
)

CONSTANTS = {"ENDED", "UNMAPPED"}
ALIASES = {"How"}
DATACLASSES = [
    name
    for name in curricle.__all__
    if inspect.isclass(getattr(curricle, name)) and dataclasses.is_dataclass(getattr(curricle, name))
]


@pytest.mark.parametrize("name", curricle.__all__)
def test_every_public_name_resolves_and_is_documented(name):
    found = getattr(curricle, name)
    if name in CONSTANTS | ALIASES:
        return
    # A NamedTuple or dataclass without a docstring is given one, its own signature.
    assert inspect.getdoc(found)
    assert not inspect.getdoc(found).startswith(f"{name}(")


def test_all_is_sorted_into_dir_and_unknown_names_fail():
    assert set(curricle.__all__) <= set(dir(curricle))
    assert len(set(curricle.__all__)) == len(curricle.__all__)
    with pytest.raises(AttributeError):
        _ = curricle.no_such_name


@pytest.mark.parametrize("heavy", ["numba", "matplotlib", "pyarrow"])
def test_import_alone_loads_nothing_heavy(heavy):
    code = f"import sys, curricle; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("name", DATACLASSES)
def test_public_dataclasses_are_frozen(name):
    assert getattr(curricle, name).__dataclass_params__.frozen


def test_the_tree_of_exceptions():
    for name in ("Task", "Setting", "Potential", "Mapping", "Curriculum"):
        error = getattr(curricle, f"{name}Error")
        assert issubclass(error, curricle.CurricleError)
        assert issubclass(error, ValueError)
    assert issubclass(curricle.StoreError, curricle.CurricleError)


def test_unmapped_and_ended_are_told_apart_by_sign():
    assert curricle.UNMAPPED != curricle.ENDED
    assert max(curricle.UNMAPPED, curricle.ENDED) < 0


def arrays_of(owner):
    """The arrays among an object's fields and (cached) properties, by name."""
    found = {}
    for name in dir(owner):
        if not name.startswith("_") and not callable(getattr(type(owner), name, None)):
            value = getattr(owner, name)
            if isinstance(value, np.ndarray):
                found[name] = value
    return found


MAZE = GridWorld(["S..", ".FT"])
NEAR = MAZE.crop(rows=(0, 2), columns=(1, 3))
RESULT = Curriculum(
    {"near": NEAR, "maze": MAZE}, [Transfer("near", "maze", same_position(MAZE, NEAR))], budget=50
).train()
OWNERS = {
    "FiniteMDP": MAZE.mdp,
    "FiniteMDP.from_dense": FiniteMDP.from_dense(
        [[[0.0, 1.0]], [[0.0, 1.0]]], [1, 0], terminal=[False, True], start=0, discount=0.5
    ),
    "GridWorld": MAZE,
    "Pursuit": Pursuit(size=2),
    "StatePotential": StatePotential(MAZE, np.zeros(6)),
    "StateActionPotential": StateActionPotential(MAZE, np.zeros((6, 4))),
    "to_state": StateActionPotential(MAZE, np.zeros((6, 4))).to_state(),
    "StateActionMapping": same_position(MAZE, NEAR),
    "LearningResult": learn(MAZE, budget=50),
    "potential of a curriculum": RESULT.potentials["maze"][0],
}


@pytest.mark.parametrize(("owner", "name"), [(o, n) for o in OWNERS for n in arrays_of(OWNERS[o])])
def test_arrays_handed_out_are_read_only(owner, name):
    array = getattr(OWNERS[owner], name)
    with pytest.raises(ValueError, match="read-only"):
        array[...] = 0


@pytest.mark.parametrize("name", ["values", "action_values", "optimal"])
def test_a_solution_is_read_only(name):
    with pytest.raises(ValueError, match="read-only"):
        getattr(solve(MAZE), name)[...] = 0


@pytest.mark.parametrize("owner", [MAZE, MAZE.mdp, Pursuit(), same_position(MAZE, NEAR), RESULT])
def test_fields_cannot_be_set(owner):
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(owner, dataclasses.fields(owner)[0].name, None)
