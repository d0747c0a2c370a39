"""The parts of a figure, and the paper's mazes: figures 1 to 3 and reward hacking."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isnan
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import curricle as cr
from curricle.arrays import FloatArray, IntArray
from curricle.files import as_json
from curricle.learning import RewardBonus, StateShaping
from curricle.planning import greedy_policy, rollout
from curricle.progress import Bars
from curricle.show import COLOURS, content_of, draw_curve, draw_maze, draw_potential, new_figure
from curricle.statistics import Curve, Interval, Times, mean_interval, midpoint, time_to_threshold
from curricle.study import Progress as StudyProgress, StudyConfig, StudyResults
from curricle.text import counted
from curricle.transfer import relative_objects

HERE = Path(__file__).parent
MAP = (HERE / "maze.txt").read_text(encoding="utf-8")

Progress = Callable[[str], object]  # called with a message for each part of a figure

Verdict = Literal["reproduced", "not reproduced", "explained"]
INTERVAL = ("estimate", "low", "high")


@dataclass(frozen=True)
class Studies:
    """The paper's studies, which run only once; a stopped run goes on where it was."""

    folder: Path  # where their results are
    seeds: int
    workers: int | None
    bars: Bars
    say: Progress
    _run: dict[str, StudyResults] = field(default_factory=dict)

    def read(self, file: str, *changes: str) -> StudyConfig:
        """Return a study of the paper, with changes as `curricle run --set` takes them."""
        return cr.read_study(HERE / f"{file}.toml", set=[f"seeds={self.seeds}", *changes])

    def run(self, name: str, file: str, *changes: str) -> StudyResults:
        """Return the results of a study with changes, stored as `name`."""
        if name not in self._run:
            study = self.read(file, *changes)
            place = self.folder / f"{len(study.seeds)} seeds" / name
            how: Any = {"workers": self.workers, "progress": partial(self._show, name)}
            self._run[name] = cr.run_study(study, place, resume=True, **how)
            self.say(name)
        return self._run[name]

    def _show(self, name: str, progress: StudyProgress) -> None:
        """Show how many units of a study are stored."""
        begins = progress.stored is None
        grow = self.bars.bar(name, len(progress.units) if begins else None)
        if not begins:
            grow()


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, or an answer to one of its open questions, with the verdict."""

    id: str
    claim: str  # the statement
    setting: str  # where it was tested
    verdict: Verdict
    evidence: Mapping[str, Any]  # name -> number, text, or interval over seeds


@dataclass(frozen=True)
class FigureResult:
    """A figure with its caption, data, settings and claims."""

    name: str
    title: str
    caption: str
    figure: Figure
    tables: Mapping[str, Mapping[str, Any]]  # name -> column name -> values of one length
    claims: Sequence[Claim]
    settings: Mapping[str, str]

    def files(self, name: str) -> tuple[dict[str, bytes], dict[str, Any]]:
        """Return the files of the figure called `name`, and its section of the page."""
        files = {self.name + end: content_of(self.figure, end) for end in (".png", ".svg")}
        links = {"PNG": f"{self.name}.png"}
        for table, columns in self.tables.items():
            sink = pa.BufferOutputStream()
            pq.write_table(pa.table(dict(columns)), sink)
            links[f"{table}.parquet"] = f"data/{table}.parquet"
            files[f"data/{table}.parquet"] = sink.getvalue().to_pybytes()
        claims = [{"id": claim.id, "figure": name, **vars(claim)} for claim in self.claims]
        for claim in claims:
            claim["evidence"] = evidence = dict(claim["evidence"])
            for key, value in evidence.items():
                if isinstance(value, Interval):  # whose bounds may be NaN, which JSON has not
                    parts = {part: float(getattr(value, part)) for part in INTERVAL}
                    numbers = {part: None if isnan(x) else x for part, x in parts.items()}
                    evidence[key] = {**numbers, "seeds": value.n}
        section = {
            "title": self.title,
            "caption": self.caption,
            "image": f"{self.name}.svg",
            "settings": dict(self.settings),
            "claims": claims,
            "links": links,
        }
        files[f"data/{self.name}.json"] = as_json(section)
        return files, section


def maze(step: float) -> cr.GridWorld:
    """Return the paper's 10x10 maze; `step` is -1 in its text and -5 in its runs."""
    return cr.GridWorld(MAP, rewards=cr.Rewards(step=step), discount=0.99, time_limit=200)


