"""The parts of a study's results that need its tasks: record, certificates, episodes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from PIL import Image

from curricle.arrays import frozen
from curricle.certificate.certification import certify
from curricle.comparison.measures import STATED, Reference
from curricle.comparison.plan import PlannedArm, number_among
from curricle.comparison.task_differences import task_summary
from curricle.curriculum.curriculum import OF_TARGETS, SETTINGS, Curriculum
from curricle.curriculum.result import CurriculumResult
from curricle.deep.learner import DeepLearner, PolicyReuse
from curricle.errors import CurricleError, StoreError
from curricle.files import short_digest
from curricle.learning.record import Snapshots
from curricle.learning.tabular_policy import TabularPolicy
from curricle.pictures.episode import OF_TASKS, Drawn, Episode
from curricle.pictures.scenes import png_code, scene_of_view
from curricle.pictures.views import GridView
from curricle.planning.greedy import Values
from curricle.planning.rollouts import greedy_rollout
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms
from curricle.study.config import StudyConfig
from curricle.study.record import (
    LONGEST_EPISODE,
    MOST_DRAWINGS,
    OF_CONFIGURATION,
    Analysis,
    ArmRecord,
    CertificateRecord,
    CurriculaRecord,
    EpisodePair,
    EpisodeRecord,
    NodeRecord,
    SectionRecord,
    StudyRecord,
    TaskRecord,
    TransferRecord,
    ViewRecord,
)
from curricle.study.results import StudyResults
from curricle.study.store import ANALYSIS
from curricle.tasks.live import is_live
from curricle.tasks.mdp import Task, generative_model, has_tables, same_task
from curricle.tasks.observation_task import ObservationTask, is_observation_task, plain_text
from curricle.text import counted
from curricle.transfer.transfer import Transfer, same_transfer, transfer_words

# -- The record of a study before it is run: plain data of its tasks and curricula -----------------


def study_record(study: StudyConfig, arms: Arms, solved: Sequence[StudyRecord] = ()) -> StudyRecord:
    """Return the record of a study, before it is run.

    The target is solved, unless it is that of one of the records `solved`.
    """
    curricula = curricula_record(arms.arms)
    problem = task_summary(arms.target_node.task)
    reference = Reference(study.threshold, STATED)
    if arms.total is not None and SCRATCH in arms.curricula:
        evaluated = curricula.arms[SCRATCH].nodes[arms.target].settings["evaluation"]
        same = (
            record.reference
            for record in solved
            if record.problem == problem and record.evaluated == evaluated
        )
        reference = next(same, None) or Reference.before(arms.target_node, study.threshold)
    fields = {name: getattr(study, name) for name in OF_CONFIGURATION}
    fields["variants"] = study.variants or {}
    fields |= {name: getattr(arms, name) for name in ("target", "budget", "total", "eval_freq")}
    return StudyRecord(**dict(curricula), problem=problem, reference=reference, **fields)


def curricula_record(planned: Mapping[str, PlannedArm]) -> CurriculaRecord:
    """Return the record of arms by name, with the keys of their stored results, if any."""
    tasks, edges, arms = list[Task](), list[Transfer](), {}
    for label, arm in planned.items():
        curriculum, nodes = arm.curriculum, dict[str, NodeRecord]()
        for name in curriculum.order:
            sources, node = curriculum.in_edges(name), curriculum.node(name)
            skipped = ("potential",) if sources else () if node.potential else OF_TARGETS
            settings = [which for which in SETTINGS if which not in skipped]
            aggregate = getattr(node.aggregate, "__name__", "a custom aggregate")
            nodes[name] = NodeRecord(
                task=number_among(tasks, node.task, same_task),
                key=arm.keys.get(name, ""),
                settings={w: _setting_text(curriculum.setting(w, name)) for w in settings},
                aggregate=aggregate if len(sources) > 1 else None,
            )
        transfers = list[TransferRecord]()
        for edge in curriculum.transfers:
            number = number_among(edges, edge, same_transfer)
            ends = {"source": edge.source, "target": edge.target}
            transfers.append(TransferRecord(**ends, words=transfer_words(edge), number=number))
        arms[label] = ArmRecord(
            nodes=nodes,
            transfers=tuple(transfers),
            scratch=arm.scratch,
            control_of=arm.of,
            depends_on_total=_depends_on_total(curriculum),
            knows_target=any(map(curriculum.knows_target, curriculum.last_tasks)),
        )
    return CurriculaRecord(tasks=tuple(map(_task, tasks)), arms=arms)


def _task(task: Task | ObservationTask) -> TaskRecord:
    if isinstance(task, ObservationTask):
        kind = f"observations, {task.shapes.replace('->', '→')}"
        return TaskRecord(kind=kind, text=plain_text(task), states=0, actions=0, view=None)
    model, view = generative_model(task), GridView.for_replay(task)
    states, actions = model.states.size, model.actions.size
    return TaskRecord(
        kind=f"{type(task).__name__}, {counted(states, 'state')} × {counted(actions, 'action')}",
        text=plain_text(task),
        states=states,
        actions=actions,
        view=None if view is None else ViewRecord.of(view),
    )


def _setting_text(value: object) -> str:
    """Return a setting as text: functions by name, numbers with commas."""
    if value is None:
        return "default"
    if isinstance(value, int):
        return f"{value:,}"
    name = getattr(value, "__name__", None)
    return str(name) if name else value if isinstance(value, str) else plain_text(value)


def _depends_on_total(curriculum: Curriculum) -> str:
    """Return why every step of learning a target depends on the budget; empty if it does not."""
    target = curriculum.target
    learner, shaping = (curriculum.setting(which, target) for which in ("learner", "shaping"))
    if isinstance(learner, DeepLearner) and learner.scheduled:
        return f"a schedule of {learner.algorithm} runs over the total"
    guided = isinstance(shaping, PolicyReuse) and "buffer_size" in learner.takes
    if guided or getattr(shaping, "kl", 0) > 0:
        return "its sources' policy is followed in the first half of the total"
    return ""


# -- Certificates and episodes, which need the tasks; stored when a run ends -----------------------

LARGEST_CERTIFIED = 20_000_000  # target pairs up to which a potential is certified
LARGEST_TABLE = 20_000_000  # pairs (S x A) of a task up to which its episodes are kept


def analyse(study: StudyResults, arms: Arms) -> None:
    """Write the analysis of a study whose arms are compared, unless it is stored.

    It covers the first seed that every arm has finished.
    """
    curricula = {
        arm: curriculum
        for arm, curriculum in arms.curricula.items()
        if not (arm in study.failed or arms.arms[arm].of)
    }
    if not study.seeds or arms.total is None or SCRATCH not in curricula:
        return
    seeds = study.seeds[:1]
    keys = sorted(item for item in study.record.keys.items() if item[0][0] in curricula)
    of = short_digest(repr((keys, seeds)).encode())
    written = study.analysis  # reads the file
    if written is not None and written.of == of:
        return
    results = {}
    for arm, curriculum in curricula.items():
        nodes = {
            name: replace(study.result(arm, name, seeds=seeds), task=curriculum.tasks[name])
            for name in curriculum.order
        }
        trained = study.trained(arm, curriculum, seeds)
        results[arm] = CurriculumResult(curriculum, nodes, {}, given=trained)
    study.store.write_record(ANALYSIS, analysed(results, study.record.only(curricula), of))


def analysed(
    results: Mapping[str, CurriculumResult], record: CurriculaRecord, of: str = ""
) -> Analysis:
    """Return the analysis of trained curricula by arm; `of` is a digest of their results."""
    groups = [arms for arms in record.groups() if record.arms[arms[0]].has_potential]
    sections = tuple(_section(arms, results) for arms in groups)
    episodes: dict[str, dict[str, EpisodePair]] = {}
    for arm, result in results.items():
        for name, node in result.nodes.items():
            discount = result.curriculum.setting("evaluation", name).discount(node.task)
            if pair := before_and_after(node.snapshots, node.task, discount):
                episodes.setdefault(arm, {})[name] = pair
    _drawing.cache_clear()
    return Analysis(of=of, sections=sections, episodes=episodes)


def before_and_after(
    snapshots: Snapshots | None, task: Task, discount: float
) -> EpisodePair | None:
    """Return an episode of the first and one of the last greedy policy; None without a grid."""
    view = None if snapshots is None else GridView.for_replay(task)
    if snapshots is None or view is None:
        return None
    model = generative_model(task)
    pairs = model.states.size * model.actions.size
    if pairs > LARGEST_TABLE or not (has_tables(task) or is_live(task)):
        return None
    steps = min(model.time_limit or LONGEST_EPISODE, LONGEST_EPISODE)
    episodes = list[EpisodeRecord]()
    for place in (0, -1):
        values = Values(frozen(snapshots.values[place].astype(np.float64)))
        path = greedy_rollout(task, values, seed=0, steps=steps)
        cells = np.stack([marker.cells[path.states] for marker in view.markers], axis=1)
        drawings, drawn = _drawings(task, path.states.tolist())
        if (cells < 0).any():
            if not drawings:
                return None
            cells = cells[:, :0]
        paid = path.rewards * discount ** np.arange(len(path))
        record = EpisodeRecord(
            cells=cells,
            returns=np.concatenate([[0.0], paid.cumsum()]),
            rewards=path.rewards,
            terminated=path.terminated,
            drawings=drawings,
            drawn=np.array(drawn, dtype=np.int64),
        )
        episodes.append(record)
    return EpisodePair(before=episodes[0], after=episodes[1])


LONGEST_TEXT, LARGEST_PICTURE, SMALL = 2_000, 6_000, 240
"""Characters of a drawing: its text, its picture's code; pixels of the longer side."""


