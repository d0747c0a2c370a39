"""A folder that is run into again: what fits is used, what does not is trained again and told."""

import json
import shutil
from importlib import metadata

import pytest

from curricle.cli.output import print_results, units_left
from curricle.errors import ConfigError, StoreError
from curricle.study import StudyResults, read_study, run_study
from curricle.study.arms import Arms, arms_from_json
from curricle.study.results import DECISIONS, RESULTS

pytestmark = pytest.mark.usefixtures("quick_disk")

# The source has an own task, the target an own mapping and an own aggregate. Scratch has neither.
STUDY = """
name = "own"
opponents = []
seeds = 2
eval_freq = 100
budget = 300
tasks.short = { type = "factory", factory = "tasks:line", arguments = { length = 4 } }
tasks.long = { type = "maze", map = "S......T" }
transfers = [{ source = "short", target = "long", function = "mappings.places:halves" }]
[arms.one]
[arms.own]
aggregate = "aggregates:second"
"""
CODE = {
    "tasks.py": "from .rules import REWARDS\n"
    "import curricle as cr\n"
    "def line(length):\n"
    "    return cr.GridWorld('S' + '.' * (length - 2) + 'T', rewards=REWARDS)\n",
    "rules.py": "import curricle as cr\nREWARDS = cr.Rewards(treasure=20)\n",
    "mappings/__init__.py": "",
    "mappings/places.py": "def halves(state, action):\n"
    "    from ..numbers import half\n"
    "    return {'row': state['row'], 'column': half(state['column'])}, action\n",
    "numbers.py": "def half(n):\n    return n // 2\n",
    "aggregates.py": "def second(potentials):\n    return potentials[-1]\n",
    "unused.py": "",
}
SCRATCH, SHORT, ONE, OWN = "scratch: long", "one: short", "one: long", "own: long"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A study with modules of its own, as a folder."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "own.toml").write_text(STUDY)
    (folder / "mappings").mkdir()
    for name, text in CODE.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture(scope="module")
def trained(written):
    """The folder of its results."""
    run_study(read_study(written / "own.toml"), written / "out", workers=1)
    return written / "out"


@pytest.fixture
def copy(written, trained, tmp_path):
    """A copy of both; results are in out/."""
    return shutil.copytree(written, tmp_path / "own")


def again(folder, *, set=(), out="out", **settings):
    """Resume the study; return what was trained, as "arm: task", and what was told."""
    units, sentences = [], []
    run_study(
        read_study(folder / "own.toml", set=set),
        folder / out,
        resume=True,
        workers=1,
        report=sentences.append,
        progress=lambda now: units.append(now.stored),
        **settings,
    )
    return sorted(f"{unit.arm}: {unit.task}" for unit in units[1:]), sorted(sentences)


def change(file):
    file.write_text(file.read_text() + "\nCHANGED = True\n")


def assert_as_from_scratch(folder, *, set=()):
    """The tables in out/ are those of a run into a new folder."""
    run_study(read_study(folder / "own.toml", set=set), folder / "fresh", workers=1)
    for name in (RESULTS, DECISIONS):
        assert (folder / "out" / name).read_bytes() == (folder / "fresh" / name).read_bytes(), name
    shutil.rmtree(folder / "fresh")


def stale(unit, why, seeds="0-1"):
    return f"{unit}, seeds {seeds}, is stale and trained again: {why}"


@pytest.mark.parametrize(
    ("module", "of_source", "units"),
    [
        ("tasks.py", True, [ONE, SHORT, OWN]),
        ("rules.py", True, [ONE, SHORT, OWN]),
        ("mappings/__init__.py", False, [ONE, OWN]),
        ("numbers.py", False, [ONE, OWN]),
        ("aggregates.py", False, [OWN]),
        ("unused.py", False, []),
    ],
)
def test_what_used_changed_code_is_named_and_trained_again(copy, module, of_source, units):
    change(copy / module)
    trained, sentences = again(copy)
    assert trained == units
    reasons = dict.fromkeys(units, f"{module} changed")
    if of_source:
        reasons |= dict.fromkeys([ONE, OWN], "its source short changed")
    assert sentences == [stale(unit, why) for unit, why in reasons.items()]
    assert_as_from_scratch(copy)
    assert again(copy) == ([], [])


