"""Learning live in Gymnasium environments, beside the loop that every tutorial writes.

Both step the same environments, without evaluation; what is left of ours under "5 rollouts" is the
same with the default evaluation of live tasks, 5 episodes at each of 100 checkpoints. The bar is
that ours takes at most 1.3 times as long.

    python benchmarks/bench_live.py [--quick]
"""

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import gymnasium_loop
import numpy as np
from timing import LEARNER, Board, arguments, in_turns, on_one_thread

import curricle as cr

BAR = 1 / 1.3
DISCOUNT = 0.99
OFF = cr.GreedyEvaluation("off")
POLE = {
    "position": np.linspace(-2.4, 2.4, 7),
    "velocity": np.linspace(-3, 3, 7),
    "angle": np.linspace(-0.21, 0.21, 13),
    "spin": np.linspace(-3.5, 3.5, 13),
}
HILL = {"position": np.linspace(-1.2, 0.6, 21), "velocity": np.linspace(-0.07, 0.07, 21)}


@dataclass
class Contest:
    name: str
    environment: str
    made_with: dict[str, Any] = field(default_factory=dict)
    shape: tuple[int, ...] | None = None  # of the tutorial's table
    edges: dict[str, Any] | None = None

    def task(self):
        encode = cr.interop.Bins(self.edges) if self.edges else None
        horizon = {"discount": DISCOUNT, "live": True}
        return cr.from_gymnasium(self.environment, encode=encode, **horizon, **self.made_with)

    def tutorial(self, steps):
        env = gym.make(self.environment, **self.made_with)
        if self.edges is None:
            gymnasium_loop.q_learning(env, DISCOUNT, steps, self.shape)
            return
        inner = [edges[1:-1] for edges in self.edges.values()]
        shape = [len(edges) + 1 for edges in inner]

        def encode(observation):
            pairs = zip(observation, inner, strict=True)
            return tuple(int(np.digitize(value, edges)) for value, edges in pairs)

        gymnasium_loop.q_learning(env, DISCOUNT, steps, shape, encode)


CONTESTS = (
    Contest("FrozenLake 8x8, its table hidden", "FrozenLake-v1", {"map_name": "8x8"}),
    Contest("Blackjack", "Blackjack-v1", shape=(32, 11, 2)),
    Contest("CartPole in bins", "CartPole-v1", edges=POLE),
    Contest("MountainCar in bins", "MountainCar-v0", edges=HILL),
)


def contest(board, one, turns, steps):
    task = one.task()

    def ours(evaluation):
        return cr.learn(task, LEARNER, steps, evaluation=evaluation)

    cr.learn(task, LEARNER, 100, evaluation=OFF)  # compiles
    cr.learn(task, LEARNER, 100)
    rates = in_turns(
        {
            "off": lambda: on_one_thread(lambda: ours(OFF), steps),
            "5 rollouts": lambda: on_one_thread(lambda: ours(None), steps),
            "tutorial": lambda: on_one_thread(lambda: one.tutorial(steps), steps),
        },
        turns,
    )
    board.compare(f"{one.name} : tutorial", rates, "off", "tutorial", BAR)
    board.compare("  with 5 rollouts a checkpoint", rates, "5 rollouts", "tutorial")


def main():
    given = arguments(__doc__).parse_args()
    board = Board()
    for one in CONTESTS:
        contest(board, one, given.turns or 3, 20_000 if given.quick else 200_000)
    board.close()


if __name__ == "__main__":
    main()
