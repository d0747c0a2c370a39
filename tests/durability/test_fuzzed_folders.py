"""Folders of results that somebody changed are read, or refused in a sentence, at once."""

import io
import json
import os
import random
import shutil
import traceback
import zipfile

import pytest

from curricle.cli.output import decision_lines, print_results
from curricle.errors import LONGEST, CurricleError
from curricle.files import archive_content, opened_archive, sealed
from curricle.show.report import write_report
from curricle.study import StudyResults, read_study, run_study
from tests.durability.fuzzing import Hang, limited
from tests.durability.study_mutations import NUMBERS, WORDS, holders_and_keys
from tests.support.studies import LINES

FEW, MANY = 10, 300
SECONDS = 20


def mutate(folder, draw):
    """Change one or two files of a folder of results as somebody might who means harm."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    for path in draw.sample(files, draw.choice([1, 1, 2])):
        content = path.read_bytes()
        match draw.randrange(8):
            case 0:
                path.write_bytes(content[: draw.randrange(len(content) + 1)])
            case 1:
                changed = bytearray(content)
                for _ in range(draw.choice([1, 3, 50])):
                    if changed:
                        changed[draw.randrange(len(changed))] = draw.randrange(256)
                path.write_bytes(changed)
            case 2:
                path.unlink()
                path.symlink_to(draw.choice(["/etc/passwd", "/dev/zero", "nowhere", ".", "/"]))
            case 3:
                path.write_bytes(b"")
                os.truncate(path, draw.choice([10**6, 10**9, 4 * 10**9]))
            case 4:
                path.write_bytes(draw.choice(files).read_bytes())
            case _ if path.suffix == ".npz":
                path.write_bytes(changed_archive(path, draw))
            case _ if path.suffix == ".json":
                path.write_bytes(changed_json(content, draw))
            case _:
                path.unlink()
                os.mkfifo(path)


def changed_archive(path, draw):
    """Return a unit's file with one member changed, sealed again."""
    with opened_archive(path) as there:
        others = {name: there.archive.read(name) for name in there.members}
    name = draw.choice(sorted(others))
    content = others[name]
    if name.endswith(".npy") and draw.random() < 0.7:
        values = ["(-1,)", "(10**9,)", "(True,)", "[1]*9", "'|O'", "'<f8'", "{", "(((", "9" * 5000]
        header = draw.choice(["'shape': ", "'descr': ", ""]).encode()
        at = content.find(header) + len(header)
        new = draw.choice(values).encode()
        others[name] = content[:at] + new + content[at + len(new) :]
    elif name.endswith(".json") and draw.random() < 0.9:
        others[name] = changed_json(content, draw)
    else:
        at = draw.randrange(len(content))
        others[name] = content[:at] + bytes([draw.randrange(256)]) + content[at + 1 :]
    if draw.random() < 0.1:
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as bomb:
            bomb.writestr(name, bytes(10**8))
        return packed.getvalue()
    return archive_content({}, others)


def changed_json(content, draw):
    """Return JSON with a value changed, sealed again where it was."""
    try:
        value = json.loads(content)
    except ValueError:
        return content
    if places := list(holders_and_keys(value)):
        holder, key = draw.choice(places)
        values = [None, True, [], {}, -1, 1e400, *NUMBERS[:-1], *WORDS, [[]] * 9, "x" * 10**6]
        holder[key] = draw.choice(values)
    if isinstance(value, dict) and value.pop("digest", None):
        return sealed(value)
    return json.dumps(value).encode()


def read(folder):
    """Do what `show` and `report` do."""
    results = StudyResults(folder)
    print_results(results, None, None)
    list(decision_lines(results, None, None, None))
    write_report(folder, folder.parent / "page.html")


def fault(folder):
    """Return what is wrong with how a folder is read or refused; empty if nothing is."""
    try:
        with limited(SECONDS):
            read(folder)
    except CurricleError as error:
        text = str(error)
        return text if "\n" in text or len(text) > LONGEST else ""
    except (Hang, Exception):
        return traceback.format_exc()
    return ""


SEEDS = [range(FEW), pytest.param(range(FEW, MANY), marks=pytest.mark.slow)]


@pytest.mark.parametrize("seeds", SEEDS, ids=["few", "many"])
def test_a_folder_that_was_changed_is_read_or_refused_in_a_sentence(tmp_path, seeds):
    (tmp_path / "study.toml").write_text(LINES)
    whole, changed, faults = tmp_path / "whole", tmp_path / "results", []
    study = read_study(tmp_path / "study.toml", set=["snapshots=3"])
    run_study(study, whole, workers=1, progress=False)
    read(whole)  # imports what reading takes
    for seed in seeds:
        shutil.rmtree(changed, ignore_errors=True)
        shutil.copytree(whole, changed)
        mutate(changed, random.Random(seed))
        if text := fault(changed):
            faults.append(f"seed {seed}: {text[-3000:]}")
    assert not faults, "\n".join(faults)
