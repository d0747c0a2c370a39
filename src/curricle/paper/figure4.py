"""F4: pursuit. Two predators learn from one, as published and as stated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle import (
    UNMAPPED,
    Curriculum,
    Episodes,
    GreedyEvaluation,
    Pursuit,
    QInitialisation,
    QLearning,
    StoppingRule,
    Transfer,
    learn,
    maximum,
    mean,
    minimum,
    project,
    total,
)
from curricle.learning import Learner, LearningResult
from curricle.paper.pursuit_claims import claims
from curricle.paper.settings import (
    DISCOUNT,
    EPISODE_CAP,
    EPSILON,
    INVERSE_TEMPERATURE,
    LEARNER,
    LEARNING_RATE,
    FigureResult,
    Progress,
    in_thousands,
    stacked,
)
from curricle.plotting import draw_curve, new_figure
from curricle.statistics import Curve
from curricle.text_tables import counted
from curricle.transfer import StateActionMapping

TARGET_STEPS = 350_000
SOURCE_BUDGET = Episodes(2_000)
CHECKPOINTS = 35
PAPER_SEEDS = 5
AGGREGATES = {"max": maximum, "mean": mean, "min": minimum, "total": total}
COLOURS = {
    "scratch": "black",
    "source": "grey",
    "max": "vermillion",
    "mean": "blue",
    "min": "green",
    "total": "purple",
    "scale 0.5": "orange",
    "scale 1": "blue",
    "scale 2": "green",
}
SOFTMAX = QLearning(learning_rate=LEARNING_RATE, inverse_temperature=INVERSE_TEMPERATURE)
ROLLOUTS = GreedyEvaluation(method="rollouts", episodes=100, discounted=False)


@dataclass(frozen=True)
class Setting:
    """One way of running the experiment."""

    title: str
    hunt: Pursuit  # two predators, the target
    learner: Learner
    colocated: bool = True  # whether states in which the predators share a cell are mapped
    aggregates: tuple[str, ...] = tuple(AGGREGATES)  # to run at scale 1
    scratch: bool = True  # whether to learn from scratch too
    scales: tuple[float, ...] = ()  # of the source's Q, to run with the mean
    source_budget: Episodes | StoppingRule = SOURCE_BUDGET
    target_steps: int = TARGET_STEPS


def _hunt(size: int = 4, capture: Any = "all", **rules: Any) -> Pursuit:
    return Pursuit(
        size, 2, capture=capture, **{"discount": DISCOUNT, "time_limit": EPISODE_CAP, **rules}
    )


SETTINGS = {
    "as published": Setting(
        "as published: first touch ends, shared cells unmapped",
        _hunt(capture="as_published"),
        SOFTMAX,
        colocated=False,
    ),
    "as published, all mapped": Setting(
        "control: as published, but every state mapped",
        _hunt(capture="as_published"),
        SOFTMAX,
        scratch=False,
    ),
    "as stated": Setting("as stated: both must catch, every state mapped", _hunt(), SOFTMAX),
    "epsilon-greedy": Setting(
        "5x5, as stated, epsilon-greedy: mean of the source's Q, scaled",
        _hunt(5, discount=0.95, time_limit=100),
        LEARNER,
        aggregates=(),
        scratch=False,
        scales=(0.5, 1.0, 2.0),
        source_budget=StoppingRule(400_000),
        target_steps=400_000,
    ),
}


def mappings(setting: Setting) -> Sequence[StateActionMapping]:
    """Return f_1 and f_2 (paper E7), without the shared cells where the setting excludes them."""
    hunt = setting.hunt
    chase = Pursuit(hunt.size, 1, discount=hunt.discount, time_limit=hunt.time_limit)
    found = [project(hunt, chase, predator=name) for name in hunt.predator_names]
    if setting.colocated:
        return found
    where = hunt.states.decode()
    shared = where["predator_1"] == where["predator_2"]
    # In the published runs an unmapped pair was a vote for 0, in every aggregate.
    kept = [np.where(shared[:, None], UNMAPPED, f.index) for f in found]
    return [
        StateActionMapping(hunt, f.source, index, unmapped_value=0.0)
        for f, index in zip(found, kept, strict=True)
    ]


def run(
    setting: Setting, seeds: int, workers: int | None, progress: Progress
) -> dict[str, LearningResult]:
    """Return the training results of a setting by arm: scratch, source, one for each potential."""
    eval_freq, hunt, steps = setting.target_steps // CHECKPOINTS, setting.hunt, setting.target_steps
    arms = {}
    if setting.scratch:
        how: Any = {"eval_freq": eval_freq, "evaluation": ROLLOUTS, "stream": "hunt"}
        arms["scratch"] = learn(hunt, setting.learner, steps, seeds=seeds, workers=workers, **how)
        progress(f"{setting.title}: scratch")
    f = mappings(setting)
    plans = [(name, AGGREGATES[name], 1.0) for name in setting.aggregates]
    plans += [(f"scale {scale:g}", mean, scale) for scale in setting.scales]
    for name, aggregate, scale in plans:
        curriculum = Curriculum(
            tasks={"chase": f[0].source, "hunt": hunt},
            transfers=[Transfer("chase", "hunt", one, scale=scale) for one in f],
            aggregate=aggregate,
            learner=setting.learner,
            shaping=QInitialisation(),
            budget={"chase": setting.source_budget, "hunt": steps},
            eval_freq={"hunt": eval_freq, "chase": 2_000},
            evaluation=ROLLOUTS,
        )
        trained = {"chase": arms["source"]} if "source" in arms else {}
        result = curriculum.train(seeds, trained=trained, workers=workers)
        arms["source"], arms[name] = result["chase"], result["hunt"]
        progress(f"{setting.title}: {name}")
    return arms


def build(seeds: int, workers: int | None, progress: Progress) -> FigureResult:
    """Return figure 4."""
    results = {name: run(setting, seeds, workers, progress) for name, setting in SETTINGS.items()}
    few = min(seeds, PAPER_SEEDS)
    figure, axes = new_figure(len(SETTINGS), 2, width=11, height=3.4 * len(SETTINGS))
    for row, (name, arms) in zip(axes, results.items(), strict=True):
        for panel, count in zip(row, (few, seeds), strict=True):
            _draw(panel, arms, count, name)
            panel.set_title(f"{SETTINGS[name].title} ({counted(count, 'seed')})")
        row[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return FigureResult(
        name="figure4",
        title="Figure 4: pursuit, two predators learning from one",
        caption=f"{_panels(seeds)} "
        "Means over seeds with 95 % bands. Rows 1 to 3: greedy return (100 rollouts a checkpoint) "
        "on a 4x4 grid, softmax exploration; the source's own curve is over its own steps. Row 4: "
        "return of the training episodes on 5x5. Source steps are not counted here; the data and "
        "the evidence hold them. Returns below -10 are drawn on a logarithmic scale.",
        figure=figure,
        tables={"figure4": _table(results)},
        claims=tuple(claims(results, SETTINGS, mappings)),
        settings={
            "learner": f"Q-learning, learning rate {LEARNING_RATE}, softmax with inverse "
            f"temperature {INVERSE_TEMPERATURE} (row 4: epsilon-greedy, {EPSILON})",
            "tasks": "4x4 walls, five moves, discount 0.99, limit 200 (row 4: 5x5, 0.95, 100)",
            "budget": "2,000 source episodes, 350,000 target steps (row 4: 400,000 steps each)",
            "shaping": "Q of the target starts as phi (Wiewiora 2003)",
        },
    )


def _panels(seeds: int) -> str:
    """Return how many seeds the left and the right panels have, in words."""
    if seeds < PAPER_SEEDS:
        return f"Left and right: {counted(seeds, 'seed')}, where the paper has {PAPER_SEEDS}."
    return f"Left: {PAPER_SEEDS} seeds as in the paper; right: {counted(seeds, 'seed')}."


def _draw(panel: Any, arms: Mapping[str, LearningResult], count: int, setting: str) -> None:
    training = setting == "epsilon-greedy"
    for name, result in arms.items():
        if training and name == "source":
            continue
        curve = Curve(result.steps, result.greedy_return[:count])
        if training:  # no episode has ended at checkpoint 0
            curve = Curve(result.steps[1:], result.training_return[:count, 1:])
        draw_curve(panel, curve, label=name, colour=COLOURS[name])
    panel.set_yscale("symlog", linthresh=10, linscale=2)
    ticks = [-t for t in (1, 2, 3, 5, 7, 10, 20, 50, 100, 200)]
    panel.set_yticks(ticks, [str(t) for t in ticks])
    panel.set_yticks([], minor=True)
    low, high = panel.dataLim.intervaly
    panel.set_ylim(1.15 * low, min(-0.5, high + 1))
    in_thousands(panel)
    panel.set(xlabel="steps (thousands)", ylabel="training return" if training else "greedy return")


def _table(results: Mapping[str, Mapping[str, LearningResult]]) -> dict[str, npt.NDArray[Any]]:
    return stacked(
        {
            "setting": setting,
            "arm": arm,
            "seed": np.array(result.seeds)[:, None],
            "steps": result.steps,
            "source_steps": (arm not in ("scratch", "source")) * arms["source"].steps_used[:, None],
            "training_return": result.training_return,
            "greedy_return": result.greedy_return,
        }
        for setting, arms in results.items()
        for arm, result in arms.items()
    )
