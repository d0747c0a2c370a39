"""Curricle beside other ways of doing tabular Q-learning, each through its own API.

All learn W1, the paper's 10x10 maze, with learning rate 0.1 and epsilon 0.1, in episodes cut at 200
steps where the peer can. A peer that is not installed is skipped: peers.txt says which there are.
The last column is the greedy return of the peer's final table; the optimum is -1.177.

    python benchmarks/bench_peers.py [--quick] [--only NAME ...]
"""

import os
import random
import time
from contextlib import redirect_stdout
from functools import partial
from io import StringIO

import gymnasium_loop
import numpy as np
from numba import njit
from timing import GLIMPSE, LEARNER, Board, arguments, in_turns

import curricle as cr
from curricle.paper.mazes import maze

os.environ["TQDM_DISABLE"] = "1"  # no progress bars among the figures
ALPHA, EPSILON, LIMIT = 0.1, 0.1, 200
SINGLE = cr.Storage(dtype="float32")


def curricle(mdp, steps, seeds=1):
    settings = {"evaluation": GLIMPSE, "storage": SINGLE}
    cr.learn(mdp, LEARNER, 1000, **settings)  # compiles
    settings |= {"seeds": seeds, "eval_freq": 10_000, "workers": 1 if seeds == 1 else None}
    return lambda: (cr.learn(mdp, LEARNER, steps, **settings).values[0], steps * seeds)


# -- loops written for the purpose -----------------------------------------------------------------
#
# Each of the functions below takes a task and a number of steps, and returns a function that learns
# and returns (Q-table, steps taken): what is built before that function is returned is not timed.


@njit
def numba_loop(row_of, successor, reward, terminal, start, discount, q, steps):
    """The loop one writes first: it scans a row to act, and a row to bootstrap."""
    n_actions, state, length = q.shape[1], start, 0
    for _ in range(steps):
        if np.random.random() < EPSILON:  # noqa: NPY002  what Numba offers
            action = np.random.randint(n_actions)  # noqa: NPY002
        else:
            action = 0
            for other in range(1, n_actions):
                if q[state, other] > q[state, action]:
                    action = other
        row, length = row_of[state, action], length + 1
        following, target = successor[row, 0], reward[row, 0]
        if not terminal[following]:
            best = q[following, 0]
            for other in range(1, n_actions):
                best = max(best, q[following, other])
            target += discount * best
        q[state, action] += ALPHA * (target - q[state, action])
        if terminal[following] or length == LIMIT:
            state, length = start, 0
        else:
            state = following


def numba(mdp, steps):
    tables = mdp.outcome_row, mdp.next_state, mdp.reward, mdp.terminal

    def run(steps=steps):
        q = np.zeros(mdp.outcome_row.shape)
        numba_loop(*tables, mdp.start_states[0], mdp.discount, q, steps)
        return q, steps

    run(10)  # compiles
    return run


def python_lists(mdp, steps):
    successor, pay = gymnasium_loop.outcome_lists(mdp)
    terminal, start, discount = mdp.terminal.tolist(), int(mdp.start_states[0]), mdp.discount
    n_actions = mdp.actions.size

    def run():
        q = [[0.0] * n_actions for _ in successor]
        state, length = start, 0
        for _ in range(steps):
            values = q[state]
            if random.random() < EPSILON:
                action = int(random.random() * n_actions)
            else:
                action = values.index(max(values))
            following, target, length = successor[state][action], pay[state][action], length + 1
            if not terminal[following]:
                target += discount * max(q[following])
            values[action] += ALPHA * (target - values[action])
            if terminal[following] or length == LIMIT:
                following, length = start, 0
            state = following
        return np.array(q), steps

    return run


def gymnasium(mdp, steps):
    env = gymnasium_loop.table_env(mdp, LIMIT)
    return lambda: (gymnasium_loop.q_learning(env, mdp.discount, steps), steps)


