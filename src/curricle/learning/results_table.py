"""What tasks learnt as a table and as curves, for a notebook."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from curricle.array_types import FloatArray
from curricle.display import curves, table
from curricle.statistics.curves import seed_line
from curricle.statistics.intervals import mean_interval

HEAD = ("learner", "seeds", "steps a seed", "episodes a seed", "first return", "last return")


def learnt_table(results: Mapping[str, Any], ended: Mapping[str, str]) -> Markup:
    """Return a row for each task's LearningResult, and in words what ended its learning."""
    rows = [(name, *_row(one), ended.get(name, "")) for name, one in results.items()]
    words = ["ended by"] * any(ended.values())
    shown = [row if words else row[:-1] for row in rows]
    return table(["task", *HEAD, *words], shown, wide=words)


def _row(result: Any) -> tuple[Any, ...]:
    learner = "" if result.learner is None else type(result.learner).__name__
    steps, episodes = result.steps_used.mean(), result.episodes_used.mean()
    first, last = (str(mean_interval(result.greedy_return[:, i])) for i in (0, -1))
    returns = [text.rsplit(",", 1)[0] for text in (first, last)]
    return (learner, len(result.seeds), f"{steps:,.0f}", f"{episodes:,.0f}", *returns)


def shown_returns(result: Any) -> tuple[str, FloatArray]:
    """Return the name and the returns, (K, T), of what is shown: without evaluation of training."""
    if np.isnan(result.greedy_return).all():
        return "training return", result.training_return
    return "greedy return", result.greedy_return


def learnt_curve(result: Any) -> Markup:
    """Return the greedy return over steps, mean over seeds; without evaluation that of training."""
    named, values = shown_returns(result)
    return curves([seed_line("", result.steps, values)], "steps", named)
