"""Runs of other programs: numbers are SciPy's and our own, and malformed files are refused."""

import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

import curricle as cr
from curricle.comparison.measures import MEASURES
from curricle.comparison.other_runs import compare_files
from curricle.errors import CurricleError, SettingError, StoreError
from curricle.show.report import page_of_runs
from tests.support.comparisons import corner
from tests.support.pages import blocks, commands_of
from tests.support.refusals import KINDS_OF_NO_FILE, no_file

EXAMPLE = Path(__file__).parents[2] / "examples" / "other_runs" / "runs.csv"
CHARGE = {"pretrained": "4096"}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def long_table(seeds=7, last=1000, every=100, seed=0):
    """A table of two arms, the second better and charged."""
    rng = np.random.default_rng(seed)
    rows = [
        (arm, k, step, 0.01 * gain * step + rng.normal(), charged)
        for arm, gain, charged in (("alone", 1, 0), ("pretrained", 3, 150), ("other", 1, 250))
        for k in range(seeds)
        for step in range(0, last + 1, every)
    ]
    return pd.DataFrame(rows, columns=["arm", "seed", "step", "return", "charged"])


def written(table, name="runs.csv"):
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False) if path.suffix == ".csv" else table.to_parquet(path)
    return path


def curves(table):
    """The checkpoints of a table, and the curves of each arm."""
    wide = {arm: of.pivot(index="seed", columns="step", values="return") for arm, of in table}
    return next(iter(wide.values())).columns.to_numpy(), {a: w.to_numpy() for a, w in wide.items()}


def heights(steps, alone, curve, charged):
    """Mean heights of charged curves, written down anew from the page's words."""
    rows = []
    for scratch, row in zip(alone, curve, strict=True):
        shifted = np.interp(steps - charged, steps, row)
        rows.append(np.where(steps - charged < steps[0], scratch[0], shifted))
    # A learner from scratch that began so much later, and what holding its first value gives it.
    training = steps - charged < steps[0]
    late = np.stack([np.interp(steps - charged, steps, row) for row in alone])
    held = np.where(training, alone[:, :1], late)
    gift = np.trapezoid(held - alone, steps, axis=1).mean()
    if gift > 0:
        width = np.trapezoid(1.0 * training, steps)
        rows = [row - training * gift / width for row in rows]
    return np.trapezoid(np.stack(rows), steps, axis=1) / (steps[-1] - steps[0])


def by_scipy(differences):
    """The p-value of sign flips, and Student's interval."""
    flips = stats.permutation_test(
        (differences, np.zeros_like(differences)),
        lambda a, b, axis: np.mean(a - b, axis=axis),
        permutation_type="samples",
        vectorized=True,
        n_resamples=np.inf,
    )
    bounds = stats.ttest_1samp(differences, 0.0).confidence_interval(0.95)
    return flips.pvalue, bounds.low, bounds.high


@pytest.mark.parametrize("kind", ["runs.csv", "runs.parquet"])
def test_numbers_are_those_of_scipy_and_p_is_holms(kind):
    table = long_table()
    steps, of_arm = curves(table.groupby("arm"))
    comparison = compare_files([written(table, kind)], {}, threshold=5.0)
    assert list(comparison.arms) == ["alone", "pretrained", "other"]
    assert (comparison.total, comparison.budget, comparison.seeds) == (1000, 1000, 7)
    assert comparison.scratches == ("alone",)
    p_values = {}
    for name, charged in (("pretrained", 150), ("other", 250)):
        alone = heights(steps, of_arm["alone"], of_arm["alone"], 0)
        differences = heights(steps, of_arm["alone"], of_arm[name], charged) - alone
        p, low, high = by_scipy(differences)
        contrast = comparison.contrasts[name]
        gain = contrast.strong_gain
        assert [gain.estimate, gain.low, gain.high] == pytest.approx(
            [differences.mean(), low, high]
        )
        assert contrast.p == pytest.approx(p)
        wins = stats.mannwhitneyu(differences + alone, alone).statistic / 49
        assert contrast.probability_of_improvement.estimate == pytest.approx(wins)
        weak = np.trapezoid(of_arm[name] - of_arm["alone"], steps, axis=1).mean() / 1000
        assert contrast.weak_gain.estimate == pytest.approx(weak)
        p_values[name] = p
    small, large = sorted(p_values, key=p_values.get)
    assert comparison.contrasts[small].adjusted_p == pytest.approx(2 * p_values[small])
    assert comparison.contrasts[large].adjusted_p == pytest.approx(
        max(2 * p_values[small], p_values[large])
    )
    assert comparison.contrasts["pretrained"].verdict == "pays"
    assert comparison.contrasts["other"].verdict == "costs more than it brings"


