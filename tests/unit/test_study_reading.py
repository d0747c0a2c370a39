"""A study's tables are read by other tools, without Curricle, and say what Curricle says."""

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pytest

from curricle.report.study_report import write_report
from curricle.study import StudyResults, compare_studies, read_study, run_study
from curricle.study.results import ANALYSIS, DECISIONS as ALL_DECISIONS, RESULTS

CURVES = {
    "arm": "VARCHAR",
    "task": "VARCHAR",
    "seed": "BIGINT",
    "checkpoint": "BIGINT",
    "steps": "BIGINT",
    "source_steps": "BIGINT",
    "training_return": "DOUBLE",
    "greedy_return": "DOUBLE",
    "guard_share": "DOUBLE",
    "episodes": "BIGINT",
}
DECISIONS = {
    "arm": "VARCHAR",
    "task": "VARCHAR",
    "seed": "BIGINT",
    "steps": "BIGINT",
    "ends": "BOOLEAN",
    "criterion": "VARCHAR",
    "lowest": "DOUBLE",
    "level": "DOUBLE",
    "rise": "DOUBLE",
    "plateau": "DOUBLE",
    "reason": "VARCHAR",
}
FINALS = """
SELECT arm, avg(greedy_return) AS final FROM (
    SELECT *, row_number() OVER (PARTITION BY arm, seed ORDER BY checkpoint DESC) AS back
    FROM '{file}' WHERE task = 'maze')
WHERE back = 1 GROUP BY arm
"""


@pytest.fixture(scope="module")
def study(finished):
    return StudyResults(finished)


@pytest.fixture(scope="module")
def finals(study):
    """Mean greedy return of each arm at the end of the total budget."""
    arms = study.comparison.arms
    return {name: arm.curve.values[:, -1].mean() for name, arm in arms.items()}


@pytest.fixture(scope="module")
def rows(study):
    """How many checkpoints all seeds of all tasks of all arms reached."""
    return sum(
        int((result.steps <= used).sum())
        for arm in study.results.values()
        for result in arm.values()
        for used in result.steps_used
    )


@pytest.mark.parametrize(("name", "columns"), [(RESULTS, CURVES), (ALL_DECISIONS, DECISIONS)])
def test_columns_and_their_types(finished, name, columns):
    described = duckdb.sql(f"DESCRIBE SELECT * FROM '{finished / name}'").fetchall()
    assert {row[0]: row[1] for row in described} == columns
    frame, other = pd.read_parquet(finished / name), pl.read_parquet(finished / name)
    assert list(frame.columns) == list(other.columns) == list(columns)
    kinds = {"VARCHAR": pl.String, "BIGINT": pl.Int64, "DOUBLE": pl.Float64, "BOOLEAN": pl.Boolean}
    assert other.schema == {column: kinds[kind] for column, kind in columns.items()}
    plain = {"BIGINT": "int64", "DOUBLE": "float64", "BOOLEAN": "bool"}
    for column, kind in columns.items():
        if kind in plain:  # what pandas calls text depends on its version
            assert str(frame[column].dtype) == plain[kind]
    assert (
        not frame.drop(columns=[c for c in columns if columns[c] == "DOUBLE"]).isna().any(axis=None)
    )


def test_duckdb_says_the_same(finished, finals, rows):
    file = finished / RESULTS
    assert duckdb.sql(f"SELECT count(*) FROM '{file}'").fetchall() == [(rows,)]
    assert dict(duckdb.sql(FINALS.format(file=file)).fetchall()) == pytest.approx(finals)


def test_arrays_of_units_are_read_by_numpy_alone(finished):
    # What arms share is there once: the study's table without arms is what the units hold.
    of_arms = pd.read_parquet(finished / RESULTS)
    of_arms = of_arms[(of_arms.arm != "state") | (of_arms.task != "corner")]
    returns, files = [], list(finished.glob("units/*/*.npz"))
    for file in files:
        with np.load(file) as unit:
            reached = unit["steps"] <= unit["steps_used"][:, None]
            returns += unit["greedy_return"][reached].tolist()
    assert len(files) > 1
    assert sorted(map(repr, returns)) == sorted(map(repr, of_arms.greedy_return.tolist()))


def test_curves_are_those_of_the_results(finished, study):
    frame = pd.read_parquet(finished / RESULTS)
    for (arm, node, seed), part in frame.groupby(["arm", "task", "seed"]):
        result = study.results[arm][node]
        k = result.seeds.index(seed)
        n = len(part)
        assert part.checkpoint.tolist() == list(range(n))
        assert part.steps.tolist() == result.steps[:n].tolist()
        assert part.steps.max() <= result.steps_used[k] < part.steps.max() + result.steps[1]
        for name in ("training_return", "greedy_return", "guard_share", "episodes"):
            np.testing.assert_array_equal(part[name], getattr(result, name)[k, :n])
        assert set(part.source_steps) == {study.source_steps(arm, node)[k]}


def test_every_seed_of_every_task_says_why_it_ended(finished, study):
    frame = pl.read_parquet(finished / ALL_DECISIONS)
    last = frame.group_by("arm", "task", "seed", maintain_order=True).last()
    assert len(last) == 4 * len(study.record.keys)
    assert last["ends"].all()
    assert last["reason"].str.starts_with("ends; ").all()
    assert set(last["criterion"]) <= {"threshold reached", "all steps used"}
    rows = frame.filter(pl.col("task") == "corner", pl.col("arm") == "chain")
    assert (rows["level"] == 194.5).all()
    ended = rows.filter(pl.col("ends"))
    assert ended["steps"].to_list() == study.results["chain"]["corner"].steps_used.tolist()
    assert (ended["lowest"] >= ended["level"]).all()
    assert (rows.filter(~pl.col("ends"))["lowest"].fill_nan(-1e9) < 194.5).all()


def test_a_page_of_a_run_that_has_not_ended_says_what_it_lacks(copied):
    whole = write_report(copied).read_text()
    assert "predicted start" in whole
    (copied / ANALYSIS).unlink()
    (copied / "runs.json").unlink()  # a page of nothing but results
    page = write_report(copied).read_text()
    assert "predicted start" not in page
    assert "left out, because the run has not ended: curricle run --resume makes them" in page
    assert page.count('class="moments') == whole.count('class="moments') > 0


def test_a_window_ends_with_the_smallest_budget(tmp_path):
    """4 checkpoints in the first study, but the second has only 3 within its budget."""
    studies = []
    for name, budget, window in (("long", 300, 4), ("short", 200, 1)):
        file = tmp_path / f"{name}.toml"
        file.write_text(
            f"name = '{name}'\nseeds = 2\neval_freq = 100\nwindow = {window}\n"
            f"tasks.near = {{ type = 'maze', map = 'S.T', budget = {{ max_steps = 100 }} }}\n"
            f"tasks.far = {{ type = 'maze', map = 'S..T', budget = {budget} }}\n"
            "transfers = [{ source = 'near', target = 'far', mapping = 'same_position',"
            " unmapped_value = 0 }]\n"
        )
        studies.append(run_study(read_study(file), tmp_path / name, workers=1, progress=False))
    assert compare_studies(studies[:1]).window == 4
    both = compare_studies(studies)
    assert (both.budget, both.window) == (200, 3)
    assert both.rows()[1]["weak_steps_saved"] <= 200
