"""What becomes of public environments in the four commands that a newcomer uses.

python -m benchmarks.public_ids --trees TREES --outcomes OUTCOMES > docs/public_environments.md

For each entry of `public_classes.toml` that OUTCOMES lacks, it runs `curricle new`, `check`, `run`
and `show` in a fresh folder. All four have 5 minutes together, and each may hold 4 GB. It appends a
line to OUTCOMES as an entry ends, so that a killed run goes on, and prints the page of all lines.
Repositories are cloned into TREES unless they are there, as OWNER+NAME. Read their code first: it
is run. `--limit N` walks N more entries, 0 only prints the page; names choose entries.
"""

import argparse
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

LIST = Path(__file__).with_name("public_classes.toml")
PROCESSORS, MEMORY = os.cpu_count() or 1, 4 * 2**30  # memory of each process, in bytes
SECONDS = 300  # of the four commands together
QUIET = {"SDL_VIDEODRIVER": "dummy", "SDL_AUDIODRIVER": "dummy", "MPLBACKEND": "Agg"}  # no windows
VERDICTS = "pays", "costs", "no difference"  # the first words of each
MEANING = dict(zip(VERDICTS, ["a verdict on a source"] * 3, strict=True)) | {
    "honest end": "no easier relative was found; the best learner without one, by a verdict",
    "refusal": "refused in a sentence that states a way out",
    "guess": "a verdict on a source whose mapping is not scored",
    "void": "nobody learnt, one learner alone, or a refusal (without a way out, or by `run`)",
    "too slow": f"more than {SECONDS // 60} minutes",
    "crash": "a traceback, or the process died",
}
WAY_OUT = r"\b(let|give|set|use|name|choose|install|return|pass|wrap|write|becomes)\b"
DECISIVE = "best learner without one|^nobody|^instead|: pays|^curricle"
PLAIN = r"no arm has .* without one is |instead of transfer, | \(in a study file: [^)]*\)"
UNTOLD = "^(mean return of other|steps to the threshold saved|# (Where|with|Networks) )"
PAGE = """# Which public environments work?

{count} environments that other people wrote, each walked through `curricle new`, `check`, `run` and
`show` as a newcomer would, with {minutes} minutes and 4 GB: {classes} classes of public
repositories, listed before any was run, and {ids} ids of Gymnasium and MiniGrid. A machine of
{processors} processors ran them, for each of which {load} processes waited, the run's own included.
{left}`python -m benchmarks.public_ids` makes this page of `benchmarks/public_classes.toml`.

| outcome | entries | it means |
|---|---|---|"""


def command(folder: Path, ends: float, *words: str) -> tuple[int | None, str, str, float]:
    """Return exit code, output, errors and minutes of a command; no exit code where it was late."""
    began = time.monotonic()
    limited = partial(resource.setrlimit, resource.RLIMIT_DATA, (MEMORY, MEMORY))
    process = subprocess.Popen(
        [sys.executable, "-m", "curricle", *words], cwd=folder, env=os.environ | QUIET, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, preexec_fn=limited,
    )  # fmt: skip
    try:
        output, errors = process.communicate(timeout=max(0.1, ends - began))
        code: int | None = process.returncode
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, errors = process.communicate()
        code = None
    return code, output, errors, round((time.monotonic() - began) / 60, 2)


def tree_of(entry: dict[str, Any], trees: Path) -> Path:
    """Return the folder of an entry's repository, which is cloned where it is not there."""
    tree = trees / str(entry["repository"]).replace("/", "+")
    if not tree.is_dir():
        url = f"https://github.com/{entry['repository']}"
        subprocess.run(["git", "clone", "-q", url, tree], check=True)
        subprocess.run(["git", "-C", tree, "checkout", "-q", entry["commit"]], check=True)
    return tree


def subject(entry: dict[str, Any], trees: Path, folder: Path) -> str:
    """Return what `curricle new` is called with, after the entry's files were put into a folder."""
    if "id" in entry:
        return str(entry["id"])
    tree, path = tree_of(entry, trees), Path(entry["path"])
    root = tree / entry.get("root", path.parent)
    for item in root.iterdir():
        (folder / item.name).symlink_to(item.resolve())
    module = ".".join((tree / path).relative_to(root).with_suffix("").parts)
    if "arguments" not in entry:
        return f"{module}:{entry['class']}"
    arguments = ", ".join(f"{name}={value!r}" for name, value in entry["arguments"].items())
    passed = ", ".join(f"{name}={name}" for name in entry["arguments"])
    made = f"def made({arguments}):\n    return {entry['class']}({passed})\n"
    (folder / "made.py").write_text(f"from {module} import {entry['class']}\n\n\n{made}")
    return "made:made"


def judged(shown: dict[str, Any], notes: str) -> tuple[str, list[str]]:
    """Return the outcome of a study that ended, and the sentences that say so."""
    comparison = shown["comparison"] or {"arms": [], "sentences": []}
    arms, sentences = comparison["arms"], comparison["sentences"]
    verdicts = [arm["verdict"] for arm in arms if arm["source_steps"]]
    sentences = [f"{arm['arm']}: {arm['verdict']}" for arm in arms if arm["verdict"]] + sentences
    if any("no arm is above random play" in sentence for sentence in sentences) or not arms:
        return "void", sentences
    if not verdicts:
        named = any("better than each other learner" in sentence for sentence in sentences)
        return "honest end" if named and "nothing to learn" not in notes else "void", sentences
    found = [name for name in VERDICTS if any(text.startswith(name) for text in verdicts)]
    return "guess" if "a guess: components" in notes else [*found, "void"][0], sentences