def test_curves_of_our_own_get_our_verdict():
    ours = cr.compare(corner(), seeds=6, opponents=["optimistic"], threshold=50.0)
    parts = []
    for name, arm in ours.arms.items():
        charged = int(arm.curve.source_steps[0])
        last = np.searchsorted(arm.curve.steps, ours.total - charged, side="right")
        for seed, row in enumerate(arm.curve.filled()):
            columns = {"arm": name, "seed": seed, "step": arm.curve.steps, "return": row}
            parts.append(pd.DataFrame(columns | {"charged": charged})[:last])
    theirs = compare_files([written(pd.concat(parts))], {}, threshold=50.0)
    assert theirs.scratches == ours.scratches
    assert (theirs.total, theirs.budget, theirs.window) == (ours.total, ours.budget, ours.window)
    for measure in (*MEASURES, "p", "adjusted_p", "verdict"):
        one, other = (getattr(of.contrasts["transfer"], measure) for of in (theirs, ours))
        assert str(one) == str(other), measure
    assert theirs.returns["transfer"].tolist() == ours.returns["transfer"].tolist()


def test_one_curriculum_of_one_opponent_is_printed_and_drawn(curricle):
    code, out, complaint = curricle(
        "verdict", str(EXAMPLE), "--charge", "pretrained=4096", "--out", "page.html", "--explain"
    )
    assert code == 0, complaint
    assert "costs more than it brings (p = " in out
    assert "instead of pretrained, use the target's own learner without a source\n" in out
    assert "a run is one seed, 8 an arm, paired by number" in out
    assert "study" not in out.partition("\n\n")[0]
    assert "\narm: one of the ways" in out
    page = Path("page.html").read_text("utf-8")
    assert page == page_of_runs(compare_files([EXAMPLE], CHARGE))
    assert "A run is one seed, 8 an arm" in page
    assert not re.search("study file|curriculum study|snapshots|Certificates|random policy", page)
    assert "is at the first return of scratch." in page
    assert page.count("greedy") == 1  # in what the columns mean
    sections = re.findall(r'<section id="(\w+)"', page)
    assert sections == ["findings", "curves", "measures", "run"]
    links = re.findall(r'<a href="#(\w+)">', page)
    assert [*dict.fromkeys(links)] == sections


def test_the_page_prints_what_it_says(curricle):
    text = (EXAMPLE.parents[2] / "docs" / "howto" / "judge_other_runs.md").read_text("utf-8")
    (block,) = (block for language, block in blocks(text) if language == "console")
    there, command = commands_of(block)
    assert there.line == "cd examples/other_runs"
    shutil.copy(EXAMPLE, "runs.csv")
    code, out, complaint = curricle(*command.line.split()[1:])
    assert (code, complaint) == (0, "")
    assert out.rstrip() == command.output.rstrip()


# -- layouts -----------------------------------------------------------------------------------


def evaluations(path, steps, results):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, timesteps=steps, results=results, ep_lengths=np.ones_like(results))


def monitor(path, start, episodes):
    lines = [f'#{{"t_start": {start}, "env_id": "None"}}', "r,l,t", *episodes]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    "path", ["{}/{}/evaluations.npz", "{}_{}/evaluations.npz", "logs/{}-seed{}.npz"]
)
def test_evaluations_are_runs_and_their_episodes_are_not(path, tmp_path):
    steps, rng = np.arange(10, 60, 10), np.random.default_rng(0)
    returns = {
        (arm, seed): rng.normal(arm == "b", size=(5, 4)) for arm in "ab" for seed in range(6)
    }
    rows = []
    for (arm, seed), results in returns.items():
        evaluations(tmp_path / "runs" / path.format(arm, seed), steps, results)
        rows += [(arm, seed, step, x) for step, of in zip(steps, results, strict=True) for x in of]
    files = sorted(Path("runs").rglob("*.npz"))
    if "evaluations" in path:  # that of a model, say, is left alone beside them
        Path("runs/x.csv").touch()
        files = [Path("runs")]
    comparison = compare_files(files, {"b": "5"})
    for arm in "ab":
        mean = [returns[arm, seed].mean(axis=1) for seed in range(6)]
        np.testing.assert_allclose(comparison[arm].curve.values, mean)
    assert comparison.seeds == 6
    # A long table of the same episodes is the same, once it says that they are episodes.
    table = pd.DataFrame(rows, columns=["arm", "seed", "step", "return"])
    with pytest.raises(StoreError, match="give two runs two seeds, and episodes"):
        compare_files([written(table)], {"b": "5"})
    same = compare_files([written(table.assign(episode=range(len(table))))], {"b": "5"})
    np.testing.assert_allclose(same["b"].curve.values, comparison["b"].curve.values)