def verdict(holds: object) -> Verdict:
    """Return the verdict on a claim that holds or does not."""
    return "reproduced" if holds else "not reproduced"


def answer(holds: object) -> Verdict:
    """Return the verdict on an open question that a control answers or does not."""
    return "explained" if holds else "not reproduced"


def whiskers(interval: Interval) -> list[list[Any]]:
    """Return an interval as distances below and above the estimate, for Matplotlib."""
    return [[interval.estimate - interval.low], [interval.high - interval.estimate]]


def draw_interval(
    panel: Axes, place: float, interval: Interval, colour: str, *, across: bool = False, **more: Any
) -> None:
    """Draw an interval as a dot with whiskers at a place of the horizontal axis, or `across`."""
    style: dict[str, Any] = {"color": colour, "fmt": "o", "ms": 5, "capsize": 2, **more}
    if across:
        panel.errorbar(interval.estimate, place, xerr=whiskers(interval), **style)
    else:
        panel.errorbar(place, interval.estimate, yerr=whiskers(interval), **style)


def in_thousands(panel: Axes) -> None:
    """Write the horizontal axis in thousands."""
    panel.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}")


def draw_level(panel: Axes, level: float, style: str = "-") -> None:
    """Draw a horizontal grey line, at a return to be reached or at 0."""
    panel.axhline(level, color=COLOURS["grey"], lw=0.8, ls=style)


def stacked(parts: Iterable[Mapping[str, npt.ArrayLike]]) -> dict[str, npt.NDArray[Any]]:
    """Return parts of a tidy table below each other; the columns of a part are broadcast."""
    names, columns = list[str](), list[list[npt.NDArray[Any]]]()
    for part in parts:
        names = list(part)
        columns.append([np.ravel(column) for column in np.broadcast_arrays(*part.values())])
    whole = [np.concatenate(column) for column in zip(*columns, strict=True)]
    return dict(zip(names, whole, strict=True))


# -- what the figures of mazes share ---------------------------------------------------------------

WINDOW = 10
SETTLED = 2_000
"""Steps before which the lowest value is ignored: an untrained agent that breaks ties at random
falls into pits; with the paper's first-index ties it never did."""

SETTINGS = {
    "learner": "Q-learning, learning rate 0.1, epsilon 0.1, Q0 = 0",
    "maze": "10x10, discount 0.99, episodes truncated at 200 steps",
    "budget": "250 source and 800 target episodes",
    "evaluation": "greedy return (sum of rewards), exact, every 100 steps, mean of 10 checkpoints",
    "threshold": "midway between the lowest (after 2,000 steps) and highest value of scratch",
    "shaping": "Q of the target starts as the source's (Wiewiora 2003)",
}


@dataclass(frozen=True)
class Arm:
    """A source of the maze against learning from scratch, in steps, for K seeds."""

    curve: Curve
    # (K,): target steps to the threshold, fewer than from scratch; upper bounds where not reached.
    saved: FloatArray
    cost: IntArray  # (K,): source steps
    reached: int  # seeds that reached the threshold

    @property
    def net(self) -> FloatArray:
        """Target and source steps to the threshold, scratch minus transfer, (K,)."""
        return self.saved - self.cost


@dataclass(frozen=True)
class Maze:
    """The study of the maze with one step reward."""

    study: StudyResults
    curve: Curve  # from scratch
    threshold: float  # return midway between the lowest and highest of the curve
    steps: FloatArray  # (K,) to the threshold, from scratch

    @classmethod
    def learnt(cls, studies: Studies, step: float) -> Self:
        """Return the maze learnt from scratch and from each of its corners."""
        study = studies.run(f"maze{step:g}", "maze", f"tasks.target.rewards.step={step}")
        curve = Curve.of(study.results["scratch"]["target"])
        threshold = midpoint(curve, window=WINDOW, after=SETTLED)
        return cls(study, curve, threshold, times(curve, threshold).steps)

    def arm(self, name: object) -> Arm:
        """Return the arm of the source called `name`."""
        cost = self.study.source_steps(str(name))
        curve = Curve.of(self.study.results[str(name)]["target"], cost)
        to_threshold = times(curve, self.threshold)
        saved = self.steps - to_threshold.steps
        return Arm(curve, saved, cost, int(to_threshold.reached.sum()))


def times(curve: Curve, threshold: float) -> Times:
    """Return the steps of each seed to a threshold, by the paper's smoothing."""
    return time_to_threshold(curve, threshold, window=WINDOW)


