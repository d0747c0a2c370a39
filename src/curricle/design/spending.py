"""The ledger of what was trained: what a curriculum, a comparison or a forecast spent.

Steps are booked as these objects charge them. Sources that several arms of a comparison share are
charged to each of them; a search for mappings is charged to each seed.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from curricle.comparison.comparison import Comparison
from curricle.comparison.forecasts import Forecast
from curricle.comparison.trial import Trial
from curricle.curriculum.result import CurriculumResult
from curricle.design.ledger import Ledger
from curricle.errors import SettingError
from curricle.learning.result import LearningResult
from curricle.transfer.calibration import Calibration
from curricle.transfer.task_pair import search_steps

Spent = LearningResult | CurriculumResult | Comparison | Trial | Forecast


def ledger_of(
    spent: Spent, *, miniature: bool = False, prices: Mapping[str, float] | None = None
) -> Ledger:
    """Return the ledger of a result: its steps, over all seeds, under their classes.

    Parameters
    ----------
    spent : LearningResult, CurriculumResult, Comparison, Trial or Forecast
        - of a :class:`CurriculumResult` the steps of its targets are ``target``, those of all
          before them ``sources``, retraining and what was trained before included. Calibration is
          the first part of a task's steps, and booked apart;
        - of a :class:`Comparison` each arm costs its total budget, part of it sources. It does not
          say how many steps its evaluations took;
        - of a :class:`Trial` as of a comparison, and as a miniature where it was made on a smaller
          relative;
        - of a :class:`Forecast` its sources, the rollouts that calibrate its rows, and its trial.
    miniature : bool
        Whether it stands for something larger: all its steps are then ``miniatures``, but for those
        of rollouts.
    prices : dict of str to float, optional
        Of a step of each class, as in :class:`Ledger`.

    Raises
    ------
    SettingError
        When it is none of these.

    Examples
    --------
    >>> from curricle import Curriculum, GridWorld, Transfer, same_position
    >>> maze = GridWorld("S...T")
    >>> near = maze.crop(rows=(0, 1), columns=(2, 5))
    >>> edge = Transfer("near", "maze", same_position(maze, near))
    >>> plan = Curriculum({"near": near, "maze": maze}, [edge], budget={"near": 300, "maze": 900})
    >>> result = plan.train(seeds=2)
    >>> spent = ledger_of(result)
    >>> spent.steps["target"], spent.steps["sources"] - int(result.source_steps("maze").sum())
    (1800, 0)
    """
    steps = _steps(spent)
    ledger = Ledger(prices={} if prices is None else prices)
    if miniature or (isinstance(spent, Trial) and spent.relative):
        rollouts = steps.pop("evaluation", 0)
        return ledger.book(miniatures=sum(steps.values()), evaluation=rollouts)
    found = ledger.book(**steps)
    if isinstance(spent, Forecast) and spent.trial is not None:
        found += ledger_of(spent.trial, prices=prices)
    return found


def _steps(spent: Spent) -> dict[str, int]:
    """Return the steps of each class; those of a forecast's trial are left out."""
    if isinstance(spent, LearningResult):
        return {"target": _sum(spent.steps_used), "evaluation": _sum(spent.evaluation_steps)}
    if isinstance(spent, CurriculumResult):
        return _of_curriculum(spent)
    if isinstance(spent, Trial):
        return _of_comparison(spent.comparison)
    if isinstance(spent, Comparison):
        return _of_comparison(spent)
    if isinstance(spent, Forecast):
        played = {} if spent.perfect else spent.trained
        rows = [one for row in spent.rows for one in row.calibrations]
        sources = sum(_sum(one.steps_used) for one in played.values())
        return {"sources": sources, "calibration": _calibration(rows)}
    raise SettingError(
        "a ledger is made of the result of learning, a curriculum, a comparison, a trial or a "
        f"forecast: got {spent!r}"
    )


def _of_curriculum(result: CurriculumResult) -> dict[str, int]:
    plan = result.curriculum
    fitted = {name: _calibration(those) for name, those in result.calibrations.items()}
    found = dict.fromkeys(("target", "sources", "mapping_search", "calibration", "evaluation"), 0)
    for name, values in result.sources.items():
        kind = "target" if name in plan.last_tasks else "sources"
        # A result that was handed in says by itself what it took; its calibration is not known.
        extra = _sum(result.retrained[name].extra) if name in result.retrained else 0
        own = _sum(values.steps_used) - extra
        found[kind] += own - fitted.get(name, 0)
        found["sources"] += extra
    found["calibration"] = sum(fitted.values())
    trained = [one for one in plan.transfers if one.target in result.sources]
    seeds = len(next(iter(result.sources.values())).seeds) if result.sources else 0
    found["mapping_search"] = seeds * search_steps(trained)
    found["evaluation"] = sum(_sum(one.evaluation_steps) for one in result.nodes.values())
    return found


def _of_comparison(comparison: Comparison) -> dict[str, int]:
    arms = comparison.arms.values()
    sources = sum(_sum(arm.curve.source_steps) for arm in arms)
    total = comparison.total * comparison.seeds * len(comparison.arms)
    return {"target": total - sources, "sources": sources}


def _calibration(fitted: Iterable[Calibration]) -> int:
    return sum(one.steps for one in fitted)


def _sum(steps: Any) -> int:
    return int(steps.sum())
