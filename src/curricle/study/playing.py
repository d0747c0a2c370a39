"""One episode of what a study learnt: as its folder stores it, or played in the task itself."""

import numpy as np

from curricle.checks import one_of
from curricle.errors import StoreError
from curricle.planning.episode import OF_TASKS, Drawn, Episode
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.record import EpisodeRecord
from curricle.study.results import StudyResults
from curricle.tasks.grid_view import GridView
from curricle.tasks.scene import ViewScene

IN_THE_TASK = "--study FILE, the study's own file, plays one in the task itself"


def stored_episode(
    results: StudyResults, arm: str, task: str, seed: int | None = None
) -> tuple[int, Episode]:
    """Return the last greedy episode of a task that a folder stores, and the seed that learnt it.

    No task is made and no module of the study imported. Of the rewards the folder keeps what they
    add up to, of the actions nothing.

    Parameters
    ----------
    results : StudyResults
    arm, task : str
    seed : int, optional
        The one that must have learnt it.

    Raises
    ------
    StoreError
        When the folder has no such arm or task, or no such episode: those of tasks with a grid and
        snapshots are stored, of the first seed, when a run that compares arms has ended.
    """
    _check_names(results, arm, task)
    analysis, about = results.analysis, results.record.task(arm, task)
    pair = None if analysis is None else analysis.episodes.get(arm, {}).get(task)
    if pair is None or about.view is None:
        raise StoreError(
            f"{results.store.path} stores no episode of {task!r} in arm {arm!r}: it stores those "
            "of tasks with a grid and snapshots, when the run of all arms has ended; "
            f"{IN_THE_TASK}"
        )
    snapshots = results.result(arm, task).snapshots
    first = results.record.seeds[0] if snapshots is None else snapshots.seed
    if seed not in (None, first):
        raise StoreError(
            f"{results.store.path} stores an episode of seed {first} alone: got seed {seed}; "
            f"{IN_THE_TASK}"
        )
    view, record = about.view.view, pair.after
    if record.cells.shape[1] != len(view.markers) or record.cells.max() >= np.prod(view.shape):
        raise StoreError(f"{results.store.path} stores an episode of {task!r} that is off its grid")
    return first, episode_of(view, record)


def episode_of(view: GridView, record: EpisodeRecord) -> Episode:
    """Return a stored episode, drawn on the view of its task."""
    scene, moments = ViewScene(view), np.arange(len(record.cells))
    return Episode(
        frames=Drawn(lambda moment: scene.image(record.cells[moment]), moments),
        actions=np.zeros(0, np.int64),
        rewards=np.diff(record.returns),
        terminated=record.terminated,
        fps=OF_TASKS,
        texts=Drawn(lambda moment: scene.text(record.cells[moment]), moments),
    )


def played_episode(
    results: StudyResults, study: StudyConfig, arm: str, task: str, seed: int | None = None
) -> tuple[int, Episode]:
    """Return an episode of a learnt policy in the task itself, and the seed that learnt it.

    Parameters
    ----------
    results : StudyResults
    study : StudyConfig
        The file that was run; its tasks are made.
    arm, task : str
    seed : int, optional
        By default the first of those that have the best last greedy return.

    Raises
    ------
    StoreError
        When the folder holds no such result, or the results of other settings.
    SettingError
        When the values were not saved, or the task has no time limit.
    """
    _check_names(results, arm, task)
    learnt = results.result(arm, task)
    arms = Arms.of(study)
    if arms.keys.get((arm, task)) != results.record.keys[arm, task]:
        raise StoreError(
            f"an episode is played by the study that was run: {results.store.path} holds {task!r} "
            f"of arm {arm!r} as trained with other settings, or by another version of Curricle"
        )
    if seed is None:
        last = learnt.greedy_return[:, -1]
        seed = learnt.seeds[0 if np.isnan(last).all() else int(np.nanargmax(last))]
    curriculum = arms.curricula[arm]
    (policy,) = results.policies(arm, curriculum, [seed], task=task)
    return seed, policy.episode()


def _check_names(results: StudyResults, arm: str, task: str) -> None:
    """Raise StoreError unless the study has the arm, and it the task."""
    one_of("an arm", arm, results.record.arms, StoreError)
    one_of(f"a task of arm {arm!r}", task, results.record.arms[arm].nodes, StoreError)
