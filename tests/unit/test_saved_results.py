"""Files of results: whole or refused, plain, and of the task that they are loaded with."""

import io
import os
import pickle
import sys
import zipfile
from functools import partial

import numpy as np
import pytest

import curricle as cr
from curricle.curriculum import CurriculumResult
from curricle.curriculum.result import to_file
from curricle.errors import CurriculumError, SettingError, StoreError
from curricle.files import write_saved
from curricle.learning import LearningResult, TabularPolicy
from tests.support.comparisons import CORNER, MAZE, corner

plan = partial(corner, source=400, target=600)


@pytest.fixture(scope="module")
def learnt():
    return cr.learn(MAZE, budget=600, seeds=[5, 2], snapshots=3)


@pytest.fixture(scope="module")
def trained():
    return plan().train(seeds=2)


def test_folders_are_made_and_the_ending_is_added(tmp_path, learnt):
    file = learnt.save(tmp_path / "new" / "maze.v2")
    assert file == tmp_path / "new" / "maze.v2.npz"
    assert LearningResult.load(tmp_path / "new" / "maze.v2").seeds == (5, 2)
    assert LearningResult.load(file).seeds == (5, 2)


def test_what_is_loaded_goes_on_as_the_original(tmp_path, learnt):
    again = LearningResult.load(learnt.save(tmp_path / "maze"), MAZE)
    assert str(again) == str(learnt)
    assert again.learner == learnt.learner
    assert repr(again.watch(seed=3)) == repr(learnt.watch(seed=3))
    first, other = (plan().train(seeds=[5, 2], trained={"maze": r}) for r in (learnt, again))
    assert np.array_equal(first.sources["maze"].values, other.sources["maze"].values)


def test_without_its_task_a_result_has_curves_and_choices(tmp_path, learnt):
    again = LearningResult.load(learnt.save(tmp_path / "maze"))
    assert again.policy.predict(3) == learnt.policy.predict(3)
    with pytest.raises(SettingError, match=r"an episode needs the task .* load\(path, task\)"):
        again.watch()


class Mine(cr.QLearning):
    """A learner that no file may name."""


def test_a_learner_of_ones_own_is_not_made_of_a_file(tmp_path):
    result = cr.learn(MAZE, Mine(), 100)
    assert LearningResult.load(result.save(tmp_path / "mine"), MAZE).learner is None


def test_a_full_disk_leaves_what_was_there(tmp_path, learnt, monkeypatch):
    file = learnt.save(tmp_path / "maze")
    before = file.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"cannot be written to .*maze.npz: No space left"):
        cr.learn(MAZE, budget=100).save(tmp_path / "maze")
    assert file.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["maze.npz"]


def test_what_is_no_path_on_this_machine_is_refused(tmp_path, learnt, trained, monkeypatch):
    monkeypatch.chdir(tmp_path)
    uses = [saved.save for saved in (learnt, trained, learnt.policy, learnt.watch(seed=0))]
    uses += [LearningResult.load, lambda path: CurriculumResult.load(path, plan())]
    for use in uses:
        for path in (3, None, "", "/"):
            with pytest.raises(StoreError, match=f"^a file .*: got {path!r}$"):
                use(path)
        with pytest.raises(StoreError, match=r"not at a URL: got 's3://b/maze"):
            use("s3://b/maze")
    assert not [*tmp_path.iterdir()]


class Harm:
    def __reduce__(self):
        return os.mkdir, ("harmed",)


def pickled(path):
    buffer = io.BytesIO()
    np.save(buffer, np.array([Harm()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("values.npy", buffer.getvalue())


def forged(path, pairs=None):
    """A file with right checksums whose values have fewer states than its task, or than it says."""
    arrays, about = cr.learn(MAZE, budget=100).parts_of_file()
    about["task"] |= {} if pairs is None else {"pairs": pairs}
    write_saved(path, "LearningResult", {**arrays, "values": arrays["values"][:, :3]}, about)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda path: None, "cannot be read from .*No such file"),
        (lambda path: path.mkdir(), "cannot be read from"),
        (lambda path: path.write_bytes(b""), "was changed since, cut off, or written by something"),
        (lambda path: np.savez(path, values=np.ones(3)), "was changed since"),
        (lambda path: path.write_bytes(pickle.dumps(Harm())), "was changed since"),
        (pickled, "was changed since"),
        (forged, r"values must be a table for each seed \(1\), 15 states x 4 actions"),
        (lambda path: forged(path, [3, 4]), r"must be a table for each seed .* 15 states x 4"),
        (lambda path: write_saved(path, "LearningResult", {}, {"format": 9}), "have format 1"),
        (lambda path: cr.learn(MAZE, budget=50).policy.save(path), "holds a TabularPolicy"),
        (lambda path: plan().train().save(path), "holds a CurriculumResult"),
        (lambda path: write_saved(path, "LearningResult", {}, {}), "is not as .*: it has no seeds"),
    ],
)
def test_a_damaged_or_foreign_file_is_one_sentence(tmp_path, monkeypatch, wrong, message):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "r.npz"
    wrong(path)
    with pytest.raises(StoreError, match=message) as refusal:
        LearningResult.load(path, MAZE)
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "harmed").exists()


