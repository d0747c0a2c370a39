"""The pages: their links lead somewhere, and what they tell their readers to type is right."""

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

from curricle.cli.app import app
from curricle.comparison.verdicts import NO_MORE, Reason, Verdict, not_known, too_few_seeds
from curricle.statistics import Interval
from curricle.transfer.transfer import FOUND
from tests.support.pages import Command, blocks, commands_of
from tests.support.walk import Ended, faults, walk

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


@pytest.mark.parametrize(
    ("told", "status", "printed", "complained", "wrong"),
    [
        ("12 seeds in 3 s", 0, "12 seeds in 41 s", "", []),
        ("12 seeds", 0, "13 seeds", "", ["printed"]),
        ("12 seeds", 1, "12 seeds", "", ["ended with 1"]),
        ("curricle: no", 1, "", "curricle: no", []),
        ("curricle: no", 0, "", "curricle: no", ["ended with 0"]),
        ("curricle: no", 1, "", "curricle: yes", ["did not say"]),
        ("...\nlast", 0, "last", "", []),
        ("...\nlast", 0, "first\nlast", "", []),
        ("a ━━━ 1/2\nlast", 0, "last", "", []),
        ("", 0, "anything", "", []),
    ],
)
def test_what_is_wrong_with_a_command_is_told(told, status, printed, complained, wrong):
    found = list(faults(Command("curricle", told), Ended(status, printed, complained, 1.0)))
    assert [one.startswith(start) for one, start in zip(found, wrong, strict=True)] == [True] * len(
        wrong
    )


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
    assert not_known([Reason(verdict_of_one(interval), None)]).partition(" without")[0] in page


def verdict_of_one(gain: Interval) -> Verdict:
    return Verdict(gain, "scratch", 1, 0.01, 0.01, 9, 6)
