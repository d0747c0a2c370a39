"""FrozenLake 8x8 from the 4x4 lake, with three mappings, and from itself without slipping.

The cells of the 4x4 lake can be mapped to the 8x8 lake goal to goal, start to start, or each to
four. On slippery ice values depend on the holes nearby, and the 4x4 lake has its holes elsewhere.
The dry 8x8 lake has the same map, and no move slips.

Measured over 20 seeds, with the source's steps charged, steps until half the episodes reach the
goal: 120,000 from scratch, 47,000 from the dry lake, 82,000 from the 4x4 lake goal to goal, 81,000
one for four, and 103,000 start to start. These arms have the portfolio that is the default. Without
it one for four does harm (5 seeds never get there), and the dry lake, whose values are too high for
ice and are halved, needs 35,000 instead of 47,000. In its 10,000 steps the dry lake is learnt in
none of the 20 seeds, and the table says so.

None of them pays. Values above 0 make the learner explore, and that is most of what sources do
here: one value everywhere, the mean of a mapping's, gains more than any mapping of the 4x4 lake,
and the optimistic learner is there after 13,400 steps.

python examples/frozen_lake.py
"""

from dataclasses import replace

import curricle as cr

ARMS = {
    "goal to goal": ("small", lambda row, column: (row - 4, column - 4), 1.0),
    "start to start": ("small", lambda row, column: (row, column), 1.0),
    "one for four": ("small", lambda row, column: (row // 2, column // 2), 1.0),
    "dry": ("dry", lambda row, column: (row, column), 1.0),
    "dry, halved": ("dry", lambda row, column: (row, column), 0.5),
}
LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)
OPTIMISTIC = cr.QLearning(learning_rate=0.1, epsilon=0.1, initial_value=1.0)


def main(seeds=20, steps=200_000, source_steps=10_000):
    lake = cr.from_gymnasium("FrozenLake8x8-v1", discount=0.99)
    sources = {
        "small": cr.from_gymnasium("FrozenLake-v1", discount=0.99),
        "dry": cr.from_gymnasium("FrozenLake8x8-v1", discount=0.99, is_slippery=False),
    }

    def curriculum(source, cell, scale):
        def moved(state, action):
            row, column = cell(state["row"], state["column"])
            return {"row": row, "column": column}, action

        mapping = cr.from_function(lake, sources[source], moved)
        return cr.Curriculum(
            tasks={source: sources[source], "lake": lake},
            transfers=[cr.Transfer(source, "lake", mapping, scale=scale)],
            learner={source: OPTIMISTIC, "lake": LEARNER},
            budget={source: source_steps, "lake": steps},
            evaluation=cr.GreedyEvaluation(discounted=False),
        )

    arms = {name: curriculum(*arm) for name, arm in ARMS.items()}
    for name in ("one for four", "dry, halved"):
        arms[f"{name}, no portfolio"] = replace(arms[name], shaping=cr.QInitialisation())
    # Half the episodes reach the goal; at best, in 200 steps, 9 in 10 do.
    print("Greedy return is the share of episodes that reach the goal.")
    print(cr.compare(arms, seeds=seeds, threshold=0.5))


if __name__ == "__main__":
    main()
