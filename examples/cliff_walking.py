"""CliffWalking from a cliff a third as wide, with four mappings.

The target is 12 columns wide, the source 4. The source's columns are mapped to those at the goal's
end, to those at the start's end, or each to three columns. Values are the steps left to the goal,
so they are right at the goal's end; the other columns are unmapped there, and their value 0 is too
high unless it is set to -8. At the start's end the goal seems near, and the way to it leads over
the cliff. In the stretched mapping a step of the source stands for three, and so does its cost.

Measured over 20 seeds, with the source's 600 steps charged: learning from scratch finds a greedy
policy without detours after 13,500 steps, the goal's end with -8 elsewhere after 6,100, and the
stretched mapping after 8,900. The other two save nothing. None of them pays: the optimistic learner
finds such a policy after 1,900 steps, without a source. A cliff as short as this needs no
curriculum; the example shows what mappings do.

python examples/cliff_walking.py
"""

import numpy as np

import curricle as cr

DISCOUNT, LIMIT = 0.99, 200
MOVES = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}
WIDE, NARROW, ROWS = 12, 4, 4
NEAR_OPTIMAL = -15.0
"""Return that counts as learnt; the best is -13."""


def cliff(columns):
    """Return the walk along a cliff of this width; Gymnasium's has 12 columns."""
    start, goal = (ROWS - 1) * columns, ROWS * columns - 1

    def outcome(state, down, right):
        row, column = divmod(state, columns)
        row, column = min(max(row + down, 0), ROWS - 1), min(max(column + right, 0), columns - 1)
        if row == ROWS - 1 and 0 < column < columns - 1:
            return [(1.0, start, -100.0)]
        return [(1.0, row * columns + column, -1.0)]

    return cr.FiniteMDP.from_outcomes(
        [[outcome(s, *move) for move in MOVES.values()] for s in range(ROWS * columns)],
        terminal=np.arange(ROWS * columns) == goal,
        start=start,
        discount=DISCOUNT,
        time_limit=LIMIT,
        states=cr.Space([cr.Component("row", ROWS), cr.Component("column", columns)]),
        actions=cr.Space([cr.Component("move", 4, labels=tuple(MOVES))]),
    )


def main(seeds=20, steps=20_000, source_steps=600):
    wide = cr.from_gymnasium("CliffWalking-v1", discount=DISCOUNT, time_limit=LIMIT)
    # The source is the same task except for its width.
    assert cr.comparison.differences(wide, cliff(WIDE)) == ()
    narrow = cliff(NARROW)

    def curriculum(column, scale=1.0, elsewhere=0.0):
        def shifted(state, action):
            return {"row": state["row"], "column": column(state["column"])}, action

        mapping = cr.from_function(wide, narrow, shifted, unmapped_value=elsewhere)
        return cr.Curriculum(
            tasks={"narrow": narrow, "wide": wide},
            transfers=[cr.Transfer("narrow", "wide", mapping, scale=scale)],
            learner=cr.QLearning(learning_rate=0.1, epsilon=0.1),
            # Exactly as long in each arm, which then differ in the mapping alone.
            budget={"narrow": cr.StoppingRule(source_steps), "wide": steps},
            evaluation=cr.GreedyEvaluation(discounted=False),
        )

    cut = WIDE - NARROW
    arms = {
        "goal's end": curriculum(lambda column: column - cut),
        "goal's end, -8 elsewhere": curriculum(lambda column: column - cut, elsewhere=-8.0),
        "start's end": curriculum(lambda column: column),
        "stretched": curriculum(lambda column: column * NARROW // WIDE, scale=WIDE / NARROW),
    }
    print(cr.compare(arms, seeds=seeds, threshold=NEAR_OPTIMAL))


if __name__ == "__main__":
    main()
