"""What pyproject.toml says once holds everywhere."""

import tomllib
from importlib.metadata import version
from pathlib import Path

PYPROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))


def test_dependency_groups_mirror_the_extras():
    extras, groups = PYPROJECT["project"]["optional-dependencies"], PYPROJECT["dependency-groups"]
    assert groups["test"] == extras["test"]
    assert groups["docs"] == extras["docs"]
    assert groups["dev"][:2] == [{"include-group": "test"}, {"include-group": "docs"}]
    assert extras["dev"][0] == "curricle[test,docs]"
    assert groups["dev"][2:] == extras["dev"][1:]


def test_installed_version_is_the_one_in_pyproject():
    assert version("curricle") == PYPROJECT["project"]["version"]
