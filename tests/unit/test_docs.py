"""The documentation: its reference is whole or its build fails, and its tutorial is right."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from curricle import read_study
from curricle.study.config import json_schema

DOCS = Path(__file__).parents[2] / "docs"
LARGEST_PICTURE = 150_000  # bytes
FILE = re.compile(r"^```\w+\n# (\w+\.\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A block of code that is a file, by the name in its first line."""


def test_the_vault_is_as_its_page_says(tmp_path):
    for name, text in FILE.findall((DOCS / "howto" / "bring_a_task.md").read_text("utf-8")):
        (tmp_path / name).write_text(text, "utf-8")
    study = read_study(tmp_path / "vault.toml")
    coverages = {
        name: study.curriculum(name).transfers[0].mapping.coverage() for name in study.arms
    }
    assert coverages["with-key"].mapped == pytest.approx(28 / 58)
    assert coverages["by-name"].mapped == pytest.approx(56 / 58)


def test_the_page_on_a_class_of_ones_own_shows_the_example():
    shown = dict(FILE.findall((DOCS / "howto" / "bring_a_task.md").read_text("utf-8")))
    for name in ("courier.py", "courier.toml"):
        example = DOCS.parent / "examples" / "own_environment" / name
        assert example.read_text("utf-8").endswith(shown[name])


def test_the_page_on_study_files_has_every_key_of_their_schema():
    text = (DOCS / "study_files.md").read_text("utf-8")
    schema = json_schema()
    tables = [schema, *schema["$defs"].values()]
    keys = {key for table in tables for key in table.get("properties", {})}
    assert len(keys) > 100
    assert [key for key in sorted(keys) if not re.search(rf"\b{key}\b", text)] == []


def test_every_promise_names_tests_that_exist():
    text = (DOCS / "promises.md").read_text("utf-8")
    promises = re.split(r"\n- ", text)[1:]
    assert len(promises) > 20
    for promise in promises:
        named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", promise)
        assert named, f"no test holds: {promise}"
        for path, name in named:
            assert f"def {name}(" in (DOCS.parent / path).read_text("utf-8"), f"{path}::{name}"


@pytest.mark.parametrize("picture", sorted(DOCS.glob("*.png")), ids=lambda path: path.name)
def test_pictures_are_small(picture):
    assert picture.stat().st_size < LARGEST_PICTURE


# -- a small site, built by the extension -------------------------------------------------------

STUB = "from .rules import LIMIT as LIMIT, Told as Told, told as told\n"
FACADE = "from tiny.rules import LIMIT, Told, told\n__all__ = ['LIMIT', 'Told', 'told']\n"
RULES = '''
from dataclasses import dataclass
from typing import Callable

LIMIT = 3
"""Most that :func:`told` takes: three."""


def told():
    """See :class:`Told`, :meth:`Told.half`, :attr:`Told.many`, :data:`LIMIT`."""


@dataclass
class Told:
    """What :func:`tiny.rules.told` made.

    Attributes
    ----------
    many : int
        As its :meth:`half` says.
    """

    many: int
    way: Callable = told

    @property
    def half(self):
        """Less: half as :attr:`many`."""
'''
PAGE = """
Tiny
====
.. currentmodule:: tiny
.. autodata:: LIMIT
.. autoclass:: Told
   :members:
.. autofunction:: told
"""
CONF = """
import sys
sys.path[:0] = [{docs!r}, {here!r}]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "reference"]
napoleon_use_param, napoleon_custom_sections = False, [("Attributes", "params_style")]
autodoc_typehints, reference_packages, nitpicky = "none", ["tiny"], True
"""


@pytest.fixture
def build(tmp_path):
    """Return a function that builds the site of a package, and returns how that ended."""
    pytest.importorskip("sphinx", reason="the extra docs is not installed")

    def run(page=PAGE, rules=RULES):
        files = {
            "conf.py": CONF.format(docs=str(DOCS), here=str(tmp_path)),
            "index.rst": f"{page}\n.. toctree::\n\n   prose\n",
            "prose.md": "# Prose\n\nIt says `tiny.py`, `told(...)`, `Told.half` and `Told.none`.\n",
            "tiny/__init__.py": FACADE,
            "tiny/__init__.pyi": STUB,
            "tiny/rules.py": rules,
        }
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(text, "utf-8")
        return subprocess.run(
            [sys.executable, "-m", "sphinx", "-qWE", tmp_path, tmp_path / "site"],
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_names_lead_to_the_reference(build, tmp_path):
    ended = build()
    assert (ended.returncode, ended.stderr) == (0, "")
    page, prose = ((tmp_path / "site" / f"{name}.html").read_text() for name in ("index", "prose"))
    assert "Less: half as" in page
    assert "takes: three" in page
    assert "integer" not in page  # what int says of itself
    assert "tiny.Told.way" not in page  # a default is no method
    assert page.count('href="#tiny.Told"') >= 3
    assert re.findall(r'href="index.html#([\w.]+)"', prose) == ["tiny.told", "tiny.Told.half"]


@pytest.mark.parametrize(
    ("page", "rules", "said"),
    [
        (PAGE.replace(".. autodata:: LIMIT\n", ""), RULES, "LIMIT is public, and missing from the"),
        (
            PAGE.replace(".. autofunction:: told\n", ""),
            RULES,
            "told is public, and missing from the",
        ),
        (PAGE, re.sub('"""See .*"""', "None", RULES), "told is public, and has no docstring"),
    ],
)
def test_a_build_fails_where_a_public_name_is_missing_or_says_nothing(build, page, rules, said):
    ended = build(page=page, rules=rules)
    assert ended.returncode != 0
    assert f"tiny.{said}" in ended.stderr