@lru_cache(maxsize=1000)  # arms play in the same tasks, and a picture may take a tenth of a second
def _drawing(show: Callable[[int, str], Any], state: int) -> tuple[str, str]:
    text, code = show(state, "ansi") or "", ""
    if (pixels := show(state, "rgb_array")) is not None:
        picture = Image.fromarray(pixels)
        picture.thumbnail((SMALL, SMALL))
        code = png_code(picture.quantize(32))
    return text[:LONGEST_TEXT], code if len(code) <= LARGEST_PICTURE else ""


def _drawings(task: Task, states: list[int]) -> tuple[tuple[tuple[str, str], ...], list[int]]:
    """Return what a task's class shows of an episode's first states, and which of it when."""
    show, first = generative_model(task).states.drawn, [*dict.fromkeys(states)][:MOST_DRAWINGS]
    drawings = () if show is None else tuple(_drawing(show, state) for state in first)
    if not any(map(any, drawings)):
        return (), []
    numbers = {state: number for number, state in enumerate(first)}
    return drawings, [numbers.get(state, -1) for state in states]


def _section(arms: tuple[str, ...], results: Mapping[str, CurriculumResult]) -> SectionRecord:
    target = results[arms[0]].curriculum.target
    certificates, left_out = dict[str, CertificateRecord](), _not_certified(arms, results, target)
    try:
        for arm in () if left_out else arms:
            curriculum = results[arm].curriculum
            sources = {name: source.first(1) for name, source in results[arm].sources.items()}
            (phi,) = curriculum.potentials(target, sources)
            shaping = curriculum.setting("shaping", target).with_potential(phi)
            certificate = certify(curriculum.tasks[target], shaping)
            text, holds = str(certificate), certificate.holds
            alike = certificates[text].arms if text in certificates else ()
            certificates[text] = CertificateRecord(arms=(*alike, arm), holds=holds, text=text)
    except CurricleError as error:  # the results are valid without certificates
        left_out = f"What is missing here is left out: {error}"
    sentences = (left_out,) if left_out else ()
    return SectionRecord(arms=arms, certificates=tuple(certificates.values()), left_out=sentences)


