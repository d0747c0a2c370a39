"""The runner of the benchmark of pairs: its rows, its parts, and the tables printed from them."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks.pairs import run, tables
from benchmarks.pairs.arms import RAW, curricula
from benchmarks.pairs.playing import pair_named
from benchmarks.pairs.results import Played, read, realised
from curricle import compare

CORNER, LOST = "mazes/2, treasure", "locks/the last two"
COLUMNS = {
    "pair", "family", "split", "kind", "sensible", "target", "arm", "seed", "gain", "weak_gain",
    "mean_return", "weak_mean_return", "scratch_mean_return", "start_return", "final_return",
    "weak_final_gain", "steps_to_threshold", "reached", "threshold", "random_return", "optimum",
    "source_steps", "source_return", "source_optimum",
    "source_random_return", "source_budget", "target_budget", "total", "source_share", "verdict",
    "reason", "pair_seconds",
}  # fmt: skip


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    out = tmp_path_factory.mktemp("pairs") / "two.parquet"
    arms = f"{RAW},guarded,default"
    run.main(["--pair", CORNER, "--pair", LOST, "--seeds", "2", "--arms", arms, "--workers", "1",
              "--out", str(out)])  # fmt: skip
    return out


def test_a_row_is_an_arm_of_a_pair_with_a_seed(played):
    table = pq.read_table(played)
    assert set(table.column_names) >= COLUMNS
    rows = table.to_pylist()
    keys = [(row["pair"], row["arm"], row["seed"]) for row in rows]
    assert len(set(keys)) == len(keys)
    assert {(pair, seed) for pair, _, seed in keys} == {
        (p, k) for p in (CORNER, LOST) for k in (0, 1)
    }
    arms = {"scratch", RAW, f"{RAW}, negated", f"{RAW}, placebo", "guarded", "default"}
    assert arms <= {arm for _, arm, _ in keys}


def test_the_gain_is_what_a_comparison_of_that_pair_alone_says(played):
    (pair,) = (row for row in read([played]) if row.name == CORNER)
    result = compare({RAW: curricula(pair_named(CORNER), [RAW])[RAW]}, seeds=2, opponents=())
    gain = result[RAW].strong_gain(result.scratch)
    np.testing.assert_array_equal(pair.arms[RAW]["gain"], gain)
    np.testing.assert_array_equal(pair.gains(RAW), gain / pair.way)
    assert pair.facts["source_budget"] == 1_500
    assert set(pair.arms[RAW]["source_steps"]) == {1_500}
    assert set(pair.arms["guarded"]["total"]) == set(pair.arms[RAW]["total"])
    # Nothing set, the source ends when it has settled, or after a tenth of the target's steps.
    (most,) = set(pair.arms["default"]["total"] - pair.facts["target_budget"])
    assert most == pair.facts["target_budget"] // 10
    assert (pair.arms["default"]["source_steps"] < most).all()
    assert set(pair.arms["scratch"]["gain"]) == {0.0}


def test_a_run_goes_on_where_it_was_and_the_result_is_the_same(played):
    first = pq.read_table(played)
    parts = sorted(played.with_suffix(".parquet.parts").iterdir())
    assert len(parts) == 2
    kept = {part: part.stat().st_mtime_ns for part in parts}
    parts[0].unlink()
    arms = [RAW, "guarded", "default"]
    chosen = [pair_named(CORNER), pair_named(LOST)]
    run.run(chosen, arms, 2, played, 1)
    again = sorted(played.with_suffix(".parquet.parts").iterdir())
    assert again == parts
    assert again[1].stat().st_mtime_ns == kept[parts[1]]
    second = pq.read_table(played)
    shares = [np.asarray(table["source_share"]) for table in (first, second)]
    np.testing.assert_array_equal(*shares)  # NaN where there is no portfolio
    apart = ["pair_seconds", "source_share"]
    assert second.drop_columns(apart).equals(first.drop_columns(apart))


def test_the_tables_print_every_bar(played, capsys):
    tables.main([str(played)])
    text = capsys.readouterr().out
    assert text.count("MET: ") == 2 * 4
    assert "1, treasure" not in text
    assert realised([played])[LOST][0] > 0.5


# -- tables, on pairs with known numbers -----------------------------------------------------------


def known(name, **gains):
    """Return a pair whose arms gain these shares of the way, scratch covering half of it."""
    noise = np.array([-0.001, 0.0, 0.001])
    facts = {
        "family": "f", "split": "development", "kind": "near", "sensible": True, "target": "t",
        "random_return": -10.0, "optimum": 10.0, "target_budget": 100, "source_return": 1.0,
        "source_random_return": 0.0, "source_optimum": 2.0,
    }  # fmt: skip
    arms = {
        arm: {
            "gain": 20 * (gain + noise), "weak_gain": 20 * (gain + noise),
            "weak_final_gain": 20 * (gain + noise), "mean_return": 20 * gain + 0 * noise,
            "weak_mean_return": 20 * gain + 0 * noise,
            "verdict": np.array(["pays"] * 3), "reason": np.array([""] * 3),
        }
        for arm, gain in {"scratch": 0.0, **gains}.items()
    }  # fmt: skip
    return Played(f"f/{name}", facts, arms)


def bar_of(lines):
    return next(line for line in lines if line.startswith(("MET", "NOT MET")))


def test_the_guard_must_cap_harm_and_keep_gains():
    good = known("good", raw=0.2, guarded=0.19)
    capped = known("capped", raw=-0.4, guarded=-0.04)
    assert bar_of(tables.portfolio([good, capped])).startswith("MET")
    harmed = known("harmed", raw=-0.4, guarded=-0.06)
    result = bar_of(tables.portfolio([good, harmed]))
    assert result.startswith("NOT MET")
    assert "in 1 of 2 pairs (shown in 1; raw in 1)" in result
    lost = known("lost", raw=0.2, guarded=0.1)
    assert "keeps 50%" in bar_of(tables.portfolio([lost]))
