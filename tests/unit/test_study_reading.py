"""A study's tables are read by other tools, without Curricle, and say what Curricle says."""

import re

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pytest

from curricle.cli.output import print_results
from curricle.comparison.measures import Arm
from curricle.errors import CurriculumError
from curricle.show.report import write_report
from curricle.study import StudyResults, compare_studies, merge, run_study
from curricle.study.results import DECISIONS as ALL_DECISIONS, RESULTS
from curricle.study.store import ANALYSIS
from tests.support.studies import CORNER, LINES

OF_CORNER = [
    *("seeds=3", "eval_freq=100", "learner.learning_rate=0.5"),
    "tasks.corner.budget={ max_steps = 4_000 }",
]

TEXT, INT, FLOAT = "VARCHAR", "BIGINT", "DOUBLE"
CURVES = {
    **{"arm": TEXT, "task": TEXT, "seed": INT, "checkpoint": INT, "steps": INT},
    **{"source_steps": INT, "training_return": FLOAT, "greedy_return": FLOAT},
    **{"source_share": FLOAT, "agreement": FLOAT, "episodes": INT},
}
DECISIONS = {
    **{"arm": TEXT, "task": TEXT, "seed": INT, "steps": INT, "ends": "BOOLEAN", "criterion": TEXT},
    **{"lowest": FLOAT, "level": FLOAT, "rise": FLOAT, "settled": FLOAT, "reason": TEXT},
}


@pytest.fixture(scope="module")
def study(finished):
    return StudyResults(finished)


@pytest.mark.parametrize(("name", "columns"), [(RESULTS, CURVES), (ALL_DECISIONS, DECISIONS)])
def test_columns_and_their_types(finished, name, columns):
    described = duckdb.sql(f"DESCRIBE SELECT * FROM '{finished / name}'").fetchall()
    assert {row[0]: row[1] for row in described} == columns
    frame, other = pd.read_parquet(finished / name), pl.read_parquet(finished / name)
    assert list(frame.columns) == list(other.columns) == list(columns)
    kinds = {TEXT: pl.String, INT: pl.Int64, FLOAT: pl.Float64, "BOOLEAN": pl.Boolean}
    assert other.schema == {column: kinds[kind] for column, kind in columns.items()}
    plain = {INT: "int64", FLOAT: "float64", "BOOLEAN": "bool"}
    for column, kind in columns.items():
        if kind in plain:  # what pandas calls text depends on its version
            assert str(frame[column].dtype) == plain[kind]
    numbered = [column for column in columns if columns[column] != FLOAT]
    assert not frame[numbered].isna().any(axis=None)


def test_curves_are_those_of_the_results(finished, study):
    frame = pd.read_parquet(finished / RESULTS)
    for (arm, node, seed), part in frame.groupby(["arm", "task", "seed"]):
        result = study.results[arm][node]
        k = result.seeds.index(seed)
        n = len(part)
        assert part.checkpoint.tolist() == list(range(n))
        assert part.steps.tolist() == result.steps[:n].tolist()
        assert part.steps.max() <= result.steps_used[k] < part.steps.max() + result.steps[1]
        for name in ("training_return", "greedy_return", "source_share", "agreement", "episodes"):
            np.testing.assert_array_equal(part[name], getattr(result, name)[k, :n])
        assert set(part.source_steps) == {study.source_steps(arm, node)[k]}
    # What arms share is there once: the table without such arms is what NumPy reads of the units.
    of_arms, returns = frame[(frame.arm != "state") | (frame.task != "corner")], []
    for file in finished.glob("units/*/*.npz"):
        with np.load(file) as unit:
            reached = unit["steps"] <= unit["steps_used"][:, None]
            returns += unit["greedy_return"][reached].tolist()
    assert sorted(map(repr, returns)) == sorted(map(repr, of_arms.greedy_return.tolist()))


def test_every_seed_of_every_task_says_why_it_ended(finished, study):
    frame = pl.read_parquet(finished / ALL_DECISIONS)
    last = frame.group_by("arm", "task", "seed", maintain_order=True).last()
    assert len(last) == 4 * len(study.record.keys)
    assert last["ends"].all()
    assert last["reason"].str.starts_with("ends; ").all()
    assert set(last["criterion"]) <= {"threshold reached", "agreement reached", "all steps used"}
    rows = frame.filter(pl.col("task") == "corner", pl.col("arm") == "chain")
    assert (rows["level"] == 194.5).all()
    ended = rows.filter(pl.col("ends"))
    assert ended["steps"].to_list() == study.results["chain"]["corner"].steps_used.tolist()
    assert (ended["lowest"] >= ended["level"]).all()
    assert (rows.filter(~pl.col("ends"))["lowest"].fill_nan(-1e9) < 194.5).all()


