"""The report of a study's folder."""

from pathlib import Path

from curricle.curriculum.curriculum import CurriculumResult
from curricle.curriculum.node import Node
from curricle.errors import StoreError
from curricle.files import write_whole
from curricle.report.page import study_page
from curricle.study.results import StudyResults
from curricle.study.units import seed_ranges


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write the report of a study's folder, and return its path.

    Parameters
    ----------
    folder : path
    out : path, optional
        ``report.html`` in the folder by default.

    Raises
    ------
    StoreError
        When there is nothing to compare yet, or the page cannot be written.
    """
    study = StudyResults(folder)
    path = Path(out) if out is not None else study.store.path / "report.html"
    page = _page(study)
    try:
        write_whole(path, page.encode())
    except OSError as error:
        raise StoreError(f"a report cannot be written to {path}: {error.strerror}") from None
    return path


def _page(study: StudyResults) -> str:
    """Return the page of a stored study; of all values only those of its sources are read."""
    results = {}
    for arm, curriculum in study.arms.curricula.items():
        if arm in study.failed:
            continue
        read = {transfer.source for transfer in curriculum.transfers}
        nodes = {
            name: study.result(arm, name, values=name in read and _readable(curriculum.node(name)))
            for name in curriculum.order
        }
        results[arm] = CurriculumResult(curriculum, nodes, {})
    places = [(arm, name) for arm, found in results.items() for name in found.nodes]
    last = study.store.runs()[-1]
    return study_page(
        study.config.name,
        study.comparison,
        results,
        decisions={place: list(study.ended_by(*place).values()) for place in places},
        environment={
            "file": last["file"],
            "started": last["started"],
            "seeds": seed_ranges(study.seeds),
            "commit": last["commit"] or "none",
            "Python": last["python"],
            "machine": last["machine"],
            **last["versions"],
        },
    )


def _readable(node: Node) -> bool:
    """Return whether the values of a task can be read: networks need the library they ran on."""
    if not node.deep:
        return True
    try:
        node.learner.algorithm_class()
    except ImportError:
        return False
    return True
