"""A study at an S3 server has the results that one in a folder has."""

import subprocess
import sys

from curricle.files import place_at
from tests.cluster.conftest import arrays_and_tables, finished, whole

ROWS = ["....T" + 115 * ".", *(118 * [120 * "."]), "S" + 119 * "."]
"""Of a maze whose tables a worker writes itself."""


def test_workers_write_to_a_bucket(study, s3, request, tmp_path):
    file, place = study(), place_at(f"{s3}/study")
    on = request.getfixturevalue("dask").on  # its processes take the environment that they find
    (file.parent / "maps.py").write_text(f"ROWS = {ROWS!r}\n")
    settings = ("--set", "seeds=10", "--set", "seeds_per_unit=5")
    wanted = whole(file, tmp_path / "threads", *settings)
    printed, code = finished(file, place, "--on", on, *settings)
    assert code == 0, printed
    place.fs.get(place.path, str(tmp_path / "copied"), recursive=True)
    assert arrays_and_tables(tmp_path / "copied") == wanted
    assert finished(file, place, "--resume", *settings)[1] == 0


def test_a_bucket_that_is_not_there_is_named_and_not_made(study, s3):
    for command in (["show", "s3://nobody"], ["run", str(study()), "--out", "s3://nobody/study"]):
        ran = subprocess.run(
            [sys.executable, "-m", "curricle", *command], capture_output=True, text=True
        )
        assert ran.returncode == 1
        assert "Traceback" not in ran.stderr
        assert "nobody" in ran.stderr.splitlines()[-1]
    assert not place_at("s3://nobody").exists()
