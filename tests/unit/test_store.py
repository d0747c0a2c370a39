"""The results store: whole files or none, results of one description, nothing of others touched."""

import pytest

from curricle.errors import StoreError
from curricle.files import sealed
from curricle.study import StudyStore
from curricle.study.store import SCHEMA_VERSION

SETTINGS = {"seeds": 30, "version": "1"}


def opened(path, settings=SETTINGS):
    with StudyStore.opened(path, settings, resume=True) as store:
        return store


def test_reopening_with_the_same_settings_keeps_everything(tmp_path):
    opened(tmp_path / "a").write_json("x.json", [1, 2])
    again = opened(tmp_path / "a")
    assert again.has("x.json")
    assert again.read_json("x.json") == [1, 2]
    assert again.description == SETTINGS


@pytest.mark.parametrize("other", [{"seeds": 5, "version": "1"}, {"seeds": 30}, {}])
def test_other_settings_are_refused(tmp_path, other):
    opened(tmp_path)
    with pytest.raises(StoreError, match="holds results of other settings"):
        opened(tmp_path, other)


@pytest.mark.parametrize("version", [None, 0, SCHEMA_VERSION + 1])
def test_another_schema_version_is_refused_with_what_to_do(tmp_path, version):
    study = SETTINGS if version is None else {"schema_version": version, **SETTINGS}
    (tmp_path / "study.json").write_bytes(sealed(study))
    before = (tmp_path / "study.json").read_bytes()
    found = "no schema version" if version is None else f"schema version {version}"
    for read in (opened, StudyStore):
        with pytest.raises(StoreError) as caught:
            read(tmp_path)
        assert str(caught.value) == (
            f"{tmp_path / 'study.json'} has {found} and this Curricle reads {SCHEMA_VERSION}: run "
            "the study again into a new folder, or read it with the version that wrote it"
        )
    assert (tmp_path / "study.json").read_bytes() == before


def test_a_damaged_file_is_named(tmp_path):
    store = opened(tmp_path)
    store.write("claims.json", b"{")
    with pytest.raises(StoreError, match=r"claims\.json is not as .* it must be JSON"):
        store.read_json("claims.json")
