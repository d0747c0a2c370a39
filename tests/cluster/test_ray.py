"""Ray as an executor, as the docs write it, gives the results of threads; also if a worker dies."""

import re
from pathlib import Path

import psutil
import pytest

import curricle as cr
from tests.cluster.conftest import LONG, arrays_and_tables, units_in, whole

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "run_a_study.md"


def test_rays_recipe_gives_the_results_of_threads(study, tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    code = re.search(r"```python\n([^`]*class RayExecutor[^`]*)```", PAGE.read_text())[1]
    recipe = dict[str, object]()
    exec(code, recipe)
    file, out, killed = study(LONG), tmp_path / "ray", list[psutil.Process]()
    wanted = whole(file, tmp_path / "threads")

    def kill_one(_):
        if units_in(out) and not killed:
            killed.extend(training()[:1])
            for process in killed:
                process.kill()

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        pool = recipe["RayExecutor"]()
        cr.run_study(file, out, executor=pool, workers=2, progress=kill_one)
    finally:
        ray.shutdown()
    assert killed
    assert arrays_and_tables(out) == wanted


def training():
    """The processes of Ray that train a unit now."""
    children = psutil.Process().children(recursive=True)
    return [child for child in children if child.cmdline()[:1] == ["ray::train_sent"]]
