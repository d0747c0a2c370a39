"""Reward hacking, which the paper describes: a bonus that makes the agent loop for ever."""

from typing import Any

import numpy as np

from curricle import GridWorld, Rewards, StateActionPotential, learn
from curricle.learning import RewardBonus, Shaping, StateShaping
from curricle.paper.maze_runs import curve_table
from curricle.paper.settings import (
    EPSILON,
    LEARNER,
    LEARNING_RATE,
    SUMMED,
    Claim,
    FigureResult,
    Progress,
    over_seeds,
    verdict,
)
from curricle.planning import greedy_policy, rollout
from curricle.plotting import draw_curve, draw_maze, new_figure
from curricle.statistics import Curve
from curricle.text_tables import counted

CAP = 100
MAZE = GridWorld(
    ["S....", "..#..", "..#.T", ".....", "....."],
    rewards=Rewards(step=-1, treasure=20),
    discount=0.95,
    time_limit=CAP,
)
STEPS = 30_000
COLOURS = {"no shaping": "black", "as a bonus": "vermillion", "as a potential": "green"}


def nearness() -> StateActionPotential:
    """Return a hint of nearness: 4 at the treasure, half a point less with each cell."""
    treasure = next((row, column) for name, row, column in MAZE.objects if name == "treasure")
    hint = 4 - abs(MAZE.cells - treasure).sum(axis=1) / 2
    return StateActionPotential(MAZE, np.repeat(hint[:, None], MAZE.actions.size, axis=1))


def build(seeds: int, workers: int | None, progress: Progress) -> FigureResult:
    """Return the figure of reward hacking."""
    hint = nearness()
    arms: dict[str, Shaping | None] = {
        "no shaping": None,
        "as a bonus": RewardBonus(hint),
        "as a potential": StateShaping(hint),
    }
    how: Any = {"seeds": seeds, "evaluation": SUMMED, "workers": workers}
    results = {}
    for name, shaping in arms.items():
        results[name] = learn(MAZE, LEARNER, STEPS, shaping=shaping, **how)
        progress(f"reward hacking: {name}")
    figure, axes = new_figure(1, 3, width=11, height=3.6)
    for panel, name in zip(axes[0], ("as a bonus", "as a potential"), strict=False):
        episode = rollout(MAZE, greedy_policy(results[name].values[0]))
        draw_maze(panel, MAZE, path=episode.states)
        end = "reaches the treasure" if episode.terminated else "loops until truncated"
        panel.set_title(f"{name}: {end}")
    curves = {name: Curve.of(result) for name, result in results.items()}
    for name, curve in curves.items():
        draw_curve(axes[0, 2], curve, label=name, colour=COLOURS[name])
    axes[0, 2].set(xlabel="steps", ylabel="greedy return, bonus not counted", title="true return")
    axes[0, 2].legend(loc="center right")
    final = {name: curve.values[:, -1] for name, curve in curves.items()}
    return FigureResult(
        name="hacking",
        title="Reward hacking: a bonus is not a potential",
        caption="The same hint, 'being near the treasure is good', added to the reward as a "
        "bonus and as a potential. Left and middle: the greedy policy of seed 0. Right: mean over "
        f"{counted(seeds, 'seed')} with 95 % bands.",
        figure=figure,
        tables={"hacking": curve_table(curves)},
        claims=(
            Claim(
                "hacking.bonus-loops",
                "A reward that is not a potential difference can make the agent loop instead of "
                "finishing (E3); as a potential the same hint keeps the optimal policy",
                "5x5 grid, treasure 20, step -1, discount 0.95",
                verdict(
                    (final["as a bonus"] <= -CAP).mean() > 0.9
                    and (final["as a potential"] > 0).all()
                ),
                {f"final greedy return, {name}": over_seeds(v) for name, v in final.items()},
            ),
        ),
        settings={
            "learner": f"Q-learning, learning rate {LEARNING_RATE}, epsilon {EPSILON}",
            "budget": f"{STEPS:,} steps",
        },
    )
