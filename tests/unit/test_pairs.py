"""The benchmark of pairs: the tables that are printed from the folders of its studies."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.pairs import __main__ as tables
from benchmarks.portfolio import print_shares
from curricle import compare, evaluate, read_study, run_study, solve

FOLDER = Path("benchmarks/pairs")
STUDIES = [*FOLDER.glob("*.toml"), *Path("benchmarks/large").glob("*.toml")]
FEW = ["seeds=8", "tasks.target.budget=1_200", "tasks.target.eval_freq=120"]
ARMS = ["near: less demand", "negated: less demand", "far: half the price"]


@pytest.mark.parametrize("file", sorted(STUDIES), ids=lambda file: file.stem)
def test_every_study_is_read(file):
    assert read_study(file).curricula


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    home = tmp_path_factory.mktemp("pairs")
    for place, set in ("pairs", []), ("raw", ["shaping=QInitialisation", "controls=[]"]):
        study = read_study(FOLDER / "stock.toml", set=[*FEW, *set], arms=ARMS)
        run_study(study, home / place / "stock")
    return home


def test_gains_are_those_of_a_comparison(folders):
    played = tables.Played(str(folders / "pairs/stock"))
    plan = read_study(FOLDER / "stock.toml", set=FEW, arms=ARMS)
    expected = compare({arm: plan.curricula[arm] for arm in ARMS}, seeds=8)
    for arm in ARMS:
        gains = (expected.returns[arm] - expected.returns["scratch"]) / played.way
        np.testing.assert_allclose(played.gains(arm), gains, atol=1e-12)
        assert played.gain(arm)[0] <= gains.mean() + 1e-12  # over the best opponent
    task = plan.curricula[ARMS[0]].tasks["target"]
    uniform = np.full((task.states.size, task.actions.size), 1 / task.actions.size)
    way = solve(task).start_value - evaluate(task, uniform).start_value
    assert played.way == pytest.approx(way, rel=0.05)  # which ends at the time limit


def test_shares_of_the_way_are_those_of_the_gains(folders, capsys):
    """From the random policy's return; the source's steps make the difference to weak gains."""
    played = tables.Played(str(folders / "pairs/stock"))
    print_shares(str(folders / "pairs/stock"))
    rows = [line.rsplit(maxsplit=3) for line in capsys.readouterr().out.splitlines()[1:]]
    shares = {arm.strip(): (float(own), float(whole)) for arm, _, own, whole in rows}
    comparison, random = played.comparison, played.comparison.reference.random_return
    for arm in ARMS:
        charged = (comparison.returns[arm].mean() - random) / played.way
        assert shares[arm][1] == pytest.approx(charged, abs=0.006)
        weak = comparison.weak_gain(arm, "scratch").estimate / played.way
        assert shares[arm][0] - shares["scratch"][0] == pytest.approx(weak, abs=0.011)


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
