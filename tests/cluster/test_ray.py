"""Two nodes of Ray give the results of threads, whatever dies meanwhile."""

import pytest

from tests.cluster.conftest import LONG, arrays_and_tables, begun, units_in, wait_until, whole


@pytest.fixture(params=["client", "member"])
def on(request, ray_nodes, monkeypatch):
    """The word for two nodes: through Ray's client, or for a process that is one of theirs."""
    if request.param == "client":
        return ray_nodes.on
    monkeypatch.setenv("RAY_ADDRESS", ray_nodes.address)
    return "ray"


def test_whatever_dies_or_joins_changes_nothing(study, ray_nodes, on, tmp_path):
    wanted, out = whole(study(3 * LONG), tmp_path / "threads"), tmp_path / "ray"
    running = begun(study(3 * LONG), out, "--on", on)
    wait_until(lambda: units_in(out))
    wait_until(ray_nodes.training)
    ray_nodes.training()[0].kill()
    wait_until(lambda: len(units_in(out)) >= 4)
    ray_nodes.kill(ray_nodes.nodes[1])
    ray_nodes.add_node()
    assert running.poll() is None
    printed, _ = running.communicate(timeout=240)
    assert running.returncode == 0, printed
    assert arrays_and_tables(out) == wanted


def test_a_lost_head_is_one_sentence_and_resume_goes_on(study, ray_nodes, on, tmp_path):
    wanted, out = whole(study(3 * LONG), tmp_path / "threads"), tmp_path / "ray"
    running = begun(study(3 * LONG), out, "--on", on)
    wait_until(lambda: len(units_in(out)) >= 2)
    ray_nodes.kill(ray_nodes.head)
    printed, _ = running.communicate(timeout=120)
    assert running.returncode == 3, printed
    assert printed.count(" was lost") == 1
    assert "Traceback" not in printed
    assert whole(study(3 * LONG), out, "--resume") == wanted
