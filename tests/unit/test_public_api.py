"""The public names: they resolve, are documented, load lazily, and hand out frozen things."""

import ast
import dataclasses
import subprocess
import sys
from pathlib import Path

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
    evaluate,
    learn,
    same_position,
    solve,
)

PACKAGE = Path(curricle.__file__).parent
MOST_NAMES = 51
FACES = sorted(stub.parent.name for stub in PACKAGE.glob("*/__init__.pyi"))
DATACLASSES = [
    kind
    for face in FACES
    if face != "deep"  # whose names need an extra
    for name in getattr(curricle, face).__all__
    for kind in [getattr(getattr(curricle, face), name)]
    if isinstance(kind, type) and dataclasses.is_dataclass(kind)
]


def test_the_face_is_small():
    assert len(curricle.__all__) <= MOST_NAMES


@pytest.mark.parametrize("face", FACES)
def test_every_package_offers_what_its_stub_names(face):
    stub = ast.parse((PACKAGE / face / "__init__.pyi").read_text("utf-8"))
    named = [alias.asname for line in stub.body for alias in line.names]
    package = getattr(curricle, face)
    assert sorted(package.__all__) == sorted(named)
    assert set(named) <= set(dir(package))
    if face != "deep":
        for name in named:
            getattr(package, name)


@pytest.mark.parametrize("face", FACES)
def test_no_module_hides_a_public_name(face):
    paths = (PACKAGE / face).iterdir()  # a package inside is offered under its own name
    modules = {path.stem for path in paths if not (path / "__init__.pyi").exists()}
    assert not modules & set(getattr(curricle, face).__all__)


def test_a_name_of_curricle_is_one_of_its_packages():
    places = {name: face for face in FACES for name in getattr(curricle, face).__all__}
    for name in curricle.__all__:
        package = getattr(curricle, places.get(name, "errors"))
        assert getattr(curricle, name) is getattr(package, name)


def test_dir_lists_the_public_names_and_unknown_ones_fail():
    assert set(curricle.__all__) <= set(dir(curricle))
    assert len(set(curricle.__all__)) == len(curricle.__all__)
    with pytest.raises(AttributeError):
        _ = curricle.no_such_name


@pytest.mark.parametrize("heavy", ["numba", "matplotlib", "pyarrow"])
def test_import_alone_loads_nothing_heavy(heavy):
    code = f"import sys, curricle; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_public_dataclasses_are_frozen():
    assert [kind for kind in DATACLASSES if not kind.__dataclass_params__.frozen] == []


def test_the_tree_of_exceptions():
    for name in ("Task", "Setting", "Potential", "Mapping", "Curriculum"):
        error = getattr(curricle.errors, f"{name}Error")
        assert issubclass(error, curricle.CurricleError)
        assert issubclass(error, ValueError)
    assert issubclass(curricle.errors.StoreError, curricle.CurricleError)


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
ONES = np.ones((6, 4))
ONE_WAY = [[[0.0, 1.0]], [[0.0, 1.0]]]


def handed_on():
    edge = Transfer("near", "maze", same_position(MAZE, NEAR))
    return Curriculum({"near": NEAR, "maze": MAZE}, [edge], budget=50).train()


OWNERS = {
    "FiniteMDP": lambda: MAZE.mdp,
    "FiniteMDP.from_dense": lambda: FiniteMDP.from_dense(
        ONE_WAY, [1, 0], terminal=[False, True], start=0, discount=0.5
    ),
    "GridWorld": lambda: MAZE,
    "Pursuit": lambda: Pursuit(size=2),
    "StatePotential": lambda: StatePotential(MAZE, ONES[:, 0]),
    "StateActionPotential": lambda: StateActionPotential(MAZE, ONES),
    "to_state": lambda: StateActionPotential(MAZE, ONES).to_state(),
    "StateActionMapping": lambda: same_position(MAZE, NEAR),
    "Solution": lambda: solve(MAZE),
    "PolicyValues": lambda: evaluate(MAZE, [1, 1, 2, 1, 1, 1]),
    "LearningResult": lambda: learn(MAZE, budget=50),
    "potential of a curriculum": lambda: handed_on().potentials["maze"][0],
    "result of a curriculum": lambda: handed_on()["maze"],
}
FRESH = {"policy"}  # computed anew for each caller, who may write on it


@pytest.mark.parametrize("owner", OWNERS)
def test_arrays_handed_out_are_read_only(owner):
    arrays = arrays_of(OWNERS[owner]())
    assert arrays
    assert [n for n, a in arrays.items() if a.flags.writeable and n not in FRESH] == []


@pytest.mark.parametrize("owner", ["GridWorld", "FiniteMDP", "Pursuit", "StateActionMapping"])
def test_fields_cannot_be_set(owner):
    made = OWNERS[owner]()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(made, dataclasses.fields(made)[0].name, None)
