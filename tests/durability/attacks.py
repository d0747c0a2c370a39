"""Read mutated study files and folders of results, and print what became of them.

Usage: python attacks.py studies|folders NUMBER SEED [previewed]. Each batch has a process of its
own, whose memory is measured. Prints how often each outcome came, the most memory that a batch took
in MB, and all that must not be: other exceptions than ours, messages of several lines or far too
long, hangs.
"""

import contextlib
import io
import json
import os
import random
import resource
import shutil
import sys
import tempfile
import traceback
import zipfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from curricle.cli.tables import decision_lines, print_results  # noqa: E402
from curricle.errors import LONGEST, CurricleError  # noqa: E402
from curricle.files import archive_content, opened_archive, sealed  # noqa: E402
from curricle.report.study_report import write_report  # noqa: E402
from curricle.study import StudyResults, read_study, run_study  # noqa: E402
from curricle.study.store import in_use  # noqa: E402
from tests.durability.fuzzing import Hang, built, limited, outcome, previewed  # noqa: E402
from tests.durability.study_mutations import NUMBERS, STUDIES, WORDS, holders_and_keys, mutated  # noqa: E402

ADDRESSES = 8 << 30
"""Bytes of address space: code beside a study may ask for any amount and gets a MemoryError."""
BATCH = 50
SECONDS = 20
STUDY = """
name = "chain"
budget = 300
seeds = 3
snapshots = 3
tasks.near = { type = "maze", map = "S.T" }
tasks.far = { type = "maze", map = "S...T" }
transfers = [{ source = "near", target = "far", mapping = "same_position" }]
"""


def study(number, seed, folder, what):
    path = STUDIES[number % len(STUDIES)]
    for module in path.parent.glob("*.py"):
        shutil.copy(module, folder)
    return outcome(mutated(path, seed * 10**6 + number), folder, what)


# -- folders ---------------------------------------------------------------------------------------


def mutate_folder(folder, draw):
    """Change one or two files of a folder of results as somebody might who means harm."""
    files = sorted(one for one in folder.rglob("*") if one.is_file())
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
                path.write_bytes(archive(path, draw))
            case _ if path.suffix == ".json":
                path.write_bytes(changed_json(content, draw))
            case _:
                path.unlink()
                os.mkfifo(path)


def archive(path, draw):
    """Return a unit's file with one member changed, sealed again."""
    with opened_archive(path) as there:
        others = {name: there.archive.read(name) for name in there.members}
    name = draw.choice(sorted(others))
    content = others[name]
    if name.endswith(".npy") and draw.random() < 0.7:
        words = ["(-1,)", "(10**9,)", "(True,)", "[1]*9", "'|O'", "'<f8'", "{", "(((", "9" * 5000]
        header = draw.choice(["'shape': ", "'descr': ", ""]).encode()
        at = content.find(header) + len(header)
        new = draw.choice(words).encode()
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
        found = json.loads(content)
    except ValueError:
        return content
    places = list(holders_and_keys(found))
    if places:
        holder, key = draw.choice(places)
        values = [None, True, [], {}, -1, 1e400, *NUMBERS[:-1], *WORDS, [[]] * 9, "x" * 10**6]
        holder[key] = draw.choice(values)
    if isinstance(found, dict) and found.pop("digest", None):
        return sealed(found)
    return json.dumps(found).encode()


def read(folder):
    """Do what `show`, `report` and `watch` do."""
    in_use(folder)
    results = StudyResults(folder)
    print_results(results, None, None)
    list(decision_lines(results, None, None, None))
    write_report(folder, folder.parent / "page.html")


def folder(number, seed, place, whole):
    here = place / "results"
    shutil.rmtree(here, ignore_errors=True)
    shutil.copytree(whole, here)
    mutate_folder(here, random.Random(f"{seed}/{number}"))
    try:
        with contextlib.redirect_stdout(io.StringIO()), limited(SECONDS):
            read(here)
    except CurricleError as error:
        return "refused", str(error)
    except Hang:
        return "hang", traceback.format_exc()
    except Exception:
        return "foreign", traceback.format_exc()
    return "fine", ""


# -- both ------------------------------------------------------------------------------------------


def batch(attack, numbers, seed, what):
    """Print a line of JSON for each attack of a batch, and one with the memory that it took."""
    with tempfile.TemporaryDirectory() as name:
        for number in numbers:
            kind, why = attack(number, seed, Path(name), what)
            lines = why.splitlines()
            long = kind == "refused" and (
                any(len(line) > LONGEST for line in lines) or (attack is folder and len(lines) > 1)
            )
            bad = kind in ("foreign", "hang") or long
            print(json.dumps([number, kind, why[-3000:] if bad else ""]), flush=True)


def main(which, total, seed, *how):
    counts, worst, bad = Counter(), 0, []
    with tempfile.TemporaryDirectory() as name:
        what = previewed if how else built
        attack = study if which == "studies" else folder
        if which == "folders":
            (Path(name) / "study.toml").write_text(STUDY)
            what = Path(name) / "whole"
            run_study(read_study(Path(name) / "study.toml"), what, workers=1, progress=False)
            read(what)  # imports what reading takes
        for first in range(0, total, BATCH):
            reads, writes = os.pipe()
            child = os.fork()
            if child == 0:
                os.dup2(writes, 1)
                resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
                numbers = range(first, min(total, first + BATCH))
                batch(attack, numbers, seed, what)
                os._exit(0)
            os.close(writes)
            with os.fdopen(reads) as lines:
                for line in lines:
                    if line.startswith("["):
                        number, kind, why = json.loads(line)
                        counts[kind] += 1
                        if why:
                            bad.append(f"{which} {number}: {kind}\n{why}")
                            print(bad[-1], file=sys.stderr, flush=True)
            _, status, used = os.wait4(child, 0)
            worst = max(worst, used.ru_maxrss // 1024)
            bad += [f"batch {first} ended by {status}"] if status else []
            print(first, dict(counts), worst, len(bad), file=sys.stderr, flush=True)
    print(dict(counts), f"{worst} MB")
    print("\n".join(bad))


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:4]), *sys.argv[4:])