def curve_table(arms: dict[str, Curve]) -> dict[str, npt.NDArray[Any]]:
    """Return learning curves as a tidy table: arm, seed, steps, source_steps, greedy_return."""
    return stacked(
        {
            "arm": arm,
            "seed": np.arange(len(curve.values))[:, None],
            "steps": curve.steps,
            "source_steps": np.broadcast_to(curve.source_steps, len(curve.values))[:, None],
            "greedy_return": curve.values,
        }
        for arm, curve in arms.items()
    )


# -- figure 1: the target states that Svetlik's mapping covers (paper E4) ------------------------

SOURCE = ["..T", ".P.", "..."]
TARGETS = {
    "target A": ["...T..", "..P...", ".....F", ".F....", "......", "S....."],
    "target B": ["...T..", "...P..", ".....F", ".F....", "......", "S....."],
}


def figure1(studies: Studies) -> FigureResult:
    """Return figure 1, which needs no learning."""
    source = cr.GridWorld(SOURCE, start="uniform", representation="relative")
    figure, axes = new_figure(1, 3, width=9, height=3.4)
    draw_maze(axes[0, 0], source)
    axes[0, 0].set_title("source")
    parts, coverage = [], {}
    for panel, (name, text) in zip(axes[0, 1:], TARGETS.items(), strict=True):
        target = cr.GridWorld(text, representation="relative")
        mapping = relative_objects(target, source)
        matched = np.asarray((mapping.index >= 0).any(axis=1))
        coverage[name] = mapping.coverage()
        draw_maze(panel, target, marked=matched)
        free = ~target.mdp.terminal
        panel.set_title(f"{name}: {matched.sum()} of {free.sum()} states matched")
        row, column = target.cells.T
        parts.append({"target": name, "row": row, "column": column, "matched": matched})
    studies.say("coverage of Svetlik's mapping")
    return FigureResult(
        name="figure1",
        title="Figure 1: what Svetlik's mapping covers",
        caption="Framed: states of two targets that match a state of the source under the "
        "relative-position representation. T treasure, P pit, F fire. Target B differs in one "
        "pit, so the source matches nowhere and no state gets a value. Exact; nothing is "
        "sampled.",
        figure=figure,
        tables={"figure1": stacked(parts)},
        claims=[
            Claim(
                "f1.coverage",
                "Svetlik's mapping gives values only to target states in which all objects of the "
                "source have the same relative positions; a target can get none",
                "a 3x3 source with one pit, two 6x6 targets",
                verdict(coverage["target A"].mapped > 0 and coverage["target B"].mapped == 0),
                {name: str(cover) for name, cover in coverage.items()},
            )
        ],
        settings={"state": "positions of all objects relative to the agent (Svetlik et al. 2017)"},
    )


# -- figure 2: the maze with its optimal path, and learning it with and without transfer ---------

SIZE = 4
OPTIMUM = {-1.0: 114.6014, -5.0: -1.1773}  # v*(start) by step reward, computed independently


