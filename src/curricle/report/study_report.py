"""The report of a study's folder."""

from pathlib import Path

from curricle.files import Place
from curricle.report.page import ShownStudy, page_of
from curricle.report.templates import write_page
from curricle.study.effects import effects_of
from curricle.study.record import Analysis, CurriculaRecord, SectionRecord
from curricle.study.results import StudyResults
from curricle.study.tuning_record import read_tuning
from curricle.study.units import seed_ranges


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
    place = study.store.path
    default = place / "report.html" if isinstance(place, Path) else f"{place.name}-report.html"
    return write_page(stored_page(study), Path(default if out is None else out))


def stored_page(study: StudyResults) -> str:
    """Return the page of a stored study; StoreError when there is nothing to compare yet."""
    comparison = study.comparison
    learnt = {arm: one for arm, one in study.results.items() if arm not in study.failed}
    places = [(arm, task) for arm, nodes in learnt.items() for task in nodes]
    reasons = {place: list(study.ended_by(*place).values()) for place in places}
    record = study.record.only(learnt)
    analysis = study.analysis or _no_analysis(record)
    tuning = read_tuning(study.store)
    effects = effects_of(comparison, record, tuning)
    name = study.record.name
    shown = ShownStudy(name, comparison, record, learnt, analysis, reasons, effects, tuning)
    return page_of(shown, _environment(study))


def _no_analysis(record: CurriculaRecord) -> Analysis:
    """Return the analysis of a run that has not ended: what is left out."""
    why = (
        "The forecast and certificates are left out, because the run has not ended: "
        "curricle run --resume makes them."
    )
    groups = [arms for arms in record.groups() if record.arms[arms[0]].transfers]
    sections = [
        SectionRecord(arms=arms, forecast=None, certificates=(), left_out=(why,)) for arms in groups
    ]
    return Analysis(of="", sections=tuple(sections))


def _environment(study: StudyResults) -> dict[str, str]:
    """Return what the last run was made with, name -> text."""
    if not study.runs:
        return {}
    last = study.runs[-1]
    return {
        "file": last.file,
        "started": last.started,
        "seeds": seed_ranges(study.seeds),
        "commit": last.commit or "none",
        "Python": last.python,
        "machine": last.machine,
        **last.versions,
    }
