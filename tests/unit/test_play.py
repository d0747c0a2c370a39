"""``curricle play``: the episode that a folder stores, or one played in the task itself."""

import re
from functools import partial

import numpy as np
import pytest
from PIL import Image

from curricle.errors import StoreError
from curricle.learning import TabularPolicy
from curricle.pictures.scenes import scene_of
from curricle.planning.greedy import Values
from curricle.planning.rollouts import greedy_rollout
from curricle.study import StudyResults, read_study, run_study
from curricle.study.analysis import played_episode, stored_episode
from tests.support.sent_folders import change

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture
def play(curricle):
    """``curricle play``: arguments -> the exit code, and what is printed and complained of."""
    return partial(curricle, "play")


def test_a_stored_episode_is_printed(play, finished):
    code, out, complaint = play(finished, "--arm", "chain")
    assert (code, complaint) == (0, "")
    assert out.startswith("chain: maze, learnt by seed 0\n\nstart ")
    assert "@...P" in out
    assert out.rstrip().endswith("terminated")
    _, corner, _ = play(finished, "--arm", "chain", "--task", "corner")
    assert corner.startswith("chain: corner, learnt by seed 0\n")


def test_a_stored_episode_is_a_gif(play, finished, tmp_path):
    code, out, _ = play(finished, "--arm", "chain", "--out", "new/maze.gif")
    line = r"chain: maze, learnt by seed 0: Episode\((\d+) steps, .*\)\nOpen new/maze.gif\n"
    steps = int(re.fullmatch(line, out)[1])
    assert code == 0
    with Image.open(tmp_path / "new" / "maze.gif") as picture:
        assert picture.n_frames == steps + 1


def test_the_only_curriculum_needs_no_name(play, monkeypatch, finished):
    begun = StudyResults.__init__

    def opened(results, *arguments):
        begun(results, *arguments)
        arms = {name: results.record.arms[name] for name in ("scratch", "chain")}
        results.record = results.record.model_copy(update={"arms": arms})

    monkeypatch.setattr(StudyResults, "__init__", opened)
    _, out, _ = play(finished)
    assert out.startswith("chain: maze, learnt by seed 0\n")


def test_the_stored_episode_is_that_of_the_last_snapshot(finished, study_file):
    results = StudyResults(finished)
    seed, episode = stored_episode(results, "chain", "maze")
    maze = read_study(study_file).curriculum("chain").tasks["maze"]
    last = results.result("chain", "maze").snapshots.values[-1]
    path = greedy_rollout(maze, Values(last.astype(float)), seed=0, steps=len(episode.rewards))
    assert seed == 0
    assert (episode.rewards == path.rewards).all()
    shown = results.analysis.episodes["chain"]["maze"].after.returns[-1]
    assert shown == pytest.approx(path.discounted_return(maze.discount))  # as evaluations are
    assert episode.terminated == path.terminated
    drawn = scene_of(maze)
    for place, state in enumerate(path.states):
        there = episode.texts[place]
        assert there.index("@") == drawn.text(state).index("@")
        assert episode.frames[place].shape == drawn.image(state).shape


def test_with_its_study_any_seed_plays_in_the_task(play, finished, study_file):
    code, out, complaint = play(
        finished, "--arm", "state", "--seed", 3, "--study", study_file, "--task", "easy"
    )
    assert (code, complaint) == (0, "")
    assert out.startswith("state: easy, learnt by seed 3\n")
    assert re.search(r"1 (north|south|east|west), -1", out)
    results, study = StudyResults(finished), read_study(study_file)
    seed, episode = played_episode(results, study, "state", "easy", 3)
    values = results.result("state", "easy", values=True).values[3]
    task = study.curriculum("state").tasks["easy"]
    assert seed == 3
    assert episode.actions.tolist() == TabularPolicy(task, values).episode().actions.tolist()


def test_without_a_seed_the_best_plays(finished, study_file):
    results = StudyResults(finished)
    seed, _ = played_episode(results, read_study(study_file), "scratch", "maze")
    last = results.result("scratch", "maze").greedy_return[:, -1]
    assert seed == int(last.argmax())


def test_the_policies_of_tables_are_read_from_a_folder(finished, study_file):
    results, curriculum = StudyResults(finished), read_study(study_file).curriculum("chain")
    values = results.result("chain", "maze", values=True).values
    policies = results.policies("chain", curriculum)
    assert len(policies) == 4
    for policy, table in zip(policies, values, strict=True):
        assert np.array_equal(policy.values, table)
    (single,) = results.policies("chain", curriculum, [2], task="corner")
    corner = results.result("chain", "corner", values=True).values
    assert np.array_equal(single.values, corner[2])
    with pytest.raises(StoreError, match="no result of 'maze' in arm 'chain' for seed 9 yet"):
        results.policies("chain", curriculum, [9])


NO_EPISODE = """
name = "hall"
opponents = []
seeds = 1
budget = 300
snapshots = 0
scratch = false
[tasks.hall]
type = "maze"
map = "S..T"
time_limit = 20
"""


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "--arm must be one of chain, state, scaled: got none"),
        (["--set", "tasks.maze.budget=5", "--arm", "chain"], 2, "--set needs --study"),
        (["--arm", "chain", "--task", "no"], 1, "of arm 'chain' must be one of .*: got 'no'"),
        (["--arm", "chain", "--seed", "2"], 1, "an episode of seed 0 alone: got seed 2; --study"),
        (["--arm", "chain", "--out", "maze.mp4"], 1, "must end in .gif: got 'maze.mp4'"),
    ],
)
def test_a_mistake_is_one_sentence(play, finished, tmp_path, arguments, code, message):
    status, out, complaint = play(finished, *arguments)
    assert status == code, complaint
    plain = " ".join(re.sub("[│╭╮╰╯─]", " ", complaint).split())
    assert re.search(message, plain)
    assert "Traceback" not in complaint
    assert not out
    assert not list(tmp_path.glob("*.mp4"))


def test_a_study_with_other_settings_is_refused(finished, study_file):
    other = read_study(study_file, set=["tasks.maze.budget=650"])
    with pytest.raises(StoreError, match="as trained with other settings"):
        played_episode(StudyResults(finished), other, "chain", "maze")


def test_where_nothing_is_stored_it_says_how_to_play(read, tmp_path):
    study = read(NO_EPISODE)
    results = run_study(study, tmp_path / "out", workers=1)
    (arm,) = results.record.arms
    with pytest.raises(StoreError, match=r"stores no episode of 'hall' in arm .*; --study FILE"):
        stored_episode(results, arm, "hall")
    assert played_episode(results, study, arm, "hall")[1].terminated


def test_an_episode_off_its_grid_is_refused(copied):
    def far(analysis):
        episode = analysis["episodes"]["chain"]["maze"]["after"]
        episode["cells"] = [[2000] for _ in episode["cells"]]

    change(copied / "analysis.json", far)
    with pytest.raises(StoreError, match="that leaves its grid"):
        stored_episode(StudyResults(copied), "chain", "maze")
