"""Records and files of a results folder that are not as Curricle writes them are refused."""

import os

import pytest

from curricle.show.report import write_report
from curricle.study.record import OF_CONFIGURATION
from tests.support.sent_folders import a_unit, change, refuses

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture
def folder(sent_folder):
    return sent_folder


FILES = ["study.json", "analysis.json", "runs.json", "seeds-0-1.npz"]


def place_of(folder, name):
    return folder / name if (folder / name).exists() else a_unit(folder)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("kind", ["pipe", "folder", "device"])
def test_what_is_no_file_is_not_waited_for(folder, name, kind):
    path = place_of(folder, name)
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    refuses(folder, name.replace(".", r"\."))


@pytest.mark.parametrize("name", ["study.json", "analysis.json", "runs.json"])
@pytest.mark.parametrize("text", ["[" * 10**5, '{"a":' * 10**5, "[]", "{}", "null", "[1]", "\xff"])
def test_other_json_is_refused(folder, name, text):
    path = place_of(folder, name)
    path.write_text(text, encoding="latin-1")
    refuses(folder, name.replace(".", r"\."))


def nested(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


CHANGES = {
    "a name that is a number": ("name", 3),
    "seeds that are words": ("seeds", ["a"]),
    "an unknown key": ("more", 1),
    "a target that is not there": ("target", "mace"),
    "no arms": ("arms", None),
    "a deep value": ("tasks", nested(400)),
    "a task that is not there": ("tasks", []),
    "a checkpoint every 0 steps": ("eval_freq", 0),
}


@pytest.mark.parametrize("label", CHANGES)
def test_a_record_of_another_form_is_refused(folder, label):
    key, value = CHANGES[label]
    part = "configuration" if key in OF_CONFIGURATION else "plan"
    change(folder / "study.json", lambda study: study[part].update({key: value}))
    refuses(folder, r"study\.json is not as Curricle writes it: ")


def test_an_arm_that_does_not_say_whether_it_knows_the_target_is_refused(folder):
    """Records that are older than this field would be read as if nothing had been found."""

    def older(study):
        for arm in study["plan"]["arms"].values():
            del arm["knows_target"]

    change(folder / "study.json", older)
    refuses(folder, r"study\.json is not as Curricle writes it: .*knows_target")


@pytest.mark.parametrize("what", ["study", "arm", "task"])
def test_names_that_a_study_file_cannot_have_are_refused(folder, what):
    bad = "clear\x1b[2J"

    def renamed(names):
        return {bad if name in ("transfer", "maze") else name: x for name, x in names.items()}

    def edit(study):
        if what == "study":
            study["configuration"]["name"] = bad
        elif what == "arm":
            study["plan"]["arms"] = renamed(study["plan"]["arms"])
        else:
            study["plan"]["target"] = bad
            for arm in study["plan"]["arms"].values():
                arm["nodes"] = renamed(arm["nodes"])
                for edge in arm["transfers"]:
                    edge["target"] = bad

    change(folder / "study.json", edit)
    refuses(folder, r"study\.json is not as Curricle writes it: .*must be printable")


VIEWS = {
    "shape": [10**9, 10**9],
    "cells": [10**6],
    "states": [-1],
    "ended": [99],
    "directions": [7, 7, 7, 7],
    "actions": ["only"],
    "markers": [["A", "red;}</style>"]],
    "objects": [["treasure chest", 0, 0, True]],
}


@pytest.mark.parametrize("key", VIEWS)
def test_a_view_that_does_not_fit_is_refused(folder, key):
    def edit(study):
        for task in study["plan"]["tasks"]:
            task["view"][key] = VIEWS[key]

    change(folder / "study.json", edit)
    refuses(folder, r"study\.json is not as Curricle writes it: tasks\.0")


def test_an_analysis_that_does_not_fit_is_refused_or_left_out(folder):
    def other_arms(analysis):
        section = analysis["sections"][0]
        section["arms"] = section["certificates"][0]["arms"] = ["nobody"]
        analysis["episodes"]["transfer"]["maze"]["after"]["cells"][0] = [2000]

    change(folder / "analysis.json", other_arms)
    assert "predicted start" not in write_report(folder).read_text()
    change(folder / "analysis.json", lambda found: found["sections"][0].update(arms=[]))
    refuses(folder, r"analysis\.json is not as .*certificates must be of the section's arms")
    change(folder / "analysis.json", lambda found: found["sections"][0].update(certificates=3))
    refuses(folder, r"analysis\.json is not as Curricle writes it: sections\.0\.certificates")


def test_names_are_text_in_a_page(folder):
    bad = "</script><script>alert(1)</script>"

    def edit(study):
        study["configuration"]["name"] = bad
        study["plan"]["tasks"][0]["text"] = bad
        study["plan"]["arms"]["transfer"]["transfers"][0]["words"] = bad

    change(folder / "study.json", edit)
    assert bad not in write_report(folder).read_text()
