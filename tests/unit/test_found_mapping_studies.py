"""A run that finds its mapping, run into again: the same is found, or it says what changed."""

from dataclasses import replace

import pytest

from curricle.study.arms import arms_from_json
from curricle.transfer import UNMAPPED, search as found_mappings
from tests.unit.test_resuming import again

pytestmark = pytest.mark.usefixtures("quick_disk")

STUDY = """
name = "mirror"
opponents = []
seeds = 2
eval_freq = 100
budget = 300
[tasks]
maze = { type = "maze", map = "S..F..T" }
mirrored = { type = "maze", map = "T..F..S" }
[[transfers]]
source = "mirrored"
target = "maze"
mapping = "auto"
"""


@pytest.fixture
def mirror(tmp_path, capsys):
    """A study that finds its mapping, which was run, and what was printed then."""
    (tmp_path / "own.toml").write_text(STUDY)
    again(tmp_path)
    return tmp_path, capsys.readouterr().out


def test_a_mapping_is_found_again_and_printed_once_a_run(mirror, capsys):
    folder, printed = mirror
    assert printed.count("mapping found for mirrored -> maze") == 1
    arms_from_json.cache_clear()
    trained, notes = again(folder)
    assert (trained, notes) == ([], [])
    assert capsys.readouterr().out == printed


@pytest.fixture
def other_search(monkeypatch):
    """Return a function after which the search leaves a state unmapped."""
    search = found_mappings.find_mappings

    def find(*tasks, **settings):
        candidates = search(*tasks, **settings)
        mapping = candidates[0].mapping
        index = mapping.index.copy()
        index[1] = UNMAPPED
        best = replace(candidates[0], mapping=replace(mapping, index=index))
        return replace(candidates, candidates=(best, *candidates[1:]))

    def change():
        monkeypatch.setattr(found_mappings, "find_mappings", find)
        found_mappings._memory.cache_clear()
        arms_from_json.cache_clear()

    yield change
    found_mappings._memory.cache_clear()


def test_a_search_that_finds_another_mapping_makes_units_stale(mirror, other_search):
    folder, _ = mirror
    other_search()
    trained, (notes,) = again(folder)
    why = "the mapping found for mirrored -> maze changed"
    assert notes == f"transfer: maze, seeds 0-1, is stale and trained again: {why}"
    assert trained == ["transfer: maze"]
