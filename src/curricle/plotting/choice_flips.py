"""Figures of greedy choices that became right or wrong: where, and how many during training."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import numbers, whole_number
from curricle.comparison.choice_flips import expected_visits, right_states
from curricle.errors import SettingError
from curricle.learning.learners import Learner
from curricle.learning.potential_rollouts import PairPotential
from curricle.learning.result import LearningResult
from curricle.learning.seeds import seed_tuple
from curricle.learning.shaping import QInitialisation
from curricle.learning.training import learn
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.solution import solve
from curricle.plotting.grids import draw_view
from curricle.plotting.learning_curves import draw_curve
from curricle.plotting.scales import steps_scale
from curricle.plotting.styles import COLOURS, STYLE, caption, new_figure
from curricle.statistics.curves import Curve
from curricle.tasks.grid_view import At, GridView
from curricle.tasks.task import Task, generative_model, tables

MARKS = {1: ("^", "blue", "became right"), -1: ("v", "vermillion", "became wrong")}
"""Flip -> its marker, colour and name."""
FEW = 6
"""Cells a side up to which marks are large."""
SHARES = (
    ("right", "black", "-"),
    ("became wrong", "vermillion", "--"),
    ("became right", "blue", ":"),
)
"""Name, colour and dashes of the drawn shares of states."""


def draw_flips(axes: Axes, task: Task, flips: npt.ArrayLike, *, at: At | None = None) -> None:
    """Mark the states whose greedy choice became right (triangle up) or wrong (triangle down).

    Parameters
    ----------
    axes, task, at
        As in :func:`draw_potential`.
    flips : (S,) int array
        +1, -1 or 0, from :func:`curricle.comparison.flips`.

    Raises
    ------
    SettingError
        When `flips` has another shape or holds other numbers, or the states make no grid.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> axes = Figure().subplots()
    >>> draw_flips(axes, GridWorld(["S.", ".T"]), [1, -1, 1, 0])
    >>> [text.get_text() for text in axes.get_legend().get_texts()]
    ['became right: 2', 'became wrong: 1']
    """
    turned, n_states = numbers("flips", flips, SettingError), generative_model(task).states.size
    if turned.shape != (n_states,) or not np.isin(turned, (-1, 0, 1)).all():
        raise SettingError(
            f"flips must be +1, -1 or 0 for each of {n_states} states: got shape {turned.shape} "
            f"with values from {turned.min(initial=0):g} to {turned.max(initial=0):g}"
        )
    view = GridView.of(task, at)
    draw_view(axes, view)
    for flip, (marker, colour, name) in MARKS.items():
        row, column = view.cells[turned[view.states] == flip].T
        style: Any = {"ms": 10 if max(view.shape) <= FEW else 7, "mec": "w", "zorder": 3}
        style |= {"color": COLOURS[colour], "label": f"{name}: {len(row)}"}
        axes.plot(column + 0.18, row + 0.18, marker, **style)
    below: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.22 - 0.06 * bool(view.words))}
    axes.legend(ncols=2, handletextpad=0.1, columnspacing=1, **below)


@matplotlib.rc_context(STYLE)
def collapse_figure(
    task: Task,
    potential: PairPotential | Sequence[PairPotential],
    learner: Learner,
    budget: int,
    times: Sequence[int],
    *,
    seeds: int | Sequence[int] = 1,
    evaluation: GreedyEvaluation | None = None,
    stream: str = "",
    workers: int | None = None,
) -> Figure:
    """Return the figure of how a good start is lost: returns, and which choices stay right.

    Left, the return during training from Q = phi. Middle and right, the share of non-terminal
    states whose greedy choice is right, of those where it was at the start and no longer is, and
    of those where it has become so. In the middle all states count alike, on the right as often as
    an episode of the optimal policy visits them.

    Parameters
    ----------
    task : Task
        One that can be solved.
    potential : StateActionPotential or MappedPotential, or K of them
        phi, for all seeds or for each.
    learner : Learner
    budget : int
        Steps.
    times : sequence of int
        Steps, 1 to `budget`, at which the choices are examined, besides the start. Each is another
        training with that budget, which gives exactly the values that the longer one had then.
    evaluation : GreedyEvaluation, optional
        Of greedy policies; undiscounted by default, like the training return.
    seeds, stream, workers
        As in :func:`learn`.

    Raises
    ------
    SettingError
        When a time is outside the budget, and where :func:`learn` and :func:`solve` raise it.

    Examples
    --------
    >>> from curricle import GridWorld, QLearning, StateActionPotential
    >>> maze = GridWorld(["S..", "..T"])
    >>> phi = StateActionPotential(maze, np.full((6, 4), 300.0))
    >>> figure = collapse_figure(maze, phi, QLearning(), 1000, [100, 500, 1000], seeds=3)
    >>> [line.get_label() for line in figure.axes[1].lines]
    ['right', 'became wrong', 'became right']
    """
    steps = whole_number("a budget in steps", budget, 1, SettingError)
    checked = sorted({whole_number("each of times", time, 1, SettingError) for time in times})
    if not checked or checked[-1] > steps:
        raise SettingError(f"times must be steps from 1 to {steps:,}, at least one: got {times}")
    chosen = GreedyEvaluation(discounted=False) if evaluation is None else evaluation
    numbered = seed_tuple(seeds)
    potentials = list(potential) if isinstance(potential, Sequence) else [potential] * len(numbered)

    def learnt(so_far: int, evaluated: GreedyEvaluation, eval_freq: int | None) -> LearningResult:
        settings: Any = {"seeds": numbered, "stream": stream, "workers": workers}
        settings |= {"evaluation": evaluated, "eval_freq": eval_freq}
        shaping = [QInitialisation(phi) for phi in potentials]
        return learn(task, learner, so_far, shaping=shaping, **settings)

    whole = learnt(steps, chosen, None)
    cheapest = GreedyEvaluation(method="rollouts", episodes=1)
    examined: list[Any] = [[phi.values for phi in potentials]]
    examined += [learnt(time, cheapest, time).values for time in checked if time < steps]
    examined += [whole.values] * (checked[-1] == steps)
    optimal = solve(task)
    right = [[right_states(one, optimal.optimal) for one in values] for values in examined]
    weights = {
        "every state alike": (~tables(task).terminal).astype(float),
        "by the visits of the optimal policy": expected_visits(task, optimal.policy),
    }
    return _draw_collapse(whole, [0, *checked], np.stack(right, axis=1), weights)


def _draw_collapse(
    whole: LearningResult, times: list[int], right: BoolArray, weights: dict[str, FloatArray]
) -> Figure:
    """Return the figure of a training and of where choices are right, (K, T, S)."""
    figure, grid = new_figure(1, 3, width=10.5, height=3.6)
    returns, *shares = grid[0]
    _draw_returns(returns, whole, times)
    for axes, (name, weight) in zip(shares, weights.items(), strict=True):
        _draw_shares(axes, np.array(times), right, weight / weight.sum())
        axes.set_title(name)
    shares[1].sharey(shares[0])
    shares[0].set_ylabel("share of states")
    shares[1].legend(loc="center right")
    shares[0].set_ylim(bottom=0)
    for axes in grid[0]:
        steps_scale(axes, times[-1], "target steps")
    n = len(whole.seeds)
    bands = f"{n} seeds: means with Student's nominal pointwise 95 % intervals"
    caption(
        figure,
        f"{bands if n > 1 else 'One seed: no intervals'}. Right: every action with the highest "
        "value is optimal. Became: since the start, where values are φ. Grey lines and dots: the "
        "examined times, each a training of that many steps with the same random numbers.",
    )
    return figure


def _draw_returns(axes: Axes, whole: LearningResult, times: list[int]) -> None:
    """Draw the training return, and that of the greedy policy."""
    returns = whole.training_return[:, 1:]  # no episode has ended at checkpoint 0
    # Where none has ended since the last checkpoint, the value before stays.
    place = np.where(np.isnan(returns), 0, np.arange(returns.shape[1]))
    returns = np.take_along_axis(returns, np.maximum.accumulate(place, axis=1), axis=1)
    measured = ~np.isnan(returns).any(axis=0)
    if measured.any():
        training = Curve(whole.steps[1:][measured], returns[:, measured])
        draw_curve(axes, training, label="training episodes", colour="blue")
    draw_curve(axes, Curve.of(whole), label="greedy policy", colour="orange", dashes="--")
    for time in times:
        axes.axvline(time, color="#cccccc", lw=0.6, zorder=0)
    axes.legend(loc="best")
    axes.set(title="return", ylabel="return of an episode (sum of rewards)")


def _draw_shares(axes: Axes, times: IntArray, right: BoolArray, weight: FloatArray) -> None:
    """Draw the `SHARES` of states, weighted (S,), from where choices are right, (K, T, S)."""
    first = right[:, :1]
    for (name, colour, dashes), chosen in zip(
        SHARES, (right, first & ~right, ~first & right), strict=True
    ):
        draw_curve(axes, Curve(times, chosen @ weight), label=name, colour=colour, dashes=dashes)
        axes.lines[-1].set(marker="o", markersize=3.5, clip_on=False)
