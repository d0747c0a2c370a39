"""A study run in parts on several machines and put together is the study run in one go."""

import re

import numpy as np
import pytest

from curricle.errors import StoreError
from curricle.study import StudyResults, merge, read_study, run_study
from curricle.study.results import DECISIONS, RESULTS

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture(scope="module")
def one_arm(study_file, tmp_path_factory):
    """The study with one arm beside scratch, and four units of seeds to share."""
    path = tmp_path_factory.mktemp("shards") / "chain.toml"
    text = study_file.read_text().partition("[arms.chain]")[0]
    path.write_text(text.replace("seeds_per_unit = 2", "seeds_per_unit = 1"))
    return path


@pytest.fixture(scope="module")
def finished(one_arm, tmp_path_factory):
    """The folder of that, run in one go."""
    folder = tmp_path_factory.mktemp("whole") / "chain"
    run_study(read_study(one_arm), folder, workers=2)
    return folder


@pytest.fixture
def part(one_arm, tmp_path):
    """A function: name, changes -> the folder of a part of the study."""

    def run(name, *changes, shard=(1, 1)):
        study = read_study(one_arm, set=changes)
        return run_study(study, tmp_path / name, shard=shard, workers=2).store.path

    return run


def assert_same_tables(folder, finished):
    for name in (RESULTS, DECISIONS):
        assert (folder / name).read_bytes() == (finished / name).read_bytes(), name


def test_all_shards_are_one_run(part, finished, tmp_path, capsys):
    parts = [part(f"part-{i}", shard=(i, 5)) for i in range(1, 6)]
    assert "shard 5/5 has no seeds: there are fewer groups" in capsys.readouterr().err
    seeds = [StudyResults(folder).seeds for folder in parts]
    assert sorted(seed for of_part in seeds for seed in of_part) == [0, 1, 2, 3]
    assert seeds[-1] == ()
    whole = merge(tmp_path / "whole", parts[::-1])
    assert whole.seeds == (0, 1, 2, 3)
    assert_same_tables(tmp_path / "whole", finished)


def test_parts_in_other_units_count_each_seed_once(part, finished, tmp_path, contents):
    parts = [
        part("a", 'seeds="0-2"', "seeds_per_unit=3"),
        part("b", 'seeds="1-3"', "seeds_per_unit=2"),
    ]
    before = [contents(one) for one in parts]
    whole = merge(tmp_path / "whole", parts)
    assert [contents(one) for one in parts] == before
    assert sum(len(unit.seeds) for unit in whole.store.units()) == 4 * 4
    assert whole.result("transfer", "maze").seeds == (0, 1, 2, 3)
    assert whole.result("transfer", "maze").snapshots.seed == 0
    assert whole.store.description["configuration"]["seeds_per_unit"] == 3  # as the first part
    assert_same_tables(tmp_path / "whole", finished)


def test_a_merged_study_can_be_run_on(part, one_arm, finished, tmp_path):
    merge(tmp_path / "whole", [part("a", shard=(2, 3))])
    run_study(read_study(one_arm), tmp_path / "whole", resume=True, workers=2)
    assert_same_tables(tmp_path / "whole", finished)


def test_parts_of_different_studies_are_refused(part, finished, tmp_path, contents):
    parts = [part("a", 'seeds="0-0"'), part("b", 'seeds="1-1"', "tasks.maze.budget=700")]
    with pytest.raises(StoreError, match=r"other settings.*budget is .*[67]00"):
        merge(tmp_path / "whole", parts)
    assert not (tmp_path / "whole").exists()
    there = contents(parts[0])
    with pytest.raises(StoreError, match=r"other settings.*budget is"):
        merge(parts[0], [parts[1]])
    assert contents(parts[0]) == there


def test_other_folders_are_refused(part, tmp_path, finished):
    with pytest.raises(StoreError, match="at least one folder"):
        merge(tmp_path / "whole", [])
    (tmp_path / "empty").mkdir()
    with pytest.raises(StoreError, match=re.escape(f"{tmp_path / 'empty'} has none")):
        merge(tmp_path / "whole", [part("a", 'seeds="0-0"'), tmp_path / "empty"])
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.txt").write_text("years of work")
    with pytest.raises(StoreError, match="other files"):
        merge(tmp_path / "thesis", [tmp_path / "a"])
    assert not (tmp_path / "whole").exists()
    for place in (str(finished), finished):
        with pytest.raises(StoreError, match="must be a list"):
            merge(tmp_path / "whole", place)


def snapshots_in(folder):
    files = folder.glob("units/*/*.npz")
    return sorted(
        path.relative_to(folder) for path in files if "snapshot_steps" in np.load(path).files
    )


def test_parts_merged_one_after_the_other_are_parts_merged_at_once(part, finished, tmp_path):
    parts = [part("early", 'seeds="0-1"'), part("late", 'seeds="2-3"')]
    once = merge(tmp_path / "once", parts)
    for folder in (*parts, parts[1]):  # the last is there already
        whole = merge(tmp_path / "whole", [folder])
    assert_same_tables(tmp_path / "whole", finished)
    assert len(snapshots_in(finished)) == 4
    assert whole.runs == once.runs
    assert len(once.runs) == 2
    merge(parts[0], parts)  # into one of the parts themselves
    assert_same_tables(parts[0], finished)
    assert snapshots_in(tmp_path / "whole") == snapshots_in(finished)
