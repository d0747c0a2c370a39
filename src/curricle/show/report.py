"""The report of a study's folder: once, or again and again while units are stored.

An interim report is made of what the folder holds, whoever runs the study, so that ``run --open``
and ``watch`` do the same.
"""

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from pathlib import Path
from secrets import token_hex
from threading import Event, Lock, Thread
from time import monotonic, sleep
from typing import Any, Self

from curricle.checks import listed
from curricle.errors import StudyError, in_words
from curricle.files import Place, RemotePath, place_at
from curricle.show.page import page_of, render, write_page
from curricle.statistics.curves import SCRATCH
from curricle.study.record import StudyRecord
from curricle.study.results import ANALYSIS, StudyResults
from curricle.study.store import STUDY, in_use
from curricle.text import counted

BETWEEN, BETWEEN_AT_URL = 2.0, 10.0  # seconds between two interim reports at least
REST = 10.0  # after an interim report that took t seconds no other is begun for REST * t
ATTEMPTS = 3  # a file that a listing names may have been merged into another before it is read
INTERRUPTED = "The run was interrupted. What was stored is whole, and --resume goes on from there."
NO_LONGER = "The command that followed the run was ended; the run goes on by itself."


def write_report(folder: str | Place, out: str | Path | None = None) -> Path:
    """Write the report of a study's folder, and return its path.

    Parameters
    ----------
    folder : path or str
        Or a URL.
    out : path, optional
        ``report.html`` in the folder by default; NAME-report.html here for the URL of NAME.

    Raises
    ------
    StoreError
        When there is nothing to compare yet, or the page cannot be written.
    """
    study = StudyResults(folder)
    path = default_page(study.store.path) if out is None else Path(out)
    return write_page(page_of(study), path)


def default_page(place: Place) -> Path:
    """Return where the report of a folder is written by default."""
    return place / "report.html" if isinstance(place, Path) else Path(f"{place.name}-report.html")


# -- while units are stored ------------------------------------------------------------------------