def test_code_that_is_as_it_was_finds_its_units_again(copy):
    text = (copy / "numbers.py").read_text()
    change(copy / "numbers.py")
    again(copy)
    (copy / "numbers.py").write_text(text)
    assert again(copy) == ([], [])
    assert_as_from_scratch(copy)


def test_line_ends_and_places_are_no_change(copy, tmp_path):
    for file in copy.rglob("*.py"):
        file.write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))
    assert again(copy.rename(tmp_path / "elsewhere")) == ([], [])


@pytest.fixture
def upgraded(monkeypatch):
    """A function: library -> its version before; from then on it is 9.0."""
    version = metadata.version

    def upgrade(library):
        known = {library: "9.0"}
        monkeypatch.setattr(metadata, "version", lambda name: known.get(name) or version(name))
        return version(library)

    return upgrade


def test_another_version_of_curricle_makes_units_stale(copy, upgraded):
    why = f"Curricle was {upgraded('curricle')} and is 9.0"
    trained, sentences = again(copy)
    assert trained == [ONE, SHORT, OWN, SCRATCH]
    assert sentences[-1] == stale(SCRATCH, why)
    assert all(why in sentence for sentence in sentences)


def test_another_version_of_a_library_is_told(copy, upgraded):
    before = upgraded("numba")
    trained, (sentences,) = again(copy)
    assert trained == []
    assert sentences.startswith(f"numba was {before} in earlier runs and is 9.0: ")


def test_code_that_changes_during_a_run_is_refused_by_a_worker_that_starts_then(copy):
    study = read_study(copy / "own.toml")
    config, code = json.dumps(study.to_data()), json.dumps(Arms.of(study).code)
    assert arms_from_json(config, str(copy), code).keys == Arms.of(study).keys
    change(copy / "aggregates.py")
    arms_from_json.cache_clear()
    with pytest.raises(ConfigError, match=r"aggregates.py must not change during a run"):
        arms_from_json(config, str(copy), code)


MORE = '\n[arms.state]\nshaping = "StateShaping"\n'
COSTLIER = "\n[arms.long_source]\ntasks.short.budget = 500\n"


def test_an_added_arm_is_all_that_is_trained(copy, contents):
    before = contents(copy / "out" / "units")
    with (copy / "own.toml").open("a") as file:
        file.write(MORE)
    assert again(copy) == (["state: long"], [])
    assert before.items() <= contents(copy / "out" / "units").items()
    assert list(StudyResults(copy / "out").results) == ["scratch", "one", "own", "state"]
    assert_as_from_scratch(copy)


def test_an_added_arm_with_costlier_sources_lengthens_all_targets(copy):
    with (copy / "own.toml").open("a") as file:
        file.write(COSTLIER)
    trained, sentences = again(copy)
    assert trained == ["long_source: long", "long_source: short", ONE, OWN, SCRATCH]
    assert sentences == [stale(unit, "total was 600 and is 800") for unit in (ONE, OWN, SCRATCH)]
    assert_as_from_scratch(copy)


def test_a_removed_arm_is_not_in_the_results_and_comes_back_untrained(copy, contents):
    text, before = (copy / "own.toml").read_text(), contents(copy / "out" / "units")
    (copy / "own.toml").write_text(text.partition("[arms.own]")[0])
    assert again(copy) == ([], [])
    assert list(StudyResults(copy / "out").results) == ["scratch", "one"]
    assert contents(copy / "out" / "units") == before
    assert_as_from_scratch(copy)
    (copy / "own.toml").write_text(text)
    assert again(copy) == ([], [])
    assert list(StudyResults(copy / "out").results) == ["scratch", "one", "own"]
    assert_as_from_scratch(copy)


