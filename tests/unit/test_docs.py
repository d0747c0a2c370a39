"""The documentation: its links, commands, words and keys are right, or its build fails."""

import ast
import itertools
import os
import re
import shlex
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
import typer

from curricle import read_study
from curricle.cli.app import app
from curricle.comparison.verdicts import NO_MORE, NOT_KNOWN, Reason, Verdict, too_few_seeds
from curricle.statistics import Interval
from curricle.study.config import json_schema
from curricle.transfer.transfer import FOUND
from tests.support.pages import blocks, commands_of
from tests.support.walk import walk

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

ROOT = Path(__file__).parents[2]
USAGE_ERROR = typer.BadParameter.__base__  # Click's, which Typer may bring along as its own
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(path for path in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in path.parts),
]
LINK = re.compile(r"(?<!\\)!?\[(?:[^\]\[]|\[[^\]]*\])*\]\(([^)\s]+)\)")
ELSEWHERE = ("http://", "https://", "mailto:")
ENDS = re.compile(r"\s(?:#|\||&|>|;).*|&$")
"""Where a command ends on its line: at a comment, or where the shell goes on."""


def of_pages(find):
    """Yield a page and one thing that `find` finds on it, for each of them."""
    for page in PAGES:
        for found in find(page.read_text("utf-8")):
            yield page, found


def prose(text: str) -> str:
    """Return a page without its code."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Return the places on a page that a link can lead to, as GitHub and MyST name them."""
    titles = re.findall(r"^#+ (.+)$", prose(page.read_text("utf-8")), re.MULTILINE)
    plain = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower() for title in titles)
    return {re.sub(r"[^\w\- ]", "", title).replace(" ", "-") for title in plain}


def links(text: str) -> list[str]:
    """Return where the links of a page lead, but for the web."""
    without_code = re.sub(r"`[^`]*`", "", prose(text))
    return [one for one in LINK.findall(without_code) if not one.startswith(ELSEWHERE)]


def typed(text: str, program: str) -> list[str]:
    """Return the commands of a page that call a program."""
    lines = [
        line.removeprefix("    ")
        for line in re.sub(r"\\\n\s*", " ", prose(text)).splitlines()
        if line.startswith("    ")
    ]
    for language, block in blocks(re.sub(r"\\\n\s*", " ", text)):
        if language == "console":
            lines += [one.line for one in commands_of(block)]
        elif language in ("sh", "bash"):
            lines += block.splitlines()
    return [ENDS.sub("", line) for line in lines if line.startswith(f"{program} ")]


def test_links_lead_somewhere():
    for page, link in of_pages(links):
        path, _, anchor = link.partition("#")
        place = (page.parent / path).resolve() if path else page
        assert place.exists(), f"{link} of {page.name} leads to no file"
        assert not anchor or anchor in anchors(place), f"{link} of {page.name}: no such heading"


def test_commands_are_as_the_command_line_has_them():
    commands = typer.main.get_command(app).commands
    for page, line in of_pages(lambda text: typed(text, "curricle")):
        name, *words = shlex.split(line)[1:]
        if name.startswith("--"):  # not a command but an option of all
            continue
        try:
            commands[name].make_context(name, words)
        except USAGE_ERROR as wrong:
            pytest.fail(f"{page.name}: {line}: {wrong.format_message()}")


def test_scripts_exist_with_their_flags():
    for page, line in of_pages(lambda text: typed(text, "python")):
        words = shlex.split(line)[1:]
        module = words[1].replace(".", "/") if words[0] == "-m" else words[0].removesuffix(".py")
        if words[0] == "-c" or module == "pip":
            continue
        found = [ROOT / f"{module}{ending}" for ending in (".py", "/__main__.py")]
        code = "".join(path.read_text("utf-8") for path in found if path.exists())
        assert code, f"{page.name}: {line}: there is no {module}"
        for flag in (word.partition("=")[0] for word in words if word.startswith("--")):
            assert f'"{flag}"' in code, f"{page.name}: {line}: {module} has no {flag}"


def test_targets_are_in_the_makefile():
    targets = re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    for page, line in of_pages(lambda text: typed(text, "make")):
        assert shlex.split(line)[1] in targets, f"{page.name}: {line}"


def test_a_page_has_one_title():
    for page in PAGES:
        titles = re.findall(r"^# .*", prose(page.read_text("utf-8")), re.MULTILINE)
        assert len(titles) == 1, (page, titles)


def test_toml_and_python_parse():
    for _, (language, block) in of_pages(blocks):
        if language == "toml":
            tomllib.loads(block)
        elif language == "python" and ">>> " not in block:
            ast.parse(block)


# -- reading a page, and walking along it ------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("page", ["tutorial", "howto/bring_a_task"])
def test_a_page_prints_what_it_says(page, tmp_path):
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    variables = {**os.environ, "PATH": programs, "COLUMNS": "80"}
    mine = ("curricle ", "python ")  # neither the environment that it makes nor pip
    page = ROOT / "docs" / f"{page}.md"
    wrong = walk(page, tmp_path, variables, timed=False, taken=lambda one: one.startswith(mine))
    assert wrong == []


# -- every word of a verdict is explained -------------------------------------------------------


def test_every_word_of_a_verdict_is_explained():
    page = re.sub(r"\s+", " ", (ROOT / "docs/howto/did_it_pay.md").read_text("utf-8"))
    interval = Interval(1.0, 0.5, 1.5, 0.95, 9)
    words = {too_few_seeds(5, 6)}
    for p, gain in itertools.product((0.01, 0.5), (interval, replace(interval, estimate=-1.0))):
        verdict = Verdict(gain, "scratch", 1, p, p, 9, 6)
        words |= {verdict.against_scratch, verdict.answer}
        pays = replace(verdict, gain=interval, p=0.01, adjusted_p=0.01)
        words.add(Reason(pays, verdict).words)
        words.add(Reason(pays, verdict, True).words.removesuffix(f", {FOUND}"))
    assert len(words) == 11
    assert [word for word in sorted(words) if f"| {word} |" not in page] == []
    assert all(f"**{words}**" in page for words in (FOUND, NO_MORE))
    assert NOT_KNOWN.removesuffix(" without") in page
