"""The studies of networks under benchmarks: DoorKey rooms by their errands, and what files say."""

from pathlib import Path

import pytest

import curricle as cr
from curricle.study.arms import Arms

pytest.importorskip("minigrid", reason="the extra minigrid is not installed")

from benchmarks.networks.miniatures import ALL, study_of

FOLDER = Path(__file__).parents[2] / "benchmarks" / "networks"


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.toml")), ids=lambda file: file.stem)
def test_the_studies_of_networks_have_arms_that_are_compared_if_the_file_says_so(file):
    study = cr.read_study(file)
    pytest.importorskip("stable_baselines3", reason="the extra deep is not installed")
    assert bool(Arms.of(study).total) == study.compared


@pytest.mark.parametrize("target", ALL)
def test_the_study_of_miniatures_has_changes_for_every_target(target):
    study = study_of(target, seeds=2)
    assert study.arms["distilled"].tasks["target"].id in ALL[target][0]