def _not_certified(
    arms: Sequence[str], results: Mapping[str, CurriculumResult], target: str
) -> str:
    """Return a sentence on why arms get no certificates; empty if they get them."""
    task = results[arms[0]].curriculum.tasks[target]
    if is_observation_task(task):
        return (
            f"Certificates are left out, because {target} is seen through observations: they need "
            "numbered states."
        )
    edges = {arm: results[arm].curriculum.in_edges(target) for arm in arms}
    tables = (results[arm].sources[edge.source].values for arm in arms for edge in edges[arm])
    space = generative_model(task)
    pairs = space.states.size * space.actions.size
    why = f"{target} has {pairs:,} state-action pairs" * (pairs > LARGEST_CERTIFIED)
    if not all(isinstance(table, np.ndarray) for table in tables):
        why = "the sources' values were not kept in dense tables"
    calls = "curricle.certify(task, shaping) gives them"
    return f"Certificates are left out, because {why}: {calls}." if why else ""


# -- Episodes of learnt policies: read from a study's folder, or played in the task ----------------

IN_THE_TASK = "--study FILE, the study's own file, plays one in the task itself"


def stored_episode(
    results: StudyResults, arm: str, task: str, seed: int | None = None
) -> tuple[int, Episode]:
    """Return the last greedy episode of a task in a folder, and the seed that learnt it."""
    about, analysis = results.task(arm, task), results.analysis
    pair = None if analysis is None else analysis.episodes.get(arm, {}).get(task)
    if pair is None or about.view is None:
        raise StoreError(
            f"{results.store.path} stores no episode of {task!r} in arm {arm!r}: episodes are "
            "stored of tasks with a grid and snapshots, when the run of all arms has ended; "
            f"{IN_THE_TASK}"
        )
    snapshots = results.result(arm, task).snapshots
    first = results.record.seeds[0] if snapshots is None else snapshots.seed
    if seed not in (None, first):
        raise StoreError(
            f"{results.store.path} stores an episode of seed {first} alone: got seed {seed}; "
            f"{IN_THE_TASK}"
        )
    view, record, cells = about.view.view, pair.after, pair.after.cells
    fits = cells.shape[1] == len(view.markers) and cells.max() < np.prod(view.shape)
    if not fits and (cells.size or not record.drawings):
        raise StoreError(f"{results.store.path} stores an episode of {task!r} that leaves its grid")
    scene, moments = scene_of_view(view), np.arange(len(cells))
    texts = [record.drawings[number][0] if number >= 0 else "" for number in record.drawn]
    return first, Episode(
        frames=Drawn(lambda moment: scene.image(cells[moment]), moments) if fits else (),
        actions=np.zeros(0, np.int64),
        rewards=record.rewards,
        terminated=record.terminated,
        fps=OF_TASKS,
        texts=texts
        if any(texts) or not fits
        else Drawn(lambda moment: scene.text(cells[moment]), moments),
    )


def played_episode(
    results: StudyResults, study: StudyConfig, arm: str, task: str, seed: int | None = None
) -> tuple[int, Episode]:
    """Return an episode of a learnt policy in the task itself, and the seed that learnt it."""
    learnt, arms = results.result(arm, task), Arms.of(study)
    if arms.keys.get((arm, task)) != results.record.keys[arm, task]:
        raise StoreError(
            f"an episode is played by the study that was run: {results.store.path} holds {task!r} "
            f"of arm {arm!r} as trained with other settings, or by another version of Curricle"
        )
    if seed is None:
        last = learnt.greedy_return[:, -1]
        seed = learnt.seeds[0 if np.isnan(last).all() else int(np.nanargmax(last))]
    (policy,) = results.policies(arm, arms.curricula[arm], [seed], task=task)
    endless = isinstance(policy, TabularPolicy) and generative_model(policy.task).time_limit is None
    return seed, policy.episode(max_steps=LONGEST_EPISODE if endless else None)
