"""The public names: they resolve, are documented, load lazily, and hand out frozen things."""

import ast
import dataclasses
import subprocess
import sys
from pathlib import Path

import pytest

import curricle

PACKAGE = Path(curricle.__file__).parent
MOST_NAMES = 50
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


def test_dir_lists_the_public_names():
    assert set(curricle.__all__) <= set(dir(curricle))
    assert len(set(curricle.__all__)) == len(curricle.__all__)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("Qlearning", "QLearning"),
        ("UCBQLearning", "learning.OptimisticQLearning"),
        ("Bins", "interop.Bins"),
        ("nothing_like_it", ""),
        ("", ""),
    ],
)
def test_an_unknown_name_suggests_what_was_meant(name, meant):
    with pytest.raises(AttributeError) as caught:
        getattr(curricle, name)
    assert str(caught.value) == f"curricle has no {name}" + f": did you mean {meant}?" * bool(meant)


@pytest.mark.parametrize("heavy", ["numba", "matplotlib", "pyarrow"])
def test_import_alone_loads_nothing_heavy(heavy):
    code = f"import sys, curricle; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_module_that_a_users_file_hides_is_told(tmp_path):
    (tmp_path / "coverage.py").write_text("")
    (tmp_path / "script.py").write_text("from curricle import learn")
    told = subprocess.run(
        [sys.executable, tmp_path / "script.py"], check=False, capture_output=True, text=True
    ).stderr.splitlines()[-1]
    assert told.startswith("ImportError: curricle.learn cannot be imported: module 'coverage' has")


def test_public_dataclasses_are_frozen():
    assert [kind for kind in DATACLASSES if not kind.__dataclass_params__.frozen] == []


def test_the_tree_of_exceptions():
    for name in ("Task", "Setting", "Potential", "Mapping", "Curriculum"):
        error = getattr(curricle.errors, f"{name}Error")
        assert issubclass(error, curricle.CurricleError)
        assert issubclass(error, ValueError)
    assert issubclass(curricle.errors.StoreError, curricle.CurricleError)
