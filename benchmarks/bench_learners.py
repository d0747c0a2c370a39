"""Steps per second of `curricle.learn` beside a plain Gymnasium + NumPy Q-table loop.

Both do tabular Q-learning with epsilon-greedy exploration and random tie-breaking on the same
task, one after the other in turns; the median of the turns is printed, and their ratio.

    python benchmarks/bench_learners.py
"""

import platform
import time
from statistics import median

import gymnasium as gym
import numpy as np

import curricle as cr
from curricle.paper.settings import maze

LEARNER = cr.QLearning(learning_rate=0.1, epsilon=0.1)
TURNS = 5
STEPS = {"curricle": 2_000_000, "gymnasium": 50_000}


class TableEnv(gym.Env):
    """A finite MDP as a Gymnasium environment, as a user would write it."""

    def __init__(self, task):
        mdp = task.mdp
        self.mdp = mdp
        self.observation_space = gym.spaces.Discrete(mdp.states.size)
        self.action_space = gym.spaces.Discrete(mdp.actions.size)
        self.outcomes = mdp.probability.shape[1]
        self.state = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        starts = self.mdp.start_states
        self.state = int(starts[self.np_random.integers(len(starts))])
        return self.state, {}

    def step(self, action):
        row = self.mdp.outcome_row[self.state, action]
        outcome = 0
        if self.outcomes > 1:
            outcome = np.searchsorted(self.mdp.cumulative[row], self.np_random.random(), "right")
        self.state = int(self.mdp.next_state[row, outcome])
        reward = float(self.mdp.reward[row, outcome])
        return self.state, reward, bool(self.mdp.terminal[self.state]), False, {}


def plain_loop(task, steps):
    """Do what every tutorial does: one step of the environment, one update of the table."""
    env = gym.wrappers.TimeLimit(TableEnv(task), task.time_limit)
    q = np.zeros((env.observation_space.n, env.action_space.n))
    rng = np.random.default_rng(0)
    state, _ = env.reset(seed=0)
    for _ in range(steps):
        if rng.random() < 0.1:
            action = int(rng.integers(env.action_space.n))
        else:
            action = int(rng.choice(np.flatnonzero(q[state] == q[state].max())))
        following, reward, terminated, truncated, _ = env.step(action)
        target = reward + (0.0 if terminated else task.discount * q[following].max())
        q[state, action] += 0.1 * (target - q[state, action])
        state = env.reset()[0] if terminated or truncated else following


def compiled(task, steps):
    cr.learn(task, LEARNER, steps, every=steps, workers=1,
             evaluation=cr.GreedyEvaluation(method="rollouts", episodes=1))  # fmt: skip


def rate(run, task, steps):
    begin = time.perf_counter()
    run(task, steps)
    return steps / (time.perf_counter() - begin)


def main():
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}")
    print(f"{'task':<28}{'curricle':>16}{'gymnasium':>16}{'ratio':>10}   (steps a second)")
    tasks = {"maze 10x10": maze(-5), "pursuit 4x4, 2 predators": cr.Pursuit(4, 2)}
    for name, task in tasks.items():
        compiled(task, 1000)  # compiles, and builds the tables
        ours, theirs = [], []
        for _ in range(TURNS):
            ours.append(rate(compiled, task, STEPS["curricle"]))
            theirs.append(rate(plain_loop, task, STEPS["gymnasium"]))
        ratio = median(ours) / median(theirs)
        print(f"{name:<28}{median(ours):>16,.0f}{median(theirs):>16,.0f}{ratio:>9,.0f}x")


if __name__ == "__main__":
    main()
