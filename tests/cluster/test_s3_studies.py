"""A study at an S3 server has the results that one in a folder has, also where requests fail."""

import subprocess
import sys

import pytest

from curricle.files import place_at
from tests.cluster.conftest import arrays_and_tables, begun, finished, whole

ROWS = ["....T" + 115 * ".", *(118 * [120 * "."]), "S" + 119 * "."]
"""Of a maze whose tables a worker writes itself."""


def copied(url, folder):
    """The tables and arrays at a URL."""
    place = place_at(url)
    place.fs.get(place.path, str(folder), recursive=True)
    return arrays_and_tables(folder)


@pytest.mark.parametrize("large", [False, True], ids=["small units", "large units"])
def test_workers_at_a_server_that_fails(study, s3_server, s3_proxy, request, tmp_path, large):
    file, url = study(), s3_proxy("--every", "50") + "/study"
    on = request.getfixturevalue("dask").on  # its processes take the environment that they find
    if large:
        (file.parent / "maps.py").write_text(f"ROWS = {ROWS!r}\n")
    settings = ("--set", "seeds=10", "--set", "seeds_per_unit=5") if large else ()
    wanted = whole(file, tmp_path / "threads", *settings)
    before = len(s3_server.refused())
    finished(file, url, "--on", on, *settings)
    assert len(s3_server.refused()) > before
    assert copied(url, tmp_path / "copied") == wanted
    assert finished(file, url, "--resume", *settings)[1] == 0


def test_a_bucket_that_can_only_be_read_is_one_sentence(study, s3_proxy):
    url = s3_proxy("--read-only") + "/study"
    running = begun(study(), url)
    printed, _ = running.communicate(timeout=120)
    assert running.returncode == 1
    last = printed.strip().splitlines()[-1]
    assert last.startswith(f"curricle: results cannot be written to {url} (")
    assert "Access Denied" in last
    assert "Traceback" not in printed


def test_a_bucket_that_is_not_there_is_named_and_not_made(study, s3):
    for command in (["show", "s3://nobody"], ["run", str(study()), "--out", "s3://nobody/study"]):
        ran = subprocess.run(
            [sys.executable, "-m", "curricle", *command], capture_output=True, text=True
        )
        assert ran.returncode == 1
        assert "Traceback" not in ran.stderr
        assert "nobody" in ran.stderr.splitlines()[-1]
    assert not place_at("s3://nobody").exists()