def jax(mdp, steps, seeds=1, block=50_000):
    """Return a scan over steps, mapped over seeds; a block's random numbers are drawn before it.

    The table is flat and read by slices: faster than `q[state]` and `q.at[...].add`, and than
    unrolling the scan or mapping over seeds with `lax.map`.
    """
    import jax
    import jax.numpy as jnp
    from jax.lax import dynamic_slice, dynamic_update_slice, scan

    n_states, n_actions = mdp.outcome_row.shape
    rows = mdp.outcome_row.ravel()
    successor = jnp.asarray(mdp.next_state[rows].ravel(), jnp.int32)
    pay = jnp.asarray(mdp.reward[rows].ravel(), jnp.float32)
    ends, start = jnp.asarray(mdp.terminal)[successor], int(mdp.start_states[0])

    def step(carry, drawn):
        q, state, length = carry
        explore, choice = drawn
        greedy = jnp.argmax(dynamic_slice(q, (state * n_actions,), (n_actions,)))
        pair = state * n_actions + jnp.where(explore < EPSILON, choice, greedy)
        following = successor[pair]
        best = dynamic_slice(q, (following * n_actions,), (n_actions,)).max()
        target = pay[pair] + jnp.where(ends[pair], 0.0, mdp.discount * best)
        q = dynamic_update_slice(q, (q[pair] + ALPHA * (target - q[pair]))[None], (pair,))
        over = ends[pair] | (length + 1 == LIMIT)
        return (q, jnp.where(over, start, following), jnp.where(over, 0, length + 1)), None

    def learn_block(key, carry):
        one, two = jax.random.split(key)
        choices = jax.random.randint(two, (block,), 0, n_actions)
        return scan(step, carry, (jax.random.uniform(one, (block,)), choices))[0]

    whole = jax.jit(jax.vmap(learn_block))

    def run(blocks=-(-steps // block)):
        carry = (
            jnp.zeros((seeds, n_states * n_actions), jnp.float32),
            jnp.full(seeds, start, jnp.int32),
            jnp.zeros(seeds, jnp.int32),
        )
        for i in range(blocks):
            carry = whole(jax.random.split(jax.random.key(i), seeds), carry)
        return np.asarray(carry[0][0]).reshape(n_states, n_actions), blocks * block * seeds

    run(1)  # compiles
    return run


# -- libraries -----------------------------------------------------------------------------------


def mushroom_rl(mdp, steps):
    from mushroom_rl.algorithms.value import QLearning
    from mushroom_rl.core import Core
    from mushroom_rl.environments.finite_mdp import FiniteMDP
    from mushroom_rl.policy import EpsGreedy
    from mushroom_rl.utils.parameters import Parameter

    shape = *mdp.outcome_row.shape, mdp.states.size
    probability, reward, start = np.zeros(shape), np.zeros(shape), np.zeros(mdp.states.size)
    state, action = np.nonzero(np.tile(~mdp.terminal, (mdp.actions.size, 1)).T)
    row = mdp.outcome_row[state, action]  # those of states that end stay empty
    probability[state, action, mdp.next_state[row, 0]] = 1.0
    reward[state, action, mdp.next_state[row, 0]] = mdp.reward[row, 0]
    start[mdp.start_states] = 1.0
    env = FiniteMDP(probability, reward, start, mdp.discount, LIMIT)
    agent = QLearning(env.info, EpsGreedy(Parameter(EPSILON)), Parameter(ALPHA))

    def run():
        Core(agent, env).learn(n_steps=steps, n_steps_per_fit=1, quiet=True)
        return np.array(agent.Q.table), steps

    return run


def simple_rl(mdp, steps):
    time.clock = time.perf_counter  # gone from Python since 3.8, called by simple_rl
    with redirect_stdout(StringIO()):  # it prints what else is not installed
        from simple_rl.agents import QLearningAgent
        from simple_rl.mdp import MDP, State
        from simple_rl.run_experiments import run_single_agent_on_mdp

    states = [State([s], is_terminal=bool(end)) for s, end in enumerate(mdp.terminal)]
    successor, pay = gymnasium_loop.outcome_lists(mdp)
    taken = [0]

    def transition(state, action):
        taken[0] += 1
        return states[successor[state.data[0]][action]]

    def reward(state, action, following):
        return pay[state.data[0]][action]

    actions = list(range(mdp.actions.size))
    model = MDP(actions, transition, reward, states[int(mdp.start_states[0])], mdp.discount)
    agent = QLearningAgent(actions, alpha=ALPHA, gamma=mdp.discount, epsilon=EPSILON)

    def run():
        taken[0] = 0
        while taken[0] < steps:
            run_single_agent_on_mdp(agent, model, episodes=10, steps=LIMIT)
        q = [[agent.get_q_value(state, action) for action in actions] for state in states]
        return np.array(q), taken[0]

    return run


def msdm(mdp, steps):
    from msdm.algorithms.tdlearning import QLearning, TDLearningEventListener
    from msdm.core.distributions import DictDistribution
    from msdm.core.mdp.quickmdp import QuickTabularMDP

    successor, pay = gymnasium_loop.outcome_lists(mdp)
    after = [[DictDistribution({s: 1.0}) for s in of_state] for of_state in successor]
    ends = mdp.terminal.tolist()
    model = QuickTabularMDP(
        lambda s, a: after[s][a],
        reward=lambda s, a, following: pay[s][a],
        actions=list(range(mdp.actions.size)),
        initial_state=int(mdp.start_states[0]),
        is_absorbing=lambda s: ends[s],
        discount_rate=mdp.discount,
    )

    class Count(TDLearningEventListener):
        def __init__(self):
            self.steps = 0

        def end_of_timestep(self, local_vars):
            self.steps += 1

        def end_of_episode(self, local_vars):
            pass

        def results(self):
            return self.steps

    def run():  # it knows no time limit, and W1 takes some 20 steps an episode
        learner = QLearning(steps // 20, ALPHA, EPSILON, seed=0, event_listener_class=Count)
        found = learner.train_on(model)
        q = np.zeros(mdp.outcome_row.shape)
        for s, values in found.q_values.items():
            q[s] = list(values.values())
        return q, found.event_listener_results

    return run


def bettermdptools(mdp, steps):
    from bettermdptools.algorithms.rl import RL

    env = gymnasium_loop.table_env(mdp, LIMIT)
    taken, step = [0], env.env.step
    rates = {"init_alpha": ALPHA, "min_alpha": ALPHA}
    rates |= {"init_epsilon": EPSILON, "min_epsilon": EPSILON}

    def counted(action):
        taken[0] += 1
        return step(action)

    env.env.step = counted

    def run():
        taken[0] = 0
        learner = RL(env)
        q, *_ = learner.q_learning(gamma=mdp.discount, n_episodes=steps // 30, seed=0, **rates)
        return q, taken[0]

    return run


def table_rl(mdp, steps):
    from table_rl.explorers import ConstantEpsilonGreedy
    from table_rl.learners import QLearning
    from table_rl.step_size_schedulers import ConstantStepSize

    env = gymnasium_loop.table_env(mdp, LIMIT)
    n_states, n_actions = mdp.outcome_row.shape
    explorer = ConstantEpsilonGreedy(EPSILON, n_actions)

    def run():
        agent = QLearning(n_states, n_actions, ConstantStepSize(ALPHA), explorer, mdp.discount)
        state, _ = env.reset(seed=0)
        for _ in range(steps):
            state, reward, terminated, truncated, _ = env.step(agent.act(state, True))
            agent.observe(state, reward, terminated, truncated, True)
            if terminated or truncated:
                state, _ = env.reset()
        return agent.q, steps

    return run


# -- the table -----------------------------------------------------------------------------------


def versus(board, what, mdp, ours, prepare, turns, bar=None, clock=time.process_time):
    """Print the ratio to a peer, or why there is none."""
    try:
        theirs = prepare()
        tables = []

        def rate(run):
            begin = clock()
            q, steps = run()
            seconds = clock() - begin
            tables.append(q)
            return steps / seconds

        rates = in_turns({"ours": lambda: rate(ours), "theirs": lambda: rate(theirs)}, turns)
    except ImportError as error:
        board.skip(what, f"not installed ({error})")
    except Exception as error:  # a peer that does not work here is no reason to stop
        board.skip(what, f"failed ({type(error).__name__}: {error})")
    else:
        note = f"{greedy_return(mdp, tables[-1]):.3f}"
        board.compare(what, rates, "ours", "theirs", bar, note)


def greedy_return(mdp, q):
    """Return what the first best action earns."""
    state, total, weight = int(mdp.start_states[0]), 0.0, 1.0
    for _ in range(mdp.time_limit):
        row = mdp.outcome_row[state, np.argmax(q[state])]
        total += weight * mdp.reward[row, 0]
        state, weight = mdp.next_state[row, 0], weight * mdp.discount
        if mdp.terminal[state]:
            break
    return total


# Peer, steps a turn (enough to learn W1), bar.
ONE_THREAD = (
    (numba, 5_000_000, 3),
    (python_lists, 500_000, None),
    (gymnasium, 50_000, None),
    (msdm, 50_000, 900),
    (simple_rl, 50_000, 1000),
    (table_rl, 50_000, 1000),
    (mushroom_rl, 50_000, 1000),
    (bettermdptools, 80_000, 1000),
)
SEEDS = 30


def main():
    known = [peer.__name__ for peer, *_ in ONE_THREAD] + ["jax"]
    parser = arguments(__doc__)
    parser.add_argument("--only", nargs="*", choices=known, default=known, help="these peers")
    given = parser.parse_args()
    turns = given.turns or (2 if given.quick else 3)
    steps = 1_000_000 if given.quick else 10_000_000
    board, mdp = Board(), maze(-5).mdp
    ours = curricle(mdp, steps)
    for peer, few, bar in ONE_THREAD:
        if peer.__name__ in given.only:
            versus(board, peer.__name__, mdp, ours, partial(peer, mdp, few), turns, bar)
    for seeds, bar in ((1, None), (SEEDS, 5)) if "jax" in given.only else ():
        what = f"jax, {seeds} seed{'s' if seeds > 1 else ''}, wall time"
        ours = curricle(mdp, steps // min(seeds, 10), seeds)
        theirs = partial(jax, mdp, steps // min(seeds, 10) // 5, seeds)
        versus(board, what, mdp, ours, theirs, turns, bar, time.perf_counter)
    board.close()


if __name__ == "__main__":
    main()
