"""The benchmark of pairs: its families, its studies, and the tables printed from their folders."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.pairs import __main__ as tables, pairs
from benchmarks.pairs.families import FRESH, VERIFICATION
from curricle import compare, evaluate, read_study, run_study, solve

STUDIES = {file.stem: file for file in sorted(Path("benchmarks/pairs").glob("*.toml"))}
FEW = ["seeds=8", "tasks.target.budget=1_200", "tasks.target.eval_freq=120"]
ARMS = ["near: less demand", "negated: less demand", "far: half the price"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    home = tmp_path_factory.mktemp("pairs")
    for place, set in ("pairs", []), ("raw", ["shaping=QInitialisation", "controls=[]"]):
        study = read_study(STUDIES["stock"], set=[*FEW, *set], arms=ARMS)
        run_study(study, home / place / "stock")
    return home


def described(pair):
    return f"{pair.kind}: {pair.label.removesuffix(f', {pair.kind}')}"


def test_every_verification_and_fresh_pair_is_an_arm_of_a_study():
    """But for those whose source learns too long, which a budget that is not stated never does."""
    listed = [pair for split in ("verification", "fresh") for pair in pairs(split)]
    kept = {
        (f"{pair.family}, {pair.target_name}", described(pair)): pair
        for pair in listed
        if pair.kind != "too large"
    }
    assert len({pair.family for pair in kept.values()}) == len({*VERIFICATION, *FRESH})
    for study in map(read_study, STUDIES.values()):
        for arm, plan in study.curricula.items():
            pair = kept.pop((study.name, arm))
            assert [edge.scale for edge in plan.transfers] == [pair.scale] * len(pair.mappings)
            for edge, mapping in zip(plan.transfers, pair.mappings, strict=True):
                np.testing.assert_array_equal(edge.mapping.index, mapping.index)
            assert plan.setting("budget", "target") == pair.target_budget
            assert plan.setting("aggregate", "target") is pair.aggregate
    assert not kept


def test_gains_are_those_of_a_comparison(folders):
    played = tables.Played(str(folders / "pairs/stock"))
    plan = read_study(STUDIES["stock"], set=FEW, arms=ARMS)
    expected = compare({arm: plan.curricula[arm] for arm in ARMS}, seeds=8)
    for arm in ARMS:
        gains = expected[arm].strong_gain(expected.scratch) / played.way
        np.testing.assert_allclose(played.gains(arm), gains, atol=1e-12)
        assert played.gain(arm)[0] <= gains.mean() + 1e-12  # over the best opponent
    task = plan.curricula[ARMS[0]].tasks["target"]
    uniform = np.full((task.states.size, task.actions.size), 1 / task.actions.size)
    way = solve(task).start_value - evaluate(task, uniform).start_value
    assert played.way == pytest.approx(way, rel=0.05)  # which ends at the time limit


def test_the_tables_say_what_pays_and_whether_the_forecasts_were_right(folders, tmp_path, capsys):
    stored = str(folders / "pairs/stock")
    played = tables.Played(stored)
    foreseen = {played.name: {arm: played.gain(arm) for arm in ARMS}}
    file = tmp_path / "forecasts.json"
    file.write_text(json.dumps(foreseen))
    tables.main(["gains", stored, "--beside", str(folders / "raw"), "--forecasts", str(file)])
    text = capsys.readouterr().out
    assert "verification: 1 targets" in text
    assert "rank correlation within targets: 1.00" in text
    assert all(f"  {arm}" in text for arm in ARMS)
    assert "2 sensible sources" in text
    tables.main(["again", stored])
    paying = [arm for arm in ARMS if played.pays(arm)]
    assert capsys.readouterr().out.count("--arm") == len(paying)


def test_ranks_are_compared_within_targets_only():
    """Two targets whose returns differ by thousands: what counts is the order in each."""
    target = np.array(["a"] * 3 + ["b"] * 3)
    gain = np.array([1.0, 2.0, 3.0, 1001.0, 1002.0, 1003.0])
    assert tables.pooled_rank(gain, gain, target) == pytest.approx(1.0)
    assert tables.pooled_rank(-gain, gain, target) == pytest.approx(-1.0)
    swapped = np.array([1.0, 2.0, 3.0, 3.0, 2.0, 1.0])
    assert tables.pooled_rank(swapped, gain, target) == pytest.approx(0.0)
