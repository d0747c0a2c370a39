"""A study at an S3 server has the results that one in a folder has, also where requests fail."""

import pytest
from pyarrow import fs

from tests.cluster.conftest import arrays_and_tables, begun, finished, whole

ROWS = ["....T" + 115 * ".", *(118 * [120 * "."]), "S" + 119 * "."]
"""Of a maze whose tables a worker writes itself."""


def copied(url, folder):
    """The tables and arrays at a URL."""
    system, path = fs.FileSystem.from_uri(url)
    folder.mkdir()
    fs.copy_files(path, str(folder), source_filesystem=system)
    return arrays_and_tables(folder)


@pytest.mark.parametrize("large", [False, True], ids=["small units", "large units"])
@pytest.mark.parametrize("engine", ["dask", "ray_nodes"])
def test_workers_at_a_server_that_fails(
    study, s3_server, s3_proxy, request, tmp_path, engine, large
):
    file, url = study(), s3_proxy("--every", "50") + "/study"
    on = request.getfixturevalue(engine).on  # its processes take the environment that they find
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
    assert "ACCESS_DENIED" in last
    assert "Traceback" not in printed