def test_arms_are_what_paths_do_not_share():
    steps = np.arange(5)
    for arm in ("ppo/Cart-v1", "dqn/Cart-v1"):
        for seed in range(2):
            evaluations(Path(f"logs/{arm}_{seed}/evaluations.npz"), steps, np.ones((5, 1)))
    assert [*compare_files([Path("logs")], {"ppo/Cart-v1": "1"}).arms] == [
        "dqn/Cart-v1",
        "ppo/Cart-v1",
    ]


def test_environments_of_a_run_are_one_run():
    for arm, seed in [(arm, seed) for arm in "ab" for seed in range(2)]:
        # The second environment began a second later: the episodes end in the order 1, 2, 3, 4.
        monitor(Path(f"runs/{arm}/{seed}/0.monitor.csv"), 100.0, ["1.0,10,2.0", "4.0,10,9.0"])
        monitor(Path(f"runs/{arm}/{seed}/1.monitor.csv"), 101.0, ["2.0,20,1.5", "3.0,5,2.5"])
    files = sorted(Path("runs").rglob("*.csv"))
    for given_files in ([Path("runs")], files, [*files, Path("runs")]):
        comparison = compare_files(given_files, {"b": "7"})
        assert comparison.seeds == 2
        assert comparison["a"].curve.steps.tolist() == [10, 30, 35, 45]
        assert comparison["a"].curve.values.tolist() == [[1.0, 2.0, 3.0, 4.0]] * 2
    for file in files:  # named by files instead
        name = f"{file.parent.parent.name}_{file.parent.name}.monitor.csv"
        shutil.copy(file, name)
    named = compare_files(sorted(Path().glob("*.monitor.csv")), {"b": "4"})
    assert named["a"].curve.steps.tolist() == [20, 25]


def test_means_over_windows_keep_the_areas_of_curves():
    rng = np.random.default_rng(1)
    rows, areas, end = [], {}, 10_000
    for arm, seed in [(arm, seed) for arm in "ab" for seed in range(6)]:
        steps = np.unique([0, end, *rng.integers(1, end, size=150)])
        returns = rng.normal(size=len(steps)) + steps / 1000 * (1 + (arm == "b"))
        areas[arm, seed] = np.trapezoid(returns, steps) / end
        rows += [(arm, seed, *pair) for pair in zip(steps, returns, strict=True)]
    table = pd.DataFrame(rows, columns=["arm", "seed", "step", "return"])
    comparison = compare_files([written(table)], {}, ["b"])
    assert len(comparison["a"].curve.steps) == 101
    for arm in "ab":
        expected = [areas[arm, seed] for seed in range(6)]
        np.testing.assert_allclose(comparison.returns[arm], expected, rtol=1e-9)
    said = " ".join(comparison.remarks)
    assert "means over 100 windows, as checkpoints differ" in said
    assert "no steps are charged to b" in said


def test_a_run_that_ends_early_ends_the_comparison_and_is_named():
    table = long_table()
    cut = table[~((table.arm == "alone") & (table.seed == 3) & (table.step > 800))]
    comparison = compare_files([written(cut)], {})
    assert (comparison.total, comparison.budget) == (800, 800)
    assert "from 0 to 800, where seed 3 of 'alone' ends" in " ".join(comparison.remarks)


def test_seeds_pair_by_number_or_in_order():
    table = long_table()
    shuffled = pd.concat([of.sample(frac=1, random_state=0) for _, of in table.groupby("step")])
    one = compare_files([written(table)], {})
    assert "paired by number" in one.remarks[0]
    again = compare_files([written(shuffled)], {})
    assert {n: str(c) for n, c in again.contrasts.items()} == {
        n: str(c) for n, c in one.contrasts.items()
    }
    moved = table.assign(seed=table.seed + 10 * (table.arm == "alone"))
    other = compare_files([written(moved)], {})
    assert "paired in order, as arms have different seeds" in other.remarks[0]
    assert one.verdicts["other"].p == other.verdicts["other"].p
    lacking = table[(table.arm != "alone") | (table.seed != 3)]
    with pytest.raises(StoreError, match="'alone' and 'pretrained' one alone has 3"):
        compare_files([written(lacking)], {})


