"""A choice among arms that are all alike says that one pays in no more than its share of cases."""

import numpy as np

import curricle as cr
from curricle.comparison import choice
from curricle.comparison.comparison import Comparison, comparison_plan
from curricle.comparison.measures import Arm, Reference
from curricle.comparison.plan import Memory
from curricle.statistics.curves import SCRATCH, Curve

REPEATS, ARMS = 200, 12
MOST = 12  # of 200 with probability .025 each (one side of .05): 13 or more in one of 700


def test_equal_arms_seldom_pay():
    maze = cr.GridWorld("S..T")
    near = maze.crop(rows=(0, 1), columns=(2, 4))
    edge = cr.Transfer("near", "maze", cr.same_position(maze, near))
    plan = cr.Curriculum({"near": near, "maze": maze}, [edge], budget={"near": 10, "maze": 1_000})
    names = [f"c{n}" for n in range(ARMS)]
    of_all = comparison_plan(dict.fromkeys(names, plan), Memory())
    steps = np.arange(of_all.steps[1] // of_all.eval_freq + 1) * of_all.eval_freq
    rng = np.random.default_rng(0)

    def play(plan, seeds, title):
        arms = {}
        for name in plan.arms:
            flat = rng.normal(size=(len(seeds), 1)) + np.zeros(len(steps))
            curve = Curve(steps, flat, np.zeros(len(seeds), np.int64))
            arms[name] = Arm(curve, scratch=name == SCRATCH)
        return Comparison(plan.target, arms, *plan.steps, Reference(0.0), 1)

    pay = sum(bool(choice.chosen(of_all, play).name) for _ in range(REPEATS))
    assert pay <= MOST
