"""Files that Stable-Baselines3 itself writes are read as its own functions read them."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.monitor import load_results
from stable_baselines3.common.results_plotter import ts2xy

from curricle.comparison.other_runs import compare_files, read_runs

SCRIPT = Path(__file__).parents[2] / "examples" / "other_runs" / "train.py"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder of short runs that the example made."""
    spec = importlib.util.spec_from_file_location("other_runs_example", SCRIPT)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    example.SOURCE, example.TARGET = 512, 1024
    folder = tmp_path_factory.mktemp("made") / "runs"
    for arm in example.ARMS:
        for seed in range(1):
            example.train(folder / arm / str(seed), seed, arm == "pretrained")
    return folder


def test_evaluations_are_those_of_the_callback(runs):
    comparison = compare_files([runs], {"pretrained": "200"})
    assert [*comparison.arms] == ["scratch", "pretrained"]
    for arm in comparison.arms:
        assert comparison[arm].curve.steps.tolist() == [512, 1024]
        for seed, row in enumerate(comparison[arm].curve.values):
            with np.load(runs / arm / str(seed) / "evaluations.npz") as file:
                assert file["results"].shape == (2, 3)
                np.testing.assert_allclose(row, file["results"].mean(axis=1))


def test_episodes_are_those_that_the_monitors_load(runs):
    found = read_runs(sorted(runs.rglob("*.monitor.csv")))
    assert len(found) == 2
    for run in found:
        steps, returns = ts2xy(load_results(str(runs / run.arm / str(run.seed))), "timesteps")
        assert run.steps.tolist() == steps.tolist()
        assert run.returns.tolist() == returns.tolist()
