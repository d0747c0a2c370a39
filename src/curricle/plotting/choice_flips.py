"""Flips drawn: where greedy choices became right or wrong, and how many did while learning went."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from curricle.checks import numbers, whole_number
from curricle.comparison.choice_flips import expected_visits, right_states
from curricle.errors import SettingError
from curricle.learning.budget import seed_tuple
from curricle.learning.learners import Learner
from curricle.learning.potential_rollouts import PairPotential
from curricle.learning.result import LearningResult
from curricle.learning.training import learn
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.planning.solution import solve
from curricle.plotting.figures import COLOURS, STYLE, draw_curve, new_figure
from curricle.plotting.grid_view import At, board
from curricle.plotting.scales import caption, steps_scale
from curricle.statistics.curves import Curve
from curricle.tasks.task import Task, generative_model, tables

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
MARKS = {1: ("^", "blue", "became right"), -1: ("v", "vermillion", "became wrong")}
"""Flip -> its marker, colour and name."""
FEW = 6
"""Cells a side up to which marks are large."""
FATES = (
    ("right", "black", "-"),
    ("became wrong", "vermillion", "--"),
    ("became right", "blue", ":"),
)
"""What becomes of states, and how its line looks."""


def draw_flips(axes: Axes, task: Task, flips: npt.ArrayLike, *, at: At | None = None) -> None:
    """Mark the states whose greedy choice became right (triangle up) or wrong (triangle down).

    Parameters
    ----------
    axes : Axes
    task : Task
        A :class:`GridWorld`, or one of whose states `at` leaves a cell free.
    flips : (S,) int array
        +1, -1 or 0, as :func:`curricle.comparison.choice_flips.flips` gives them.
    at : dict of str to int, str or (int, int), optional
        What the other components of the state are, as in :func:`draw_potential`.

    Raises
    ------
    SettingError
        When `flips` has another shape or holds other numbers, or the state is not one of a grid.

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
    shown = board(task, at)
    shown.draw(axes, over=False)
    for flip, (marker, colour, name) in MARKS.items():
        row, column = shown.cells[turned[shown.states] == flip].T
        label = f"{name}: {len(row)}"
        size = 10 if max(shown.shape) <= FEW else 7
        look: Any = {"color": COLOURS[colour], "mec": "w", "ms": size, "label": label, "zorder": 3}
        axes.plot(column + 0.18, row + 0.18, marker, **look)
    below: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.22 - 0.06 * bool(shown.words))}
    axes.legend(ncols=2, handletextpad=0.1, columnspacing=1, **below)


@dataclass(frozen=True, eq=False)
class _Fates:
    """Shares of the states at each time, (K, T) each, T counting the start."""

    right: FloatArray
    became_wrong: FloatArray
    became_right: FloatArray


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

    Left, the return over the steps of learning that starts with Q at phi. Middle and right, the
    share of states whose greedy choice is right, of those where it was at the start and is no
    longer, and of those where it has become so: every state that is no end counting alike, and
    counting as often as an episode of the optimal policy visits it.

    Parameters
    ----------
    task : Task
        That can be solved.
    potential : StateActionPotential or MappedPotential, or K of them
        phi; one for all seeds, or one for each.
    learner : Learner
    budget : int
        Steps.
    times : sequence of int
        Steps, 1 to `budget`, at which the choices are looked at, besides the start. Each is another
        learning with that budget, which gives exactly the values that the longer one had then.
    seeds : int or sequence of int
        K, or their numbers.
    evaluation : GreedyEvaluation, optional
        Of greedy policies; undiscounted by default, as the return while learning is.
    stream, workers
        As in :func:`learn`.

    Returns
    -------
    Figure

    Raises
    ------
    SettingError
        When a time is none within the budget, or as :func:`learn` and :func:`solve` do.

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
    looked = sorted({whole_number("each of times", time, 1, SettingError) for time in times})
    if not looked or looked[-1] > steps:
        raise SettingError(f"times must be steps from 1 to {steps:,}, at least one: got {times}")
    judge = GreedyEvaluation(discounted=False) if evaluation is None else evaluation
    numbered = seed_tuple(seeds)

    def learnt(so_far: int, judged: GreedyEvaluation, eval_freq: int | None) -> LearningResult:
        how: Any = {"seeds": numbered, "stream": stream, "workers": workers}
        return learn(
            task,
            learner,
            so_far,
            potential=potential,
            evaluation=judged,
            eval_freq=eval_freq,
            **how,
        )

    whole = learnt(steps, judge, None)
    optimal, at_start = solve(task, tolerance=1e-6), _start_values(potential, len(numbered))
    glance = GreedyEvaluation(method="rollouts", episodes=1)
    right = [_right(at_start, optimal.optimal)]
    for time in looked:
        values = whole.values if time == steps else learnt(time, glance, time).values
        right.append(_right(values, optimal.optimal))
    alive = (~tables(task).terminal).astype(float)
    weights = {
        "every state alike": alive,
        "by the visits of the optimal policy": expected_visits(task, optimal.policy),
    }
    return _draw_collapse(whole, [0, *looked], np.stack(right, axis=1), weights)