@pytest.mark.parametrize("how", [{"charge": {"scratch": "100"}}, {"curricula": ["scratch"]}])
def test_scratch_is_no_curriculum(how):
    runs = long_table().replace({"arm": {"pretrained": "scratch"}})
    with pytest.raises(SettingError, match="an arm called 'scratch' is the learner without"):
        compare_files([written(runs)], **{"charge": {}} | how)


def test_a_single_seed_has_no_verdict():
    comparison = compare_files([written(long_table(seeds=1))], {})
    assert comparison.verdicts["other"].against_scratch.startswith("too few seeds for a verdict (1")


# -- what is refused ---------------------------------------------------------------------------

ONE_SENTENCE = re.compile(r"(?!.*\. [A-Z])[^\n]+")


def refused(call, error=StoreError):
    with pytest.raises(error) as caught:
        call()
    assert ONE_SENTENCE.fullmatch(str(caught.value)), str(caught.value)
    return str(caught.value)


def test_arguments_that_do_not_fit_the_files_are_refused(curricle):
    path = written(long_table().drop(columns="charged"))
    for charge, curricula, threshold, words in (
        ({}, (), None, "alone, pretrained, other are all opponents"),
        (dict.fromkeys(("alone", "pretrained", "other"), "9"), (), None, "are all curricula"),
        ({"own": "9"}, (), None, "an arm must be one of .*: got 'own'"),
        ({"other": "9"}, ("own",), None, "an arm must be one of .*: got 'own'"),
        ({"other": "9"}, (), float("nan"), "--threshold must be finite: got nan"),
    ):
        said = refused(
            lambda c=charge, k=curricula, t=threshold: compare_files([path], c, k, t), SettingError
        )
        assert re.search(words, said)
    for steps, words in (("x", "'x'"), ("-1", "got -1"), ("1.5", "got 1.5"), ("", "''")):
        said = refused(lambda s=steps: compare_files([path], {"other": s}))
        assert "charge in --charge other must be" in said
        assert words in said
    said = refused(lambda: compare_files([path], {"other": "1000"}))
    assert "seed 0 of 'other', charged 1,000, has 11 there" in said
    code, out, complaint = curricle("verdict", "runs.csv", "--charge", "other")
    assert (code, out) == (1, "")
    assert "an arm must be one of" in complaint


def with_cell(table, row, column, cell):
    changed = table.astype(object)
    changed.loc[row, column] = cell
    return changed


MISTAKES = {
    "a text": lambda t, row, column: with_cell(t, row, column, "abc"),
    "a blank": lambda t, row, column: with_cell(t, row, column, None),
    "not a number": lambda t, row, column: with_cell(t, row, column, "nan"),
    "infinite": lambda t, row, column: with_cell(t, row, column, "-inf"),
    "huge": lambda t, row, column: with_cell(t, row, column, 1e300),
    "lost": lambda t, row, column: t.drop(columns=column),
}


@given(mistake=st.sampled_from([*MISTAKES]), row=st.integers(0, 76), data=st.data())
def test_a_cell_that_is_no_number_is_refused_by_its_place(mistake, row, data):
    table = long_table(seeds=7)[["arm", "seed", "step", "return", "charged"]]
    column = data.draw(st.sampled_from(["seed", "step", "return"]))
    path = written(MISTAKES[mistake](table, row, column))
    said = refused(lambda: compare_files([path], {}))
    assert f"runs.csv, row {1 if mistake == 'lost' else row + 1}" in said
    assert column in said


@given(row=st.integers(1, 10), how=st.sampled_from(["again", "back", "charged"]))
def test_rows_that_are_no_single_run_are_refused_by_their_place(row, how):
    table = long_table()
    match how:
        case "again":
            table = pd.concat([table[: row + 1], table[row:]])
        case "back":
            table.loc[row, "step"] = table.step[row - 1] - 1 if row > 1 else 0
        case "charged":
            table.loc[row, "charged"] = 7
    said = refused(lambda: compare_files([written(table)], {}))
    assert f"in runs.csv, row {row + (how == 'again') + 1}" in said
    assert "seed 0 of 'alone'" in said