def figure2(studies: Studies) -> FigureResult:
    """Return figure 2."""
    arena = maze(-5)
    optimal = {step: cr.solve(maze(step)) for step in OPTIMUM}
    path = rollout(arena, optimal[-5.0].policy)
    scratch = Maze.learnt(studies, -5)
    curve = scratch.arm(SIZE).curve
    figure, axes = new_figure(1, 2, width=10, height=4.2)
    draw_maze(axes[0, 0], arena, path=path.states)
    axes[0, 0].set_title(f"an optimal path, {len(path)} moves")
    panel, label = axes[0, 1], f"from the top-right {SIZE}x{SIZE}"
    how: Any = {"window": WINDOW}
    strongly: Any = {"colour": "sky", "strong": True, "dashes": "--", **how}
    draw_curve(panel, scratch.curve, label="scratch", colour="black", **how)
    draw_curve(panel, curve, label=f"{label} (weak transfer)", colour="blue", **how)
    draw_curve(panel, curve, label="the same, source steps counted (strong)", **strongly)
    draw_level(panel, scratch.threshold, ":")
    where = 0, scratch.threshold
    panel.annotate("threshold", where, fontsize=8, color=COLOURS["grey"], va="bottom")
    panel.set(xlabel="steps", ylabel="greedy return (sum of rewards)", title="learning curves")
    panel.set(ylim=(-1700, 150), xlim=(0, None))
    panel.legend(loc="lower right")
    saved = scratch.steps - times(curve, scratch.threshold).steps
    weak, strong = mean_interval(saved), mean_interval(saved - curve.source_steps)
    right = all(abs(optimal[s].start_value - v) < 5e-5 for s, v in OPTIMUM.items())
    return FigureResult(
        name="figure2",
        title="Figure 2: the maze, with and without transfer",
        caption="Left: the maze (start lower left), step reward -5. Right: mean over "
        f"{counted(studies.seeds, 'seed')} with 95 % bands, moving mean of 10 checkpoints.",
        figure=figure,
        tables={"figure2": curve_table({"scratch": scratch.curve, "transfer": curve})},
        claims=[
            Claim(
                "f2.optimum",
                "The optimal path leads through the maze in 34 moves",
                "exact value iteration; discount 0.99",
                verdict(len(path) == 34 and right),
                {
                    "moves": len(path),
                    **{f"V*(start) at step reward {s:g}": optimal[s].start_value for s in OPTIMUM},
                    "error bound": max(solution.error_bound for solution in optimal.values()),
                },
            ),
            Claim(
                "f2.faster",
                "Transfer from a sub-maze reaches the threshold earlier",
                f"source of size {SIZE}, step reward -5; paired over seeds",
                verdict(weak.low > 0),
                {
                    "scratch, steps to threshold": mean_interval(scratch.steps),
                    "steps saved (weak transfer)": weak,
                    "steps saved (strong transfer)": strong,
                },
            ),
        ],
        settings={**SETTINGS, "step reward": "-5 (as run)", "source": f"top-right {SIZE}x{SIZE}"},
    )


# -- figure 3: steps saved by the size of the source, and the values that a small source learns --

SIZES = range(2, 11)  # size 1 is the treasure alone, without a state to learn in
STEP_REWARDS = {-5.0: "as run", -1.0: "as written"}
LONG = 150_000  # target steps of the arm "long", size 3: 800 episodes never reach the threshold
SAVED = "steps saved (thousands)"
Arms = Mapping[int | str, Arm]  # "fixed" is the full size with the target's own start


def figure3(studies: Studies) -> FigureResult:
    """Return figure 3."""
    mazes = {step: Maze.learnt(studies, step) for step in STEP_REWARDS}
    results: dict[float, Arms] = {
        step: {size: learnt.arm(size) for size in (*SIZES, "fixed", "long")}
        for step, learnt in mazes.items()
    }
    seeds = studies.seeds
    best: Any = mazes[-5.0].study.result("3", "source", values=True).values
    best = best.max(axis=2)  # (K, S')
    figure, axes = new_figure(2, 2, width=10, height=7.6)
    for panel, (step, shown) in zip(axes[0], results.items(), strict=True):
        _draw_saved(panel, shown, seeds, f"step reward {step:g} ({STEP_REWARDS[step]})")
    arena = maze(-5)
    path = arena.cells[rollout(arena, cr.solve(arena).policy).states]
    source = arena.crop(rows=(0, 3), columns=(7, 10), start="uniform")
    title = "the 3x3 source, and the target's optimal path"
    unit = "max Q of the source (return)"
    draw_potential(axes[1, 0], source, best.mean(axis=0), label=title, unit=unit)
    axes[1, 0].plot(path[:, 1], path[:, 0], "-", color=COLOURS["sky"], lw=2.5, clip_on=True)
    labels = []
    for x, (step, start) in enumerate((s, a) for s in results for a in (10, "fixed")):
        arm = results[step][start]
        for shift, values, colour in ((-0.2, arm.saved, "blue"), (0.2, arm.net, "orange")):
            mean = mean_interval(values / 1000)
            style: dict[str, Any] = {"color": COLOURS[colour], "capsize": 2}
            axes[1, 1].bar(x + shift, mean.estimate, 0.38, yerr=whiskers(mean), **style)
        labels.append(f"{'uniform' if start == 10 else 'fixed'} start\nstep {step:g}")
    draw_level(axes[1, 1], 0)
    title = "full-size source: weak (blue), strong (orange)"
    axes[1, 1].set(xticks=range(4), xticklabels=labels, ylabel=SAVED, title=title)
    rows, columns = source.cells.T
    table = stacked(
        {
            "step_reward": step,
            "size": 10 if size == "fixed" else size,
            "start": "map" if size == "fixed" else "uniform",
            "seed": np.arange(len(arm.saved)),
            "steps_saved": arm.saved,
            "source_steps": arm.cost,
        }
        for step, arms in results.items()
        for size, arm in arms.items()
        if size != "long"
    )
    corners = {"seed": np.arange(seeds)[:, None], "row": rows, "column": columns, "max_q": best}
    inside = (path[:, 0] < 3) & (path[:, 1] > 6)
    tuned = studies.run("tuned maze", "tuned").comparison
    visits = int(inside[0]) + int((inside[1:] & ~inside[:-1]).sum())
    return FigureResult(
        name="figure3",
        title="Figure 3: how large a source?",
        caption="Top: steps saved to the threshold by sources of size 1 to 10 (top-right corner, "
        f"uniform start), mean over {counted(seeds, 'seed')} and 95 % intervals; hollow: "
        "upper bounds, since some seeds never reached the threshold in 800 episodes. "
        "Size 1 holds no state to learn in. Bottom left: mean over seeds of max_a Q of the 3x3 "
        "source, with the target's optimal path, which leaves the corner and comes back. Bottom "
        "right: a full-size source with a uniform and with the target's fixed start.",
        figure=figure,
        tables={"figure3": table, "figure3_corner": stacked([corners])},
        claims=[
            *(claim for step in results for claim in _claims(step, results[step])),
            Claim(
                "f3.leaves-corner",
                "The optimal path leaves the 3x3 corner and comes back, so the source does not "
                "contain it",
                "exact; step reward -5",
                verdict(visits >= 2),
                {"times the path enters the corner": visits},
            ),
            Claim(
                "f3.tuned",
                "Open question: do sources pay where each arm, scratch too, has its best learning "
                "rate and level of Q, of 40 that were tried? None is shown to",
                f"step reward -5, {tuned.total:,} steps, source's counted; gain over best opponent",
                answer(all(verdict.direction <= 0 for verdict in tuned.verdicts.values())),
                {
                    f"{n}, steps to threshold": mean_interval(tuned.times(n).steps)
                    for n in tuned.arms
                }
                | {f"{n}, gain": contrast.strong_gain for n, contrast in tuned.contrasts.items()},
            ),
        ],
        settings=SETTINGS,
    )