def walked(entry: dict[str, Any], trees: Path) -> dict[str, Any]:
    """Return what becomes of an entry: its outcome, the sentences, and each command's minutes."""
    minutes, said, ends = dict[str, float](), list[str](), time.monotonic() + SECONDS
    with TemporaryDirectory() as name:
        words = {"new": [subject(entry, trees, Path(name))]}
        for step in "new", "check", "run", "show":
            code, output, errors, minutes[step] = command(Path(name), ends, step, *words[step])
            if code != 0:
                reason = errors.strip().rpartition("\n")[2].removeprefix("curricle: ")
                refused = code in (1, 3) and "Traceback" not in errors
                helps = step == "new" and re.search(WAY_OUT, reason)  # else `new` wrote the fault
                outcome = "refusal" if helps else "void"
                outcome = outcome if refused else "too slow" if code is None else "crash"
                said.append(f"curricle {step}: {reason}")
                break
            if step == "new":
                file = re.findall(r"Wrote (\S+\.toml)", output)[-1]
                results = f"{file.removesuffix('.toml')}-results"
                words |= {"check": [file, "--json"], "run": [file], "show": [results, "--json"]}
                notes = (Path(name) / file).read_text()
                said += notes.partition("\n\n")[0].replace("\n#   ", " ").splitlines()[1:]
            output = output[max(0, output.find("{\n")) :]  # what the class itself prints is before
            if step == "show":
                outcome, sentences = judged(json.loads(output), notes)
                said += sentences
    kept = [line.removeprefix("# ") for line in said if not re.search(UNTOLD, line)]
    load = round(os.getloadavg()[1] / PROCESSORS, 1)
    return {"outcome": outcome, "minutes": minutes, "load": load, "sentences": kept}


def key_of(entry: dict[str, Any]) -> str:
    """Return an entry's name."""
    return str(entry.get("id") or f"{entry['repository']}:{entry['class']}")


def page_of(entries: list[dict[str, Any]], results: dict[str, dict[str, Any]]) -> str:
    """Return the page: how often each outcome came out, then each entry by kind."""
    ran = [entry for entry in entries if key_of(entry) in results]
    counts, left = Counter(results[key_of(e)]["outcome"] for e in ran), len(entries) - len(ran)
    loads, ids = [r["load"] for r in results.values() if "load" in r], sum("id" in e for e in ran)
    head = PAGE.format(
        count=len(ran), minutes=SECONDS // 60, classes=len(ran) - ids, ids=ids, load=median(loads),
        processors=PROCESSORS, left=f"{left} others of the list have not been run. " * bool(left),
    )  # fmt: skip
    lines = [head, *(f"| {name} | {counts[name]} | {MEANING[name]} |" for name in MEANING)]
    spent = {key_of(entry): sum(results[key_of(entry)]["minutes"].values()) for entry in ran}
    of_use = sum(counts[name] for name in [*MEANING][:5])
    half = f"Half of all took at most {median(spent.values()):.1f} minutes."
    lines.append(f"\nThe first five, {of_use}, are of use. {half}")
    for kind in dict.fromkeys(entry["kind"] for entry in ran):
        lines.append(f"\n## {kind[0].upper()}{kind[1:]}\n")
        lines.append("|environment|outcome|minutes|what is said|\n|---|---|---|---|")
        for name in (key_of(entry) for entry in ran if entry["kind"] == kind):
            sentences = results[name]["sentences"]
            decisive = [sentence for sentence in sentences if re.search(DECISIVE, sentence)]
            said = re.sub(PLAIN, "", (decisive or sentences)[-1])
            said = said if len(said) <= 100 else f"{said[:45]} … {said[-50:]}"
            said = said.replace("|", "\\|").replace("<", "&lt;")
            lines.append(f"|`{name}`|{results[name]['outcome']}|{spent[name]:.1f}|{said}|")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--trees", type=Path, default=Path("public-trees"))
    parser.add_argument("--outcomes", type=Path, default=Path("public-outcomes.jsonl"))
    parser.add_argument("--limit", type=int, default=sys.maxsize)
    options = parser.parse_args()
    entries = tomllib.loads(LIST.read_text())["entry"]
    options.outcomes.touch()
    stored = map(json.loads, options.outcomes.read_text().splitlines())
    results = {line["entry"]: line for line in stored}
    names = {*(options.names or map(key_of, entries))} - results.keys()
    wanted = [entry for entry in entries if key_of(entry) in names]
    for entry in wanted[: options.limit]:
        result = {"kind": entry["kind"], "entry": key_of(entry), **walked(entry, options.trees)}
        results[key_of(entry)] = result
        with options.outcomes.open("a") as file:
            print(json.dumps(result), file=file)
        print(f"{key_of(entry)}: {result['outcome']}", file=sys.stderr)
    print(page_of(entries, results))
