"""What pyproject.toml and the package say once holds everywhere."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import curricle

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
CITATION = (ROOT / "CITATION.cff").read_text("utf-8")


def test_dependency_groups_mirror_the_extras():
    extras, groups = PYPROJECT["project"]["optional-dependencies"], PYPROJECT["dependency-groups"]
    assert groups["test"] == extras["test"]
    assert groups["docs"] == extras["docs"]
    assert groups["dev"][:2] == [{"include-group": "test"}, {"include-group": "docs"}]
    assert extras["dev"][0] == "curricle[test,docs]"
    assert groups["dev"][2:] == extras["dev"][1:]


def test_the_installed_version_is_the_packages():
    assert version("curricle") == curricle.__version__


def test_the_citation_is_of_this_version():
    said = dict(re.findall(r"^([\w-]+): (.+)$", CITATION, re.MULTILINE))
    assert said["version"] == curricle.__version__
    assert said["title"] == "Curricle"
    assert said["license"] == PYPROJECT["project"]["license"]
    assert said["cff-version"] == "1.2.0"
    assert {"message", "type"} <= set(said)
    assert re.search(r"^authors:\n  - name: \w", CITATION, re.MULTILINE)


def test_the_changelog_has_the_version():
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    heading = "Unreleased" if ".dev" in curricle.__version__ else curricle.__version__
    assert f"## [{heading}]" in changes