def test_the_same_run_in_two_files_is_refused_by_both():
    written(long_table(), "one.csv")
    said = refused(lambda: compare_files([written(long_table(), "two.csv"), Path("one.csv")], {}))
    assert "two.csv, row 11" in said
    assert "one.csv, row 1" in said


CONTENTS = {
    "empty.csv": (b"", "Empty CSV file"),
    "head.csv": (b"arm,seed,step,return\n", "must hold results"),
    "short.csv": (b"arm,seed,step,return\na,0,0,1\na,0,1\n", "Expected 4 columns, got 3"),
    "twice.csv": (b"arm,seed,step,step\na,0,0,1\n", "two columns have one name"),
    "bytes.csv": (b"arm,seed,step,return\n\xff,0,0,1\n", "bytes.csv"),
    "x.parquet": (b"PAR1", "x.parquet cannot be read"),
    "x.npz": (b"PK", "x.npz cannot be read"),
    "x.txt": (b"arm,seed\n", "x.txt cannot be read"),
    "a_1.monitor.csv": (b"r,l,t\n1,2,3\n", "a_1.monitor.csv cannot be read"),
    "a_2.monitor.csv": (b'#{"t_start": 1}\n', "a_2.monitor.csv cannot be read"),
    "a_3.monitor.csv": (b'#{"t_start": 1}\nr,l\n1,2\n', "t in a_3.monitor.csv, row 1"),
    "a_4.monitor.csv": (b'#{"t_start": 1}\nr,l,t\n1,0,3\n', "l in a_4.monitor.csv, row 1"),
    "a_5.monitor.csv": (b'#{"t_start": "x"}\nr,l,t\n1,1,3\n', "t_start in a_5.monitor.csv, row 1"),
    "monitor.csv": (b'#{"t_start": 1}\nr,l,t\n1,1,3\n', "monitor.csv, row 1 has no seed"),
}


@pytest.mark.parametrize("name", CONTENTS)
def test_a_malformed_file_is_refused_by_its_name(name):
    content, words = CONTENTS[name]
    Path(name).write_bytes(content)
    assert words in refused(lambda: compare_files([Path(name)], {}))


@pytest.mark.parametrize(
    "arrays",
    [
        {"timesteps": np.arange(3)},
        {"timesteps": np.arange(3), "results": np.ones(3)},
        {"timesteps": np.arange(3), "results": np.ones((2, 4))},
        {"timesteps": np.arange(3), "results": np.ones((3, 0))},
        {"timesteps": np.int64(3), "results": np.ones((3, 1))},
        {"timesteps": np.arange(2), "results": np.array([[1, 2], [3]], dtype=object)},
        {"timesteps": np.arange(3), "results": np.full((3, 2), np.nan)},
    ],
)
def test_malformed_evaluations_are_refused_by_their_name(arrays):
    np.savez("a_0.npz", **arrays)
    assert "a_0.npz" in refused(lambda: compare_files([Path("a_0.npz")], {}))


@pytest.mark.parametrize("kind", KINDS_OF_NO_FILE)
def test_what_is_no_file_is_refused_by_its_name(kind):
    no_file(Path("a_0.npz"), kind)
    assert "a_0.npz" in refused(lambda: compare_files([Path("a_0.npz")], {}))
    assert "missing.csv" in refused(lambda: compare_files([Path("missing.csv")], {}))


def valid_files():
    """The content of a valid file of each format."""
    table = long_table(seeds=2, last=300)
    parquet, npz = io.BytesIO(), io.BytesIO()
    table.to_parquet(parquet)
    np.savez(npz, timesteps=np.arange(4), results=np.ones((4, 2)))
    head = json.dumps({"t_start": 1.5, "env_id": "x"})
    return {
        "runs.csv": table.to_csv(index=False).encode(),
        "runs.parquet": parquet.getvalue(),
        "a_0.npz": npz.getvalue(),
        "a_0.monitor.csv": f"#{head}\nr,l,t\n1.0,3,0.5\n2.0,4,0.9\n".encode(),
    }


@settings(max_examples=150)
@given(name=st.sampled_from([*valid_files()]), data=st.data())
def test_a_damaged_file_is_read_or_refused_in_a_sentence(name, data):
    content = bytearray(valid_files()[name])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.one_of(st.none(), st.integers(0, len(content))))
    Path(name).write_bytes(content[:cut])
    said = ""
    try:
        text = compare_files([Path(name)], {"pretrained": "150"}, threshold=1.0).text()
    except CurricleError as error:
        said = str(error)
    assert ONE_SENTENCE.fullmatch(said or text.splitlines()[0])
