"""What only tasks can say of results: forecasts, certificates, episodes, and playing a policy."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import blake2b
from typing import Any

import numpy as np

from curricle.certificate.certification import certify
from curricle.certificate.verdict import Certificate, SampledCertificate
from curricle.checks import one_of
from curricle.comparison.controls import entering
from curricle.comparison.forecasting import Forecast, forecast
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import CurriculumResult
from curricle.errors import CurricleError, StoreError
from curricle.frozen_arrays import frozen
from curricle.learning.potential_rollouts import PairPotential
from curricle.learning.record import Snapshots
from curricle.planning.episode import OF_TASKS, Drawn, Episode
from curricle.planning.greedy import Values
from curricle.planning.rollouts import greedy_rollout
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.record import (
    LONGEST_EPISODE,
    Analysis,
    CertificateRecord,
    CurriculaRecord,
    EpisodePair,
    EpisodeRecord,
    ForecastRecord,
    RowRecord,
    SectionRecord,
)
from curricle.study.results import ANALYSIS, StudyResults
from curricle.tasks.grid_view import GridView
from curricle.tasks.live import is_live
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.scene import ViewScene
from curricle.tasks.task import Task, generative_model, has_tables

# -- What only the tasks themselves can say of results: forecasts, certificates, episodes ----------
#
# It is found when a study's run ends, and stored in plain data.

EFFORT = 800_000
"""Target pairs times forecasts times seeds at most: about ten seconds."""
MOST_SEEDS = 3
"""Seeds of a forecast."""
LARGEST_CERTIFIED = 20_000_000
"""Target pairs up to which a potential is certified."""


DIGEST_BYTES = 8
LARGEST_TABLE = 20_000_000
"""Pairs (S x A) of a task up to which its episodes are kept."""


def analyse(study: StudyResults, arms: Arms) -> None:
    """Write the analysis of a study whose arms are compared, unless it is there.

    It is of the first seeds that every arm has finished.
    """
    curricula = {
        arm: one
        for arm, one in arms.curricula.items()
        if not (arm in study.failed or arms.arms[arm].control)
    }
    if not study.seeds or arms.total is None or SCRATCH not in curricula:
        return
    seeds = study.seeds[:MOST_SEEDS]
    keys = sorted(one for one in study.record.keys.items() if one[0][0] in curricula)
    of = blake2b(repr((keys, seeds)).encode(), digest_size=DIGEST_BYTES).hexdigest()
    there = study.analysis
    if there is not None and there.of == of:
        return
    results = {}
    for arm, curriculum in curricula.items():
        nodes = {
            name: replace(study.result(arm, name, seeds=seeds), task=curriculum.tasks[name])
            for name in curriculum.order
        }
        given = study.trained(arm, curriculum, seeds)
        results[arm] = CurriculumResult(curriculum, nodes, {}, given=given)
    study.store.write_record(ANALYSIS, analysed(results, study.record.only(curricula), of))


def analysed(
    results: Mapping[str, CurriculumResult], record: CurriculaRecord, of: str = ""
) -> Analysis:
    """Return the analysis of curricula that were trained.

    `results` are by arm, the sources' values read; `record` is of the same arms, and `of` a digest
    of the results.
    """
    groups = [arms for arms in record.groups() if record.arms[arms[0]].transfers]
    sections = tuple(_section(arms, results, len(groups)) for arms in groups)
    return Analysis(of=of, sections=sections, episodes=_episodes(results))


def _episodes(results: Mapping[str, CurriculumResult]) -> dict[str, dict[str, EpisodePair]]:
    """Return the episodes of each task of each arm that has snapshots, and a view of its states."""
    found: dict[str, dict[str, EpisodePair]] = {}
    for arm, result in results.items():
        for name, node in result.nodes.items():
            view = None if node.snapshots is None else GridView.for_replay(node.task)
            if node.snapshots is not None and view is not None:
                discounted = result.curriculum.setting("evaluation", name).discounted
                pair = before_and_after(node.snapshots, node.task, view, discounted=discounted)
                if pair:
                    found.setdefault(arm, {})[name] = pair
    return found


def before_and_after(
    snapshots: Snapshots, task: Task, view: GridView, *, discounted: bool
) -> EpisodePair | None:
    """Return an episode of the first greedy policy and one of the last.

    Both have the same start and random stream; ties are broken uniformly; returns may be
    `discounted`. None where the task is given by functions or too large, or where a state is not in
    the view.
    """
    generative = generative_model(task)
    pairs = generative.states.size * generative.actions.size
    if pairs > LARGEST_TABLE or not (has_tables(task) or is_live(task)):
        return None
    weight = generative.discount if discounted else 1.0
    steps = min(generative.time_limit or LONGEST_EPISODE, LONGEST_EPISODE)
    episodes = list[EpisodeRecord]()
    for place in (0, -1):
        values = Values(frozen(snapshots.values[place].astype(np.float64)))
        path = greedy_rollout(task, values, seed=0, steps=steps)
        cells = np.stack([marker.cells[path.states] for marker in view.markers], axis=1)
        if (cells < 0).any():
            return None
        rewards = path.rewards * weight ** np.arange(len(path))
        returns = np.concatenate([[0.0], rewards.cumsum()])
        one = EpisodeRecord(cells=cells, returns=returns, terminated=path.terminated)
        episodes.append(one)
    before, after = episodes
    return EpisodePair(before=before, after=after)


def _section(
    arms: tuple[str, ...], results: Mapping[str, CurriculumResult], n_groups: int
) -> SectionRecord:
    target = results[arms[0]].curriculum.target
    if is_observation_task(results[arms[0]].curriculum.tasks[target]):
        seeds, certified, left_out = _observed_extent(arms, results, target)
    else:
        seeds, certified, left_out = _extent(arms, results, target, n_groups)
    found: Forecast | None = None
    certificates: dict[str, tuple[tuple[str, ...], Certificate | SampledCertificate]] = {}
    try:
        found = _forecast(arms, results, target, seeds) if seeds else None
        for arm in arms if certified else ():
            certificate = _certified(results[arm], target)
            alike, _ = certificates.get(str(certificate), ((), certificate))
            certificates[str(certificate)] = (*alike, arm), certificate
    except CurricleError as error:  # what was learnt stands all the same
        left_out.append(f"What is missing here is left out: {error}")
    return SectionRecord(
        arms=arms,
        forecast=None if found is None else _plain(found),
        certificates=tuple(
            CertificateRecord(arms=alike, holds=one.holds, text=str(one))
            for alike, one in certificates.values()
        ),
        left_out=tuple(left_out),
    )


def _plain(found: Forecast) -> ForecastRecord:
    rows = list[RowRecord]()
    for one in found.rows:
        values: dict[str, Any] = {name: one.mean(name) for name in ("start", "optimistic")}
        same = RowRecord.model_fields.keys() - values.keys()
        rows.append(RowRecord(**values, **{name: getattr(one, name) for name in same}))
    same = ForecastRecord.model_fields.keys() - {"rows"}
    return ForecastRecord(rows=tuple(rows), **{name: getattr(found, name) for name in same})


def _extent(
    arms: Sequence[str], results: Mapping[str, CurriculumResult], target: str, n_groups: int
) -> tuple[int, bool, list[str]]:
    """Return the seeds of the forecast, whether to certify, and what is left out and why."""
    first = results[arms[0]]
    space = generative_model(first.curriculum.tasks[target])
    pairs = space.states.size * space.actions.size
    kept = all(
        isinstance(results[arm].sources[t.source].values, np.ndarray)
        for arm in arms
        for t in results[arm].curriculum.in_edges(target)
    )
    seeds = kept * min(MOST_SEEDS, EFFORT // (pairs * n_groups), len(first[target].seeds))
    certified = kept and pairs <= LARGEST_CERTIFIED
    why = f"{target} has {pairs:,} state-action pairs"
    if not kept:
        why = "the sources' values were not kept in dense tables"
    elif n_groups > 1:
        why += f" and there are {n_groups} graphs"
    left_out = []
    if not seeds:
        left_out.append(
            f"The forecast is left out, because {why}: curricle.forecast(curriculum) gives it."
        )
    if not certified:
        left_out.append(
            f"Certificates are left out, because {why}: curricle.certify(task, shaping) gives them."
        )
    return seeds, certified, left_out


def _observed_extent(
    arms: Sequence[str], results: Mapping[str, CurriculumResult], target: str
) -> tuple[int, bool, list[str]]:
    """Return the same of a target seen through observations: one seed, and no certificates."""
    left_out = [
        f"Certificates are left out, because {target} is seen through observations: they need "
        "numbered states."
    ]
    first = results[arms[0]]
    readable = all(
        first.sources[t.source].values is not None for t in first.curriculum.in_edges(target)
    )
    if not readable:
        left_out.append(
            "The forecast is left out, because the sources' values were not kept, or their "
            'networks cannot be read here: pip install "curricle[deep]".'
        )
    return int(readable), False, left_out


def _forecast(
    arms: Sequence[str], results: Mapping[str, CurriculumResult], target: str, seeds: int
) -> Forecast:
    first = results[arms[0]]
    curriculum = first.curriculum
    sources = curriculum.ancestors(target)
    trained = {name: first.sources[name].first(seeds) for name in sources}
    others = [results[arm].curriculum.setting("aggregate", target) for arm in arms[1:]]
    # No trial: the experiment itself has been made.
    return forecast(
        curriculum,
        seeds=first[target].seeds[:seeds],
        aggregates=others,
        trained=trained,
        trial=False,
    )


def _certified(result: CurriculumResult, target: str) -> Certificate | SampledCertificate:
    shaping = result.curriculum.setting("shaping", target)
    task = result.curriculum.tasks[target]
    return certify(task, shaping.with_potential(_entering(result, target)))


def _entering(result: CurriculumResult, target: str) -> PairPotential:
    """Return the potential with which the first seed of a target began."""
    curriculum: Curriculum = result.curriculum
    phi: PairPotential
    if kept := result.potentials.get(target):
        phi = kept[0]
        return phi
    sources = {name: one.first(1) for name, one in result.sources.items()}
    (phi,), _ = entering(curriculum, target, sources, result[target].seeds[:1])
    return phi


# -- One episode of what a study learnt: as its folder stores it, or played in the task itself -----

IN_THE_TASK = "--study FILE, the study's own file, plays one in the task itself"


def stored_episode(
    results: StudyResults, arm: str, task: str, seed: int | None = None
) -> tuple[int, Episode]:
    """Return the last greedy episode of a task that a folder stores, and the seed that learnt it.

    No task is made and no module of the study imported. Of the rewards the folder keeps what they
    add up to, of the actions nothing.

    A `seed` is the one that must have learnt it. StoreError when the folder has no such arm or
    task, or no such episode: those of tasks with a grid and snapshots are stored, of the first
    seed, when a run that compares arms has ended.
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

    The tasks of `study`, the file that was run, are made. By default the seed is the first of those
    that have the best last greedy return. StoreError when the folder holds no such result, or the
    results of other settings; SettingError when the values were not saved, or the task has no time
    limit.
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