class InterimReport:
    """Writes the report of a folder anew as units are stored; what fails is said, not raised."""

    def __init__(
        self,
        folder: str | Place,
        line: Callable[[int, int], str],  # how far it is, from the stored units and all units
        say: Callable[[str], Any],  # told why the page cannot be written, once with the same
        opened: Callable[[Path], Any],  # called when the page is there
        *,
        path: Path | None = None,
        elsewhere: bool = False,  # others run the study: the folder tells whether they still do
    ):
        self.folder, self.over = place_at(folder), False
        self.path = default_page(self.folder) if path is None else path
        self._line, self._say, self._opened, self._elsewhere = line, say, opened, elsewhere
        self._between = BETWEEN_AT_URL if isinstance(self.folder, RemotePath) else BETWEEN
        self._place = token_hex(16)  # of the banner in the page
        self._page, self._was_running, self._said = "", False, set[str]()
        self._seen: Any = None
        self._stopped, self._writing = Event(), Lock()
        self._thread: Thread | None = None

    def begin(self) -> None:
        """Begin to follow the folder in a thread; again, it does nothing."""
        if self._thread is None:
            self._thread = Thread(target=self._follow, daemon=True)
            self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, KeyboardInterrupt):
            self.break_off(INTERRUPTED)
        elif error is not None and not isinstance(error, StudyError):
            self.break_off(f"The run ended with an error. {_one_line(error)}")
        elif self._thread is not None:
            # A last time, from all that is stored.
            self._stopped.set()
            self._thread.join()
            self.refresh(last=True)

    def watch(self) -> None:
        """Write the page until the run elsewhere is over."""
        try:
            pause = self.refresh()
            while not self.over:
                sleep(pause)
                pause = self.refresh()
        except KeyboardInterrupt:
            self.break_off(NO_LONGER)
            raise

    def break_off(self, sentence: str) -> None:
        """Write the page a last time as it is, and why it ends; what is being read is left."""
        self._stopped.set()
        with self._writing:
            if self._page:
                self._write(sentence, 0)

    def refresh(self, *, last: bool = False) -> float:
        """Write the page if something is new; return the seconds until the next time at least."""
        begun = monotonic()
        for attempt in range(ATTEMPTS):
            try:
                self._read(begun, last)
                break
            except Exception as error:  # whatever it is, it must not stop a run
                sentence = f"the page of the run is not up to date. {_one_line(error)}"
                if attempt == ATTEMPTS - 1 and sentence not in self._said:
                    self._said.add(sentence)
                    self._say(sentence)
        return max(self._between, REST * (monotonic() - begun))

    def _follow(self) -> None:
        pause = 0.0
        while not self._stopped.wait(pause):
            pause = self.refresh()

    def _read(self, begun: float, last: bool) -> None:
        """Read the folder, and write the page if something is new or it is the `last` time."""
        if not (self.folder / STUDY).exists():
            return
        study = StudyResults(self.folder)
        per_unit = study.store.description.get("configuration", {}).get("seeds_per_unit", 1)
        seeds, keys, kept = study.record.seeds, set(study.record.keys.values()), study.stored
        # A unit is stored when all its seeds are.
        missing = {(k, s // per_unit) for k in keys for s in seeds if s not in kept.get(k, {})}
        units = len(keys) * len({seed // per_unit for seed in seeds})
        stored_units = units - len(missing)
        running = in_use(self.folder) if self._elsewhere else True
        over = last or (self._elsewhere and self._ended(study, not missing, running))
        stored = {key: len(done) for key, done in kept.items()}
        seen = stored, study.record.seeds, study.failed, study.store.has(ANALYSIS), running
        if seen == self._seen and not over:
            return
        arms = arms_so_far(study)
        if over and stored_units == units and arms:
            page = page_of(study)
        elif arms:
            page = page_of(_only(study, {*arms, *study.failed}), self._place)
        else:
            page = render("waiting.html", name=study.record.name, banner=self._place)
        if over:
            sentence = f"The run is over: {stored_units:,} of {counted(units, 'unit')} are stored."
        else:
            idle = " No process is at work now." * (running is False)
            sentence = f"{self._line(stored_units, units)}.{idle}"
        with self._writing:
            if self._stopped.is_set() and not last:
                return
            is_first, self._page = not self._page, page
            remark = _remark(study.record, study.failed, arms)
            pause = max(self._between, REST * (monotonic() - begun))
            self._write(f"{sentence} {remark}", 0 if over else pause)
        self._seen, self.over = seen, over
        if is_first:
            self._opened(self.path)

    def _ended(self, study: StudyResults, whole: bool, running: bool | None) -> bool:
        """Return whether a run elsewhere is over: it let go of the folder, or all is there."""
        let_go, self._was_running = self._was_running and running is False, running is True
        done = whole or bool(study.failed and running is False)
        return let_go or (done and not running and study.store.has(ANALYSIS))

    def _write(self, sentence: str, seconds: float) -> None:
        time, seconds = f"{datetime.now():%X}", round(seconds, 1)
        banner = render("banner.html", sentence=sentence, time=time, seconds=seconds)
        write_page(self._page.replace(self._place, banner), self.path)


def arms_so_far(study: StudyResults) -> list[str]:
    """Return the arms that can be compared: scratch and others, with the most results in common."""
    record = study.record
    if record.total is None or SCRATCH not in record.arms or SCRATCH in study.failed:
        return []
    done = {
        name: set(record.seeds).intersection(
            *(study.stored.get(record.keys[name, task], {}) for task in arm.nodes)
        )
        for name, arm in record.arms.items()
        if name not in study.failed
    }
    others = sorted(done.keys() - {SCRATCH}, key=lambda name: -len(done[name] & done[SCRATCH]))
    # The n arms for which n times the number of seeds that all have finished is largest.
    best, most, common = 0, 0, done[SCRATCH]
    for number, name in enumerate(others, start=1):
        common = common & done[name]
        if common and (number + 1) * len(common) >= most:
            best, most = number, (number + 1) * len(common)
    chosen = {SCRATCH, *others[:best]}
    # A control says nothing without the arm that it is of.
    kept = {name: arm for name, arm in record.arms.items() if name in chosen}
    kept = {name: arm for name, arm in kept.items() if arm.control_of in {"", *kept}}
    if all(arm.scratch or arm.control_of for name, arm in kept.items() if name != SCRATCH):
        return []
    return list(kept)


def _only(study: StudyResults, arms: set[str]) -> StudyResults:
    """Return the results of some arms of a study, those that failed among them."""
    part = StudyResults(study.store.path)
    part.lacks_arms = not study.record.arms.keys() <= arms
    kept = {name: arm for name, arm in study.record.arms.items() if name in arms}
    part.record = study.record.model_copy(update={"arms": kept})
    return part


def _remark(record: StudyRecord, failed: Iterable[str], arms: Sequence[str]) -> str:
    if record.total is None or SCRATCH not in record.arms or SCRATCH in {*failed}:
        return "There is no report: it needs the target learnt from scratch, for a number of steps."
    if not arms:
        return f"The report begins when {SCRATCH} and another arm have finished a seed."
    later = [arm for arm in record.arms if arm not in {*arms, *failed}]
    come = f" is of {listed(arms)}; to come: {listed(later)}" if later else " is of all arms"
    return f"The report so far{come}. There is no verdict before all seeds are there."


def _one_line(error: BaseException) -> str:
    return " ".join(in_words(error).split())
