"""Studies, and paths of their files, where curricula are taken."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import ConfigError, CurriculumError, SettingError, StoreError
from curricle.study import StudyConfig, StudyResults
from tests.support.studies import CORNER

STUDY = CORNER.replace("\n", "\nseeds = [3, 5]\nbudget = 600\nthreshold = 5\nwindow = 2\n", 1)
PLAN = "[arms.plain]\n[arms.halved]\ntransfers.0.scale = 0.5\n"


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "corners.toml").write_text(STUDY, "utf-8")
    return tmp_path / "corners.toml"


def test_a_study_runs_from_its_path_into_the_folder_of_the_command_line(file):
    results = cr.run_study("corners.toml")
    assert (file.parent / "corners-results" / "study.json").exists()
    again = cr.run_study(file, resume=True)
    np.testing.assert_array_equal(
        results.results["transfer"]["maze"].values, again.results["transfer"]["maze"].values
    )
    cr.run_study(cr.read_study(file), "elsewhere")
    assert StudyResults("elsewhere").seeds == (3, 5)


def test_a_study_without_a_file_is_called_by_its_name(tmp_path):
    data = {"name": "line", "arms": {"only": {"tasks": {"a": {"type": "maze", "map": "S.T"}}}}}
    assert StudyConfig.from_data(data, tmp_path).results_folder == "line-results"


def test_a_study_is_compared_from_its_path_with_its_own_settings(file):
    study = cr.read_study(file)
    expected = cr.compare(study.curricula, seeds=[3, 5], threshold=5, window=2, opponents=())
    for argument in ("corners.toml", file, study):
        comparison = cr.compare(argument)
        assert (comparison.seeds, comparison.threshold, comparison.window) == (2, 5, 2)
        assert str(comparison) == str(expected)
    assert cr.compare(arms=file, seeds=[7], window=1).seeds == 1


def test_learners_from_scratch_are_compared_too(file):
    file.write_text(STUDY + "[scratch_learners.bold]\ninitial_value = 9.0\n", "utf-8")
    assert "scratch, bold" in cr.compare(file).arms


def test_a_study_of_one_arm_is_forecast_from_its_path(file):
    foreseen = cr.forecast("corners.toml", trial=False)
    assert foreseen.trained["corner"].seeds == (3, 5)
    assert cr.forecast(file, trial=False, seeds=[1]).trained["corner"].seeds == (1,)
    file.write_text(STUDY + PLAN, "utf-8")
    with pytest.raises(ConfigError, match=r"a forecast is of one arm: .* ARM one of plain, halved"):
        cr.forecast("corners.toml")


def test_what_is_no_study_is_refused_in_a_sentence(file, tmp_path_factory):
    stored = tmp_path_factory.mktemp("other") / "results"
    cr.run_study(file, stored)
    for function in (cr.run_study, cr.compare, cr.forecast):
        with pytest.raises(ConfigError, match=r"nowhere.toml cannot be read: No such file"):
            function("nowhere.toml")
        with pytest.raises(ConfigError, match=r"is a folder of results, which StudyResults\(FOLD"):
            function(stored)
    with pytest.raises(
        SettingError, match="study must be a StudyConfig or the path of a file: got"
    ):
        cr.run_study(cr.GridWorld("S.T"))
    with pytest.raises(CurriculumError, match="must be a Mapping: got 5"):
        cr.compare(5)
    with pytest.raises(CurriculumError, match="must be a Curriculum: got 5"):
        cr.forecast(5)
    with pytest.raises(StoreError, match="a folder must be a path or a URL: got 5"):
        cr.run_study(file, 5)
    assert [path.name for path in file.parent.iterdir()] == ["corners.toml"]
