"""An arm that fails is reported as failed; the other arms are trained, stored and compared."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from curricle import errors
from curricle.errors import ConfigError, StoreError, StudyError
from curricle.show.report import write_report
from curricle.study import StudyResults, merge, read_study, run_study
from curricle.study.results import FAILURES, without_folders
from tests.support.executors import Elsewhere, Inline

pytestmark = pytest.mark.usefixtures("quick_disk")
FAILING = """
from pathlib import Path

import numpy as np


def mean(values):
    if Path(__file__).with_name("broken").exists():
        raise LookupError("a rule of the thesis is not met")
    return np.mean(values, axis=0)
"""
WORDS = (
    "state: easy, seeds 0-1: LookupError: a rule of the thesis is not met (raised in mean of "
    "rules.py, line 9)"
)


@pytest.fixture
def study(study_file, tmp_path):
    """The study of three arms, one of which fails while the file "broken" is there."""
    (tmp_path / "rules.py").write_text(FAILING)
    (tmp_path / "broken").touch()
    text = study_file.read_text().replace(
        'shaping = "StateShaping"', 'shaping = "StateShaping"\naggregate="rules:mean"'
    )
    (tmp_path / "chain.toml").write_text(text)
    yield read_study(tmp_path / "chain.toml")
    sys.modules.pop("rules", None)


def test_the_other_arms_stand(study, finished, tmp_path):
    trained = []
    with pytest.raises(StudyError, match="state: easy, seeds 0-1 failed, and all that is stored"):
        run_study(study, tmp_path / "out", workers=1, progress=trained.append)
    results, wanted = StudyResults(tmp_path / "out"), StudyResults(finished)
    assert (results.failed, results.seeds) == ({"state": WORDS}, (0, 1, 2, 3))
    labels = [now.stored.label for now in trained[1:]]
    assert not any(label.startswith("state: ") for label in labels)
    assert sum(label.startswith("scaled: ") for label in labels) == 4  # and was after it
    lines = str(results.comparison).split("\n")
    assert lines[-1] == f"state failed: {WORDS}"
    for name in ("scratch", "chain", "scaled"):
        np.testing.assert_array_equal(
            results.comparison[name].curve.values, wanted.comparison[name].curve.values
        )
    assert set(results.comparison.arms) == {"scratch", "chain", "scaled"}
    page = write_report(tmp_path / "out").read_text()
    assert f"The arm state failed and is left out: {WORDS}" in page
    (tmp_path / "broken").unlink()  # and what failed is trained again
    again = run_study(study, tmp_path / "out", resume=True, workers=2)
    assert again.failed == {}
    assert str(again.comparison) == str(wanted.comparison)
    assert not (tmp_path / "out" / FAILURES).exists()


def test_own_code_that_leaves_fails_its_arm_alone(study, finished, tmp_path):
    (tmp_path / "rules.py").write_text("def mean(values):\n    raise SystemExit(0)\n")
    with pytest.raises(StudyError, match=r"state: easy, .*the study's own code called sys.exit"):
        run_study(study, tmp_path / "out", workers=1)
    results, wanted = StudyResults(tmp_path / "out"), StudyResults(finished)
    assert [*results.failed] == ["state"]
    scaled = (of.comparison["scaled"].curve.values for of in (results, wanted))
    np.testing.assert_array_equal(*scaled)
    (tmp_path / "rules.py").write_text("raise SystemExit(0)\n")
    with pytest.raises(ConfigError, match="SystemExit"):
        read_study(tmp_path / "chain.toml").curricula  # noqa: B018


OWN_ERRORS = """
from curricle.errors import TaskError


class Unmet(LookupError):
    def __init__(self, rule, value):
        super().__init__(f"{rule}: got {value}")


class Ours(TaskError):
    def __init__(self, rule, value):
        super().__init__(f"{rule}: got {value}")


def mean(values):
    raise ERROR("a rule of the thesis is not met", 3)