def _draw_saved(panel: Axes, arms: Arms, seeds: int, title: str) -> None:
    for label, colour, shift, strong in (
        ("weak transfer", COLOURS["blue"], -0.1, False),
        ("strong transfer (source steps counted)", COLOURS["orange"], 0.1, True),
    ):
        panel.plot(1 + shift, 0, "o", color=colour, label=label, ms=5)
        for size in SIZES:
            mean = mean_interval((arms[size].net if strong else arms[size].saved) / 1000)
            filling = colour if arms[size].reached == seeds else "white"
            draw_interval(panel, size + shift, mean, colour, mfc=filling)
    draw_level(panel, 0)
    xlabel = "size of the source (cells a side)"
    panel.set(xlabel=xlabel, ylabel=SAVED, title=title, xticks=range(1, 11))
    panel.legend(loc="lower right")


def _claims(step: float, arms: Arms) -> list[Claim]:
    """Return the claims about the maze with one step reward."""
    setting = f"step reward {step:g} ({STEP_REWARDS[step]}), 800 target episodes"
    tag = STEP_REWARDS[step].replace(" ", "-")
    saved = {size: mean_interval(arms[size].saved) for size in SIZES}
    net = {size: mean_interval(arms[size].net) for size in SIZES}
    large = [saved[size] for size in range(4, 11)]
    mean = float(np.mean([s.estimate for s in large]))
    alike = all(s.low > 0 and abs(float(s.estimate) - mean) < mean / 3 for s in large)
    seeds = len(arms[3].saved)
    starts = dict[str, Any]()
    for start, arm in (("fixed", arms["fixed"]), ("uniform", arms[10])):
        starts[f"{start} start, target steps saved"] = mean_interval(arm.saved)
        starts[f"{start} start, source steps"] = mean_interval(arm.cost)
        starts[f"{start} start, net"] = mean_interval(arm.net)
    fixed, uniform = starts["fixed start, net"], starts["uniform start, net"]
    explained = fixed.low < 500 and uniform.low > max(0, fixed.high)
    explanation = (
        "Yes: with the target's own fixed start it gains nothing net, with a uniform start it does."
        if explained
        else "Not by these runs."
    )
    return [
        Claim(
            f"f3.size-3-hurts.{tag}",
            "A source of size 3 makes learning slower",
            setting,
            verdict(saved[3].high < 0),
            {
                "steps saved within 800 episodes (at most)": saved[3],
                "seeds that reached the threshold": f"{arms[3].reached} of {seeds}",
                f"steps saved when run on for {LONG:,} steps": mean_interval(arms["long"].saved),
                "seeds that reached it then": f"{arms['long'].reached} of {seeds}",
            },
        ),
        Claim(
            f"f3.large-alike.{tag}",
            "Sources of size 4 to 10 save about as much",
            setting,
            verdict(alike),
            {f"steps saved, size {size}": saved[size] for size in range(4, 11)},
        ),
        Claim(
            f"f3.strong-smaller.{tag}",
            "(Not counted in the paper.) With source steps counted the gains are smaller",
            setting,
            verdict(all(net[s].estimate < saved[s].estimate for s in SIZES)),
            {f"net steps saved, size {size}": net[size] for size in SIZES},
        ),
        Claim(
            f"f3.random-start.{tag}",
            "Open question: does random initialisation explain why a full-size source beats "
            f"learning from scratch? {explanation}",
            f"{setting}; full-size source, fixed against uniform start",
            answer(explained),
            starts,
        ),
    ]


