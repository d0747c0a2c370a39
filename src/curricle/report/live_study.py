"""A study's folder while units are stored: its progress by task, and its report so far."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from secrets import token_hex
from threading import Event, Thread
from time import monotonic, thread_time
from typing import Any, NamedTuple

from curricle.checks import listed
from curricle.errors import in_words
from curricle.files import Place, RemotePath, place_at
from curricle.report.graph import CardCurve, card_curves
from curricle.report.study_report import stored_page
from curricle.statistics.curves import SCRATCH
from curricle.study.folders import STUDY, in_use
from curricle.study.record import StudyRecord
from curricle.study.results import ANALYSIS, StudyResults
from curricle.text_tables import counted

SHARE = 0.05
"""Of the time that making curves and report may take, and as much for looking what is new."""
BETWEEN, BETWEEN_AT_URL = 2.0, 10.0
"""Seconds between two looks into the folder at least."""
ATTEMPTS = 2
"""A file that a listing names may have been merged into another before it is read."""


@dataclass(frozen=True)
class TaskRow:
    """How far a task is, which several arms may share."""

    name: str  # arms and task
    stored: int  # seeds
    seeds: int
    curve: CardCurve | None  # mean over the seeds so far; None where there is none to draw

    def data(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        drawn = self.curve and {"line": self.curve.line, "band": self.curve.band}
        words = self.curve.words if self.curve else ""
        return {
            "name": self.name,
            "stored": self.stored,
            "seeds": self.seeds,
            "curve": drawn,
            "words": words,
        }


class Counts(NamedTuple):
    """Units that are stored, and all of a study."""

    stored: int
    units: int

    def __str__(self) -> str:
        return f"{self.stored:,} of {counted(self.units, 'unit')}"


def unit_counts(study: StudyResults) -> Counts:
    """Return how many units of a study are stored with all their seeds, and how many it has."""
    per_unit = study.store.description.get("configuration", {}).get("seeds_per_unit", 1)
    stored = units = 0
    for key in set(study.record.keys.values()):
        there = study.stored.get(key, {})
        groups = {seed // per_unit for seed in study.record.seeds}
        missing = {seed // per_unit for seed in study.record.seeds if seed not in there}
        stored, units = stored + len(groups - missing), units + len(groups)
    return Counts(stored, units)


def arms_so_far(study: StudyResults) -> list[str]:
    """Return the arms that can be compared: scratch and others, with the most results in common.

    Those are the n arms for which n times the number of seeds that all have finished is largest.
    Empty as long as there are no two.
    """
    record = study.record
    if record.total is None or SCRATCH not in record.arms or SCRATCH in study.failed:
        return []
    done = {
        arm: set(record.seeds).intersection(
            *(study.stored.get(record.keys[arm, task], {}) for task in one.nodes)
        )
        for arm, one in record.arms.items()
        if arm not in study.failed
    }
    others = sorted(done.keys() - {SCRATCH}, key=lambda arm: -len(done[arm] & done[SCRATCH]))
    best, most, common = 0, 0, done[SCRATCH]
    for number, arm in enumerate(others, start=1):
        common = common & done[arm]
        if common and (number + 1) * len(common) >= most:
            best, most = number, (number + 1) * len(common)
    chosen = {SCRATCH, *others[:best]}
    if all(record.arms[arm].scratch for arm in chosen - {SCRATCH}):
        return []
    return [arm for arm in record.arms if arm in chosen]


class LiveStudy:
    """What a live page shows of a study's folder; a thread reads it again while units are stored.

    Curves and report are made in at most `SHARE` of the time; where others are at work on the
    machine, they take longer and so are made less often. Nothing that goes wrong there is raised:
    the page says it in one sentence.

    Parameters
    ----------
    folder : path or str
        Or a URL. It need not be there yet.
    line : callable
        Units that are stored and units in all, as the folder has them -> how far the study is, in
        words.
    elsewhere : bool
        Whether others run the study, so that the folder must tell whether they still do.

    Attributes
    ----------
    rows : tuple of TaskRow
    page : str
        The report so far; empty as long as there is none.
    ended : str
        How the run ended, in a sentence; empty while it goes on.
    standing : str
        That a run elsewhere is finished, or that no process is at it now; another may begin.
    """

    def __init__(
        self, folder: str | Place, line: Callable[[int, int], str], *, elsewhere: bool = False
    ):
        self.folder, self.name = place_at(folder), place_at(folder).name
        self.rows: tuple[TaskRow, ...] = ()
        self.page = self.ended = self.standing = ""
        self._elsewhere = elsewhere
        self._line, self._counts, self._page_counts = line, Counts(0, 0), Counts(0, 0)
        self._note = self._trouble = ""
        self._token, self._version, self._page_version = token_hex(4), 0, 0
        self._seen: Any = None
        self._shown: Any = None
        # what is read over a network is waited for, which slows nothing
        self._clock = thread_time if isinstance(self.folder, RemotePath) else monotonic
        self._next = 0.0
        self._curves: dict[str, tuple[int, CardCurve | None]] = {}
        self._over = Event()
        self._thread = Thread(target=self._follow, daemon=True)

    def start(self) -> None:
        """Begin to follow the folder."""
        self._thread.start()

    def stop(self) -> None:
        """Follow the folder no longer, and wait until what is being read is read."""
        self._over.set()
        self._thread.join()

    def end(self, sentence: str, *, read: bool = True) -> None:
        """Say how the run ended, after reading the folder a last time if asked to."""
        if read:
            self.stop()
            self.refresh(last=True)
        self.ended = sentence

    def state(self) -> dict[str, Any]:
        """Return what changes from second to second, as JSON holds it."""
        return {
            "of": self._token,
            "name": self.name,
            "line": str(self._counts) if self.standing else self._line(*self._counts),
            "stored": self._counts.stored,
            "units": self._counts.units,
            "note": self._note + self._behind,
            "trouble": self._trouble,
            "ended": self.ended,
            "standing": self.standing,
            "rows": self._version,
            "page": self._page_version,
        }

    @property
    def _behind(self) -> str:
        """Say what the report is of, where more is stored by now."""
        if not self.page or self._page_counts == self._counts:
            return ""
        then, now = self._page_counts.stored, self._counts.stored
        return f" It was made when {then:,} of the {now:,} units that are stored were there."

    def refresh(self, *, last: bool = False) -> float:
        """Read the folder once; return the seconds that looking into it took.

        Curves and report are made if something is new and their share of time allows it, or in any
        case if this is the `last` time.
        """
        begun, took = self._clock(), 0.0
        for attempt in range(ATTEMPTS):
            try:
                took = self._read(last)
                self._trouble = ""
                break
            except Exception as error:  # whatever it is, it must not stop a run
                if attempt == ATTEMPTS - 1:
                    self._trouble = f"The report is not up to date. {one_line(error)}"
        return self._clock() - begun - took

    def _follow(self) -> None:
        between = BETWEEN_AT_URL if isinstance(self.folder, RemotePath) else BETWEEN
        pause = 0.0
        while not self._over.wait(pause):
            pause = max(between, self.refresh() / SHARE)

    def _read(self, last: bool) -> float:
        """Bring counts, curves and report up to date; return the seconds that the two took."""
        if not (self.folder / STUDY).exists():
            return 0.0
        study = StudyResults(self.folder)
        there = {key: len(seeds) for key, seeds in study.stored.items()}
        seen = there, study.record.seeds, study.failed, study.store.has(ANALYSIS)
        if seen != self._seen:
            self.name, self._counts = study.record.name, unit_counts(study)
            self._show_rows(study)
            self._seen = seen
        if self._elsewhere:
            self.standing = _standing(study, self._counts)
        if seen == self._shown or not (last or monotonic() >= self._next):
            return 0.0
        begun = self._clock()
        self._read_curves(study)
        if arms := arms_so_far(study):
            self.page = stored_page(_only(study, {*arms, *study.failed}))
            self._page_version, self._page_counts = self._page_version + 1, unit_counts(study)
        self._note = _note(study.record, study.failed, arms)
        self._shown = seen
        took = self._clock() - begun
        self._next = monotonic() + took / SHARE
        return took

    def _read_curves(self, study: StudyResults) -> None:
        """Read the curves of the tasks that have more seeds than when they were read last."""
        for (arm, task), key in study.record.keys.items():
            stored = len(study.stored.get(key, ()))
            if stored and self._curves.get(key, (0,))[0] != stored:
                drawn = card_curves({arm: study.result(arm, task)})
                self._curves[key] = stored, drawn[0] if drawn else None
        self._show_rows(study)

    def _show_rows(self, study: StudyResults) -> None:
        """Make a row for each task that is trained, by whichever arms."""
        record = study.record
        places = dict[str, list[tuple[str, str]]]()
        for place, key in record.keys.items():
            places.setdefault(key, []).append(place)
        self.rows = tuple(
            TaskRow(
                f"{', '.join(arm for arm, _ in shared)}: {shared[0][1]}",
                len({*study.stored.get(key, ())} & {*record.seeds}),
                len(record.seeds),
                self._curves[key][1] if key in self._curves else None,
            )
            for key, shared in places.items()
        )
        self._version += 1


def _only(study: StudyResults, arms: set[str]) -> StudyResults:
    """Return the results of some arms of a study, as if it had no others."""
    found = StudyResults(study.store.path)
    kept = {arm: one for arm, one in study.record.arms.items() if arm in arms}
    found.record = study.record.model_copy(update={"arms": kept})
    return found


def _standing(study: StudyResults, counts: Counts) -> str:
    """Return that a study is finished, or that no process is running it; empty while one is."""
    whole = counts.stored == counts.units and study.store.has(ANALYSIS)
    running = in_use(study.store.path)
    if running or (running is None and not whole):
        return ""
    if whole:
        return f"The study is finished: {counts} are stored."
    return (
        f"No process is running it, as none holds the folder’s lock: {counts} are stored, and "
        "curricle run with --resume goes on from there."
    )


def _note(record: StudyRecord, failed: Iterable[str], arms: Sequence[str]) -> str:
    """Return what the report is of, where that is not the whole study."""
    if record.total is None or SCRATCH not in record.arms or SCRATCH in {*failed}:
        return "There is no report: it needs the target learnt from scratch, for a number of steps."
    if not arms:
        return f"The report begins when {SCRATCH} and another arm have finished a seed."
    if later := [arm for arm in record.arms if arm not in {*arms, *failed}]:
        return f"The report so far is of {listed(arms)}; to come: {listed(later)}."
    return "The report is of all arms."


def one_line(error: BaseException) -> str:
    r"""Return an error as one line.

    Examples
    --------
    >>> one_line(ValueError("a rule:\n a value"))
    'ValueError: a rule: a value'
    """
    return " ".join(in_words(error).split())
