"""Pages of curricula that were compared in memory, without a folder between."""

from curricle.learning.stopping import ended_by
from curricle.report.page import ShownStudy, page_of
from curricle.study.analysis import analysed, curricula_record


def study_page(name, comparison, results, *, decisions=None, environment=None):
    """The page of arms by name; ``decisions`` are why trainings ended, for some of them."""
    curricula = {arm: result.curriculum for arm, result in results.items()}
    record, reasons = curricula_record(curricula, {}), {}
    learnt = {arm: result.nodes for arm, result in results.items()}
    for arm, nodes in learnt.items():
        for task, node in nodes.items():
            ended = curricula[arm].node(task)
            default = [
                rows[-1].criterion if rows else ended_by(ended.budget, full)
                for rows, full in zip(ended.decisions(node), node.out_of_memory, strict=True)
            ]
            reasons[arm, task] = (decisions or {}).get((arm, task)) or default
    study = ShownStudy(name, comparison, record, learnt, analysed(results, record), reasons)
    return page_of(study, environment or {})