def test_a_page_of_a_run_that_has_not_ended_says_what_it_lacks(copied):
    whole = write_report(copied).read_text()
    assert '<dl class="certificates">' in whole
    (copied / ANALYSIS).unlink()
    (copied / "runs.json").unlink()  # a page of nothing but results
    page = write_report(copied).read_text()
    assert '<dl class="certificates">' not in page
    assert "left out, because the run has not ended: curricle run --resume makes them" in page
    assert page.count('class="moments') == whole.count('class="moments') > 0


@pytest.fixture
def corner(read, tmp_path):
    """A function: budget, changes -> the results of a study with so many steps for its target."""

    def ran(budget, *changes):
        study = read(CORNER, set=[*OF_CORNER, f"tasks.maze.budget={budget}", *changes])
        return run_study(study, tmp_path / f"of_{budget}", workers=1, progress=False)

    return ran


def test_the_smallest_total_must_leave_steps_for_every_target(corner):
    """Or its curve would be read from the end: a target that was learnt before its first step."""
    small, large = corner(1000, "tasks.corner.budget=200"), corner(9000)
    assert large.source_steps("transfer").max() > small.record.total
    for studies in ([small, large], [large, small]):
        with pytest.raises(CurriculumError, match=r"arm 'transfer' of .*of_9000 took 4,000 of its"):
            compare_studies(studies)
    target = large.results["transfer"]["maze"]
    with pytest.raises(CurriculumError, match="at most the total of 1,200 steps: got 4,000"):
        Arm.of(
            target,
            large.source_steps("transfer"),
            (1200, 100),
            target.seeds,
            unlearnt={},
            initial_values=None,
        )


def test_what_depends_on_the_total_is_compared_at_one_alone(corner):
    small, large = (corner(budget, "tasks.corner.budget=200") for budget in (1000, 3000))
    for why, fault in (("a schedule", "a schedule"), (None, "did not note whether")):
        arms = large.record.arms
        other = arms["transfer"].model_copy(update={"depends_on_total": why})
        large.record = large.record.model_copy(update={"arms": {**arms, "transfer": other}})
        message = rf"'transfer' of .*of_3000 had 3,200 .* smallest total is 1,200 .*{fault}"
        with pytest.raises(CurriculumError, match=message):
            compare_studies([small, large])
        large.record = large.record.model_copy(update={"arms": arms})
    together = compare_studies([small, large])
    assert (together.total, together.budget) == (1200, 1000)
    assert compare_studies([large, small]).budget == 1000
    # ... and what was learnt by it is the same in both.
    short, long = (together[f"of_{budget}: transfer"].curve for budget in (1000, 3000))
    np.testing.assert_array_equal(short.values, long.values)
    np.testing.assert_array_equal(short.source_steps, long.source_steps)


def test_while_seeds_are_missing_there_is_no_verdict(read, tmp_path, capsys):
    interim, pages = "interim, 8 of 16 seeds: no verdict", []
    study = read(LINES, set=["seeds=16", "seeds_per_unit=4", "eval_freq=50"])
    for shard in ((1, 2), (2, 2)):
        part = run_study(study, tmp_path / f"{shard[0]}", shard=shard, progress=False)
        print_results(part, None, None)
        saved = write_report(part.store.path)
        pages.append(capsys.readouterr().out + saved.read_text())
        assert part.comparison.interim == interim
        assert interim in pages[-1]
        assert interim.capitalize() in pages[-1]
    whole = merge(tmp_path / "whole", [tmp_path / "1", tmp_path / "2"])
    assert whole.comparison.interim == ""
    print_results(whole, None, None)
    text = capsys.readouterr().out + write_report(whole.store.path).read_text()
    for sign in (r"\bp\s=\s\d", r"\bp values?\b", "significant"):
        assert not any(re.search(sign, page) for page in pages)
        assert re.search(sign, text) or sign == "significant"


def test_a_page_of_some_arms_has_no_verdict(finished):
    study = StudyResults(finished)
    part = StudyResults(study.store, study.record.only({"scratch", "chain"}))
    assert part.comparison.interim == "interim, 4 of 4 seeds of some arms: no verdict"
    every = StudyResults(study.store, study.record.only(study.record.arms))
    assert every.comparison.interim == ""


def test_a_window_ends_with_the_smallest_budget(read, tmp_path):
    """4 checkpoints in the first study, but the second has only 3 within its budget."""
    studies = []
    for name, budget, window in (("long", 300, 4), ("short", 200, 1)):
        changes = [f"name='{name}'", "seeds=2", "eval_freq=100", f"window={window}"]
        study = read(LINES, set=[*changes, f"tasks.far.budget={budget}"])
        studies.append(run_study(study, tmp_path / name, workers=1, progress=False))
    assert compare_studies(studies[:1]).window == 4
    both = compare_studies(studies)
    assert (both.budget, both.window) == (200, 3)
    assert both.rows()[1]["weak_steps_saved"] <= 200