def test_another_task_is_refused(tmp_path, learnt):
    for file, load in (
        (learnt.save(tmp_path / "r"), LearningResult.load),
        (learnt.policy.save(tmp_path / "p"), TabularPolicy.load),
    ):
        with pytest.raises(SettingError, match=r"own task: .* states Space\(15 .* Space\(6 "):
            load(file, CORNER)


def same(result, other):
    """Assert that two results of curricula are equal in all that they say."""
    assert [*result.nodes] == [*other.nodes]
    for name in result.nodes:
        assert np.array_equal(result[name].values, other[name].values)
        assert result[name].learner == other[name].learner
        assert np.array_equal(result.source_steps(name), other.source_steps(name))
        assert str(result.decisions(name)) == str(other.decisions(name))
    assert [*result.potentials] == [*other.potentials]
    for name, by_seed in result.potentials.items():
        for first, second in zip(by_seed, other.potentials[name], strict=True):
            assert np.array_equal(first.values, second.values)
    assert [*result.given] == [*other.given]


def test_a_curriculum_is_loaded_as_it_was(tmp_path):
    curriculum = plan()
    result = curriculum.train(seeds=3)
    file = result.save(tmp_path / "one")
    again = CurriculumResult.load(file, curriculum)
    same(result, again)
    assert again.save(tmp_path / "two").read_bytes() == file.read_bytes()
    assert curriculum.train(seeds=3).save(tmp_path / "three").read_bytes() == file.read_bytes()
    assert again.policy.predict(0) == result.policy.predict(0)


def test_sources_that_were_given_are_kept(tmp_path, trained):
    values = cr.curriculum.SourceValues.of(trained["corner"])
    result = plan().train(seeds=2, trained={"corner": values})
    again = CurriculumResult.load(result.save(tmp_path / "one"), plan())
    same(result, again)
    assert [*again.nodes] == ["maze"]
    assert np.array_equal(again.given["corner"].values, values.values)


def test_another_curriculum_is_refused(tmp_path, trained):
    file = trained.save(tmp_path / "one")
    alone = cr.Curriculum({"maze": MAZE}, budget=100)
    with pytest.raises(CurriculumError, match=r"has the tasks corner, maze, the curriculum maze$"):
        CurriculumResult.load(file, alone)
    small = cr.Curriculum({"corner": CORNER, "maze": CORNER}, [
        cr.Transfer("corner", "maze", cr.same_position(CORNER, CORNER))])  # fmt: skip
    with pytest.raises(SettingError, match=r"own task: .* has states Space\(15"):
        CurriculumResult.load(file, small)
    with pytest.raises(CurriculumError, match=r"the Curriculum that was trained: got GridWorld"):
        CurriculumResult.load(file, MAZE)
    for missing in ("nodes", "tasks", "trained"):
        arrays, about = to_file(trained)
        del about[missing]
        file = write_saved(tmp_path / "one", "CurriculumResult", arrays, about)
        with pytest.raises(StoreError, match="is not as save") as refusal:
            CurriculumResult.load(file, plan())
        assert "\n" not in str(refusal.value)


def test_a_frame_has_a_row_for_each_checkpoint_up_to_a_seeds_end(learnt):
    pytest.importorskip("pandas")
    frame = learnt.frame()
    assert [*frame.columns] == [
        *("seed", "checkpoint", "steps"),
        *("training_return", "greedy_return", "source_share", "agreement", "episodes"),
    ]
    assert len(frame) == 2 * len(learnt.steps)
    last = frame.groupby("seed").last()
    assert last.loc[5, "greedy_return"] == learnt.greedy_return[0, -1]
    assert last.loc[2, "steps"] == learnt.steps_used[1]
    assert set(frame.attrs["units"]) == {*frame.columns} - {"seed", "checkpoint"}


def test_a_frame_of_a_curriculum_has_its_tasks_and_what_came_before(trained, monkeypatch):
    pytest.importorskip("pandas")
    frame = trained.frame()
    assert frame["task"].unique().tolist() == ["corner", "maze"]
    spent = frame.loc[frame["task"] == "maze", "source_steps"].unique().tolist()
    assert spent == sorted({*trained.source_steps("maze").tolist()})
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"^a DataFrame needs pandas: pip install pandas$"):
        trained.frame()