"""


@pytest.fixture
def own_errors(study, tmp_path):
    """Return a function: name of an error -> a study of one unit a task, which raises it."""

    def write(error):
        (tmp_path / "rules.py").write_text(OWN_ERRORS.replace("ERROR", error))
        return read_study(tmp_path / "chain.toml", set=["seeds=2"])

    return write


def told_of(study, out, pool):
    """The sentence of a run that fails, whether its own code is to blame, and what is stored."""
    with pytest.raises(StudyError) as caught:
        run_study(study, out, workers=1, executor=pool)
    return str(caught.value), caught.value.__cause__ is None, (out / FAILURES).read_bytes()


@pytest.mark.parametrize(("error", "kind"), [("Unmet", "Unmet: "), ("Ours", "")])
def test_errors_of_ones_own_read_the_same_wherever_units_are_trained(
    own_errors, tmp_path, error, kind
):
    wanted = told_of(own_errors(error), tmp_path / "threads", None)
    assert f"whole: {kind}a rule of the thesis is not met: got 3" in wanted[0]
    assert told_of(own_errors(error), tmp_path / "copies", Elsewhere()) == wanted


class FailsScratch(Inline):
    """Trains a unit when it is submitted, unless it is of the arm from scratch."""

    def result(self, function, work):
        if work.unit.arm == "scratch":
            raise MemoryError("64 TB")
        return function(work)


def test_without_scratch_nothing_more_is_trained(study_file, tmp_path):
    out, begun = tmp_path / "out", []
    how = {"workers": 1, "executor": FailsScratch(), "progress": begun.append}
    with pytest.raises(StudyError, match=r"scratch: maze, seeds 0-1 failed, .* MemoryError: 64 TB"):
        run_study(read_study(study_file), out, **how)
    results = StudyResults(out)
    assert set(results.failed) == {"scratch"}
    assert len(begun) <= 3  # what had been submitted ahead
    with pytest.raises(StoreError, match="learnt from scratch, which failed in "):
        _ = results.comparison


def test_merged_parts_keep_their_failures(study, tmp_path):
    parts = [tmp_path / f"part-{i}" for i in (1, 2)]
    for i, part in enumerate(parts):
        with pytest.raises(StudyError):
            run_study(study, part, workers=1, shard=(i + 1, 2))
    whole = merge(tmp_path / "whole", parts)
    assert (whole.failed, whole.seeds) == ({"state": WORDS}, (0, 1, 2, 3))
    (tmp_path / "broken").unlink()
    run_study(study, parts[1], workers=1, shard=(2, 2), resume=True)
    for part in (*parts, parts[0]):  # a part that is merged later forgets no failure
        assert merge(tmp_path / "later", [part]).failed == {"state": WORDS}


def test_a_folder_beside_the_librarys_is_the_users():
    code = compile("1 / 0", f"{Path(errors.__file__).parent}-study/own.py", "exec")
    with pytest.raises(ZeroDivisionError, match="division") as caught:
        exec(code)
    assert "<module> of own.py, line 1" in errors.in_words(caught.value)


def test_stored_errors_name_files_without_their_folders():
    for text, kept in (
        ("[Errno 2] No such file: '/home/a b/maze.txt'", "[Errno 2] No such file: 'maze.txt'"),
        ("cannot read /srv/lab/maze.txt: 1/2 of it", "cannot read maze.txt: 1/2 of it"),
        (r"no C:\\Users\\me\\maze.txt here", "no maze.txt here"),
    ):
        assert without_folders(text) == kept


@pytest.mark.parametrize(
    "content",
    ["[3]", "{}{", '[{"key": 1}]', "7"]
    + [f'[{{"key": "1", "error": "", "seeds": {seeds}}}]' for seeds in ("3", "[[1]]", '["a"]')],
)
def test_a_damaged_list_of_failures_is_a_sentence(copied, content):
    (copied / FAILURES).write_text(content)
    with pytest.raises(StoreError, match=FAILURES):
        _ = StudyResults(copied).failed


def test_the_exit_code_and_show_tell_of_it(study, tmp_path, curricle):
    out, file = tmp_path / "out", tmp_path / "chain.toml"
    code, printed, complaint = curricle("run", file, "--out", out, "--workers", "1")
    assert (code, printed) == (3, "")
    assert re.search(r'rules\.py", line \d+, in mean', complaint)
    # The arm's other seeds may have begun before these failed; then they are named as well.
    assert complaint.splitlines()[-1].startswith(
        "curricle: state: easy, seeds 0-1 failed, and all that is stored is whole: "
        "LookupError: a rule of the thesis is not met"
    )
    code, shown, _ = curricle("show", out)
    assert code == 0
    assert shown.startswith("chain: 4 of 4 seeds finished in every arm that has not failed\n")
    assert shown.endswith(f"state failed: {WORDS}\n")


ENVIRONMENT = """
import gymnasium as gym
from gymnasium.spaces import Discrete


class Fails(gym.Env):
    observation_space, action_space = Discrete(2), Discrete(2)

    def reset(self, *, seed=None, options=None):
        return 0, {}

    def step(self, action):
        return {}["pos"]
"""


OF_IT = (
    "name = 'own'\nseeds = 2\ncompared = false\n[tasks.own]\ntype = 'gymnasium'\n"
    "factory = 'own:Fails'\ndiscount = 0.9\nbudget = 100\neval_freq = 50\ntime_limit = 9\n"
)


def of_environment(folder, text):
    """Return the file of a study of an environment, which is written beside it."""
    (folder / "own.py").write_text(text)
    (folder / "own.toml").write_text(OF_IT)
    return folder / "own.toml"


def test_an_environment_that_fails_is_told_with_its_place(tmp_path, curricle):
    place = r"KeyError: 'pos' \(raised in step of own.py, line 13, for action [01] in state 0\)"
    code, _, complaint = curricle("check", of_environment(tmp_path, ENVIRONMENT))
    assert code == 1
    assert re.fullmatch(f"curricle: {place}", complaint.splitlines()[-1])
    assert "Traceback" not in complaint


LINE = ENVIRONMENT.replace('return {}["pos"]', "return action, 1.0, bool(action), False, {}")


def test_the_place_of_an_error_is_the_users_line_and_not_a_compiled_librarys(tmp_path, curricle):
    wrong = ENVIRONMENT.replace("return 0, {}", "return int(self.np_random.integers(0)), {}")
    _, _, complaint = curricle("check", of_environment(tmp_path, wrong))
    assert "ValueError: high <= 0 (raised in reset of own.py, line 10" in complaint


def test_what_fails_after_a_change_is_told_though_no_unit_fits_any_more(tmp_path, curricle):
    run = "run", of_environment(tmp_path, LINE), "--out", tmp_path / "out"
    code, _, complaint = curricle(*run)
    assert code == 0, complaint
    of_environment(tmp_path, ENVIRONMENT)
    sys.modules.pop("own", None)
    code, _, complaint = curricle(*run, "--resume")
    assert code == 3
    assert "KeyError: 'pos' (raised in step of own.py, line 13" in complaint


def test_before_any_unit_is_stored_no_steps_are_known(study, tmp_path):
    (tmp_path / "rules.py").write_text("def mean(values):\n    raise SystemExit(0)\n")
    with pytest.raises(StudyError):
        run_study(study, tmp_path / "out", workers=1)
    with pytest.raises(StoreError, match="holds no result of 'maze' in arm 'state' yet"):
        StudyResults(tmp_path / "out").source_steps("state")
