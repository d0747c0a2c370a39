"""Every example runs, at reduced size."""

import importlib.util
from pathlib import Path

import pytest

import curricle as cr

FOLDER = Path(__file__).parents[2] / "examples"
PICTURES = {
    "first_curriculum": {"seeds": 2},
    "three_predators": {"seeds": 2, "size": 3, "steps": 1600, "source_steps": 10_000},
}
COMPARISONS = {
    name: {"steps": 1000, "source_steps": 300} for name in ("frozen_lake", "taxi", "cliff_walking")
}


def example(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", PICTURES)
def test_example_runs_and_draws(name, tmp_path):
    example(name).main(tmp_path / "picture.png", **PICTURES[name])
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_a_task_of_ones_own_runs(capsys):
    example("own_task").main(size=4, winds=3, steps=1000, seeds=2)
    assert "2 seeds" in capsys.readouterr().out


@pytest.mark.parametrize("name", COMPARISONS)
def test_example_runs_and_compares(name, capsys):
    example(name).main(seeds=2, **COMPARISONS[name])
    printed = capsys.readouterr().out
    assert "sources charged, evaluations free; 2 seeds" in printed
    assert "scratch" in printed


def test_a_gymnasium_class_of_ones_own_is_studied_from_its_file(tmp_path):
    file = FOLDER / "own_environment" / "courier.toml"
    study = cr.read_study(
        file, set=["seeds=2", "tasks.fetch.budget=3_000", "tasks.deliver.budget=500"]
    )
    found = cr.run_study(study, tmp_path / "results")
    assert sorted(task.view.words for task in found.record.tasks) == ["parcel 0", "parcel 1"]
    assert "Replay of training" in cr.show.write_report(tmp_path / "results").read_text("utf-8")


def test_a_sweep_and_a_tuning_run(tmp_path):
    small = ["seeds=2", "tasks.hunt.size=3", "tasks.chase.size=3", "tasks.hunt.budget=2_000"]
    changes = {
        "sweep": ["sweep.tasks.chase.budget=[300, 900]"],
        "tune": ["tune.trials=3", "tune.seeds=1", "tune.space.tasks.chase.budget.high=2_001"],
    }
    for name, own in changes.items():
        study = cr.read_study(FOLDER / f"{name}.toml", set=[*small, *own])
        results = cr.run_study(study, tmp_path / name)
        assert len(results.seeds) == 2
        assert "mean return" in str(results.comparison)
        kind = {"sweep": "sweep", "tune": "tuning"}[name]
        assert f'id="{kind}"' in cr.show.write_report(tmp_path / name).read_text("utf-8")


def test_no_example_is_left_out():
    known = {*PICTURES, *COMPARISONS, "own_task"}
    assert {path.stem for path in FOLDER.glob("*.py")} == known