# -- reward hacking, which the paper describes: a bonus that makes the agent loop for ever -------

CAP = 100
GRID = cr.GridWorld(
    ["S....", "..#..", "..#.T", ".....", "....."],
    rewards=cr.Rewards(step=-1, treasure=20),
    discount=0.95,
    time_limit=CAP,
)
STEPS = 30_000


def nearness() -> cr.StateActionPotential:
    """Return a hint of nearness: 4 at the treasure, half a point less with each cell."""
    treasure = next((row, column) for name, row, column in GRID.objects if name == "treasure")
    hint = 4 - abs(GRID.cells - treasure).sum(axis=1) / 2
    return cr.StateActionPotential(GRID, np.repeat(hint[:, None], GRID.actions.size, axis=1))


def hacking(studies: Studies) -> FigureResult:
    """Return the figure of reward hacking."""
    hint = nearness()
    arms: Any = {
        "no shaping": (None, "black"),
        "as a bonus": (RewardBonus(hint), "vermillion"),
        "as a potential": (StateShaping(hint), "green"),
    }
    summed = cr.GreedyEvaluation(discounted=False)
    how: Any = {"seeds": studies.seeds, "evaluation": summed, "workers": studies.workers}
    results = {}
    for name, (shaping, _) in arms.items():
        results[name] = cr.learn(GRID, cr.QLearning(epsilon=0.1), STEPS, shaping=shaping, **how)
        studies.say(f"reward hacking: {name}")
    figure, axes = new_figure(1, 3, width=11, height=3.6)
    for panel, name in zip(axes[0], ("as a bonus", "as a potential"), strict=False):
        episode = rollout(GRID, greedy_policy(results[name].values[0]))
        draw_maze(panel, GRID, path=episode.states)
        end = "reaches the treasure" if episode.terminated else "loops until truncated"
        panel.set_title(f"{name}: {end}")
    curves = {name: Curve.of(result) for name, result in results.items()}
    for name, curve in curves.items():
        draw_curve(axes[0, 2], curve, label=name, colour=arms[name][1])
    axes[0, 2].set(xlabel="steps", ylabel="greedy return, bonus not counted", title="true return")
    axes[0, 2].legend(loc="center right")
    final = {name: curve.values[:, -1] for name, curve in curves.items()}
    loops = (final["as a bonus"] <= -CAP).mean() > 0.9
    return FigureResult(
        name="hacking",
        title="Reward hacking: a bonus is not a potential",
        caption="The same hint, 'being near the treasure is good', added to the reward as a "
        "bonus and as a potential. Left and middle: the greedy policy of seed 0. Right: mean over "
        f"{counted(studies.seeds, 'seed')} with 95 % bands.",
        figure=figure,
        tables={"hacking": curve_table(curves)},
        claims=[
            Claim(
                "hacking.bonus-loops",
                "A reward that is not a potential difference can make the agent loop instead of "
                "finishing (E3); as a potential the same hint keeps the optimal policy",
                "5x5 grid, treasure 20, step -1, discount 0.95",
                verdict(loops and (final["as a potential"] > 0).all()),
                {f"final greedy return, {name}": mean_interval(v) for name, v in final.items()},
            )
        ],
        settings={
            "learner": "Q-learning, learning rate 0.1, epsilon 0.1",
            "budget": f"{STEPS:,} steps",
        },
    )