def _start_values(
    potential: PairPotential | Sequence[PairPotential], n_seeds: int
) -> list[FloatArray]:
    """Return what each seed's Q starts as, (S, A) each."""
    each = list(potential) if isinstance(potential, Sequence) else [potential] * n_seeds
    return [one.values for one in each]


def _right(tables_of_values: Any, optimal: BoolArray) -> BoolArray:
    """Return where each seed's greedy choice is right, (K, S)."""
    return np.stack([right_states(values, optimal) for values in tables_of_values])


def _fates(right: BoolArray, weight: FloatArray) -> _Fates:
    """Return the shares of the states, weighted, from where choices are right, (K, T, S)."""
    share, first = weight / weight.sum(), right[:, :1]
    return _Fates(right @ share, (first & ~right) @ share, (~first & right) @ share)


def _draw_collapse(
    whole: LearningResult, times: list[int], right: BoolArray, weights: dict[str, FloatArray]
) -> Figure:
    """Return the figure of a learning and of where choices are right, (K, T, S)."""
    figure, grid = new_figure(1, 3, width=10.5, height=3.6)
    returns, *shares = grid[0]
    _draw_returns(returns, whole, times)
    for axes, (name, weight) in zip(shares, weights.items(), strict=True):
        _draw_fates(axes, np.array(times), _fates(right, weight))
        axes.set_title(name)
    shares[1].sharey(shares[0])
    shares[0].set_ylabel("share of states")
    shares[1].legend(loc="center right")
    shares[0].set_ylim(bottom=0)
    for axes in grid[0]:
        unit = steps_scale(axes.xaxis, times[-1])
        axes.set(xlim=(0, times[-1]), xlabel=f"target steps{f' ({unit})' if unit else ''}")
    n = len(whole.seeds)
    bands = f"{n} seeds: means with nominal 95 % percentile bootstrap intervals at each point alone"
    caption(
        figure,
        f"{bands if n > 1 else 'One seed: no intervals'}. Right: every action with the highest "
        "value is optimal. Became: since the start, where values are φ. Grey lines and dots: the "
        "times looked at, each a learning of that many steps with the same random numbers.",
    )
    return figure


def _draw_returns(axes: Axes, whole: LearningResult, times: list[int]) -> None:
    """Draw the return while learning, and that of the greedy policy."""
    met = _held(whole.training_return[:, 1:])  # no episode has ended at checkpoint 0
    measured = ~np.isnan(met).any(axis=0)
    if measured.any():
        learning = Curve(whole.steps[1:][measured], met[:, measured])
        draw_curve(axes, learning, label="episodes while learning", colour="blue")
    draw_curve(axes, Curve.of(whole), label="greedy policy", colour="orange", dashes="--")
    for time in times:
        axes.axvline(time, color="#cccccc", lw=0.6, zorder=0)
    axes.legend(loc="best")
    axes.set(title="return", ylabel="return of an episode (sum of rewards)")


def _held(values: FloatArray) -> FloatArray:
    """Return (K, T) with the last value before it in each NaN; those that lead stay."""
    place = np.where(np.isnan(values), 0, np.arange(values.shape[1]))
    return np.take_along_axis(values, np.maximum.accumulate(place, axis=1), axis=1)


def _draw_fates(axes: Axes, times: npt.NDArray[np.int64], fates: _Fates) -> None:
    for (name, colour, dashes), values in zip(
        FATES, (fates.right, fates.became_wrong, fates.became_right), strict=True
    ):
        draw_curve(axes, Curve(times, values), label=name, colour=colour, dashes=dashes)
        axes.lines[-1].set(marker="o", markersize=3.5, clip_on=False)