def test_added_seeds_are_all_that_is_trained(copy):
    assert again(copy, set=["seeds=[0, 1, 5]"]) == ([ONE, SHORT, OWN, SCRATCH], [])
    assert_as_from_scratch(copy, set=["seeds=[0, 1, 5]"])


def test_a_longer_budget_keeps_the_sources(copy):
    longer = ["tasks.long.budget=500"]
    trained, sentences = again(copy, set=longer)
    assert trained == [ONE, OWN, SCRATCH]
    why = "budget was 300 and is 500; total was 600 and is 800"
    assert sentences == [stale(unit, why) for unit in trained]
    assert_as_from_scratch(copy, set=longer)


def test_a_dry_run_tells_the_same_and_changes_nothing(copy, contents):
    change(copy / "aggregates.py")
    damaged = next((copy / "out" / "units").glob("short-*/*.npz"))
    damaged.write_bytes(damaged.read_bytes()[::-1])
    before, study = contents(copy), read_study(copy / "own.toml")
    lines = [*units_left(study, copy / "out", (1, 1))]
    assert lines == [
        f"{damaged} is damaged: its units are trained again",
        stale(OWN, "aggregates.py changed"),
        f"{SHORT}, seeds 0-1: 300 steps at most",
        f"{OWN}, seeds 0-1: 600 steps at most",
        f"2 units to do, 2 done, in {copy / 'out'}",
    ]
    assert contents(copy) == before
    assert again(copy) == ([SHORT, OWN], sorted(lines[:2]))


def test_the_key_of_a_part_changes_with_its_whole(read):
    text = (
        'name = "crop"\nseeds = 1\n[tasks.whole]\ntype = "maze"\nmap = "S.....T"\n'
        '[tasks.part]\ntype = "crop"\nof = "whole"\nrows = [0, 1]\ncolumns = [3, 7]\n'
        '[[transfers]]\nsource = "part"\ntarget = "whole"\nmapping = "same_position"\n'
    )
    changes = ([], ["tasks.whole.map='S..P..T'"])
    keys = [Arms.of(read(text, set=change)).keys for change in changes]
    assert keys[0]["transfer", "part"] != keys[1]["transfer", "part"]


def test_another_study_is_not_resumed_into_a_folder(copy):
    file = copy / "own.toml"
    file.write_text(STUDY.replace('"own"', '"other"', 1))
    run_study(read_study(file), copy / "out", resume=True, workers=1)  # the same, renamed
    held = {path: path.read_bytes() for path in (copy / "out").rglob("*") if path.is_file()}
    file.write_text(STUDY.replace("S......T", "S.....T").replace("long", "field"))
    why = "holds units of 'other', none of which 'own' can use; choose another folder"
    with pytest.raises(StoreError, match=why):
        run_study(read_study(file, set=["learner.learning_rate=0.3"]), copy / "out", resume=True)
    assert all(path.read_bytes() == content for path, content in held.items())


def test_a_folder_counts_the_looks_at_what_it_judges(copy):
    file = copy / "own.toml"

    def looks(*changes):
        return run_study(
            read_study(file, set=changes), copy / "out", resume=True, workers=1, report=print
        ).looks

    assert looks() == (2,)
    assert looks("seeds=3") == (2,)
    assert looks("seeds=3") == (2, 3)
    assert StudyResults(copy / "out").comparison.earlier == []  # with two seeds nothing was judged
    assert looks("seeds=4", "learner.learning_rate=0.3") == (2, 3)  # of other data


def test_fewer_seeds_with_other_settings_are_told_how_to_finish(copy, capsys):
    changed = read_study(copy / "own.toml", set=["seeds=1", "learner.learning_rate=0.3"])
    told = []
    results = run_study(changed, copy / "out", resume=True, workers=1, report=told.append)
    stale = [line for line in told if "is stale" in line]
    assert stale
    assert all("seed 0, is stale and trained again" in line for line in stale)
    assert (results.seeds, results.record.seeds) == ((0,), (0, 1))
    print_results(results, None, None)
    assert "--resume --seeds 0-1" in " ".join(capsys.readouterr().out.split())
