"""Tabular Q-learning by others: each adapter does a peer's own Q-learning, in its own API.

An adapter takes a `FiniteMDP` and a number of steps and returns a function that learns and
returns (Q-table, steps taken): what is built before that function is returned is not timed.
Learning rate 0.1, epsilon 0.1, and episodes cut at 200 steps where the peer can. peers.txt says
how to install them; an adapter raises ImportError where its peer is not there.
"""

import os
import random
import time
from contextlib import redirect_stdout
from io import StringIO

import gymnasium_loop
import numpy as np
from numba import njit

os.environ["TQDM_DISABLE"] = "1"  # no progress bars among the figures
ALPHA, EPSILON, LIMIT = 0.1, 0.1, 200


# -- loops written for the purpose ---------------------------------------------------------------


@njit
def numba_loop(row_of, cumulative, successor, reward, terminal, start, discount, q, steps):
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
        row, outcome = row_of[state, action], 0
        if cumulative.shape[1] > 1:
            outcome = np.searchsorted(cumulative[row], np.random.random(), "right")  # noqa: NPY002
        following, length = successor[row, outcome], length + 1
        target = reward[row, outcome]
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
    tables = (mdp.outcome_row, mdp.cumulative, mdp.next_state, mdp.reward, mdp.terminal)

    def run(steps=steps):
        q = np.zeros(mdp.outcome_row.shape)
        numba_loop(*tables, mdp.start_states[0], mdp.discount, q, steps)
        return q, steps

    run(10)  # compiles
    return run


def python_lists(mdp, steps):
    row_of, cumulative = mdp.outcome_row.tolist(), mdp.cumulative.tolist()
    successor, pay = mdp.next_state.tolist(), mdp.reward.tolist()
    terminal, start, discount = mdp.terminal.tolist(), int(mdp.start_states[0]), mdp.discount
    n_actions = mdp.actions.size

    def run():
        q = [[0.0] * n_actions for _ in row_of]
        state, length = start, 0
        for _ in range(steps):
            values = q[state]
            if random.random() < EPSILON:
                action = int(random.random() * n_actions)
            else:
                action = values.index(max(values))
            row, outcome = row_of[state][action], 0
            if len(cumulative[row]) > 1:
                draw = random.random()
                outcome = sum(draw >= edge for edge in cumulative[row])
            following, target, length = successor[row][outcome], pay[row][outcome], length + 1
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
    """A scan over steps, mapped over seeds; a block's random numbers are drawn before it.

    The table is flat and read by slices: faster than `q[state]` and `q.at[...].add`, and than
    unrolling the scan or mapping over seeds with `lax.map`.
    """
    import jax
    import jax.numpy as jnp
    from jax.lax import dynamic_slice, dynamic_update_slice, scan

    n_states, n_actions = mdp.outcome_row.shape
    n_outcomes = mdp.cumulative.shape[1]
    rows = mdp.outcome_row.ravel()
    successor = jnp.asarray(mdp.next_state[rows].ravel(), jnp.int32)
    pay = jnp.asarray(mdp.reward[rows].ravel(), jnp.float32)
    cumulative = jnp.asarray(mdp.cumulative[rows], jnp.float32)
    ends, start = jnp.asarray(mdp.terminal)[successor], int(mdp.start_states[0])

    def step(carry, drawn):
        q, state, length = carry
        explore, choice, noise = drawn
        greedy = jnp.argmax(dynamic_slice(q, (state * n_actions,), (n_actions,)))
        pair = state * n_actions + jnp.where(explore < EPSILON, choice, greedy)
        arrival = pair if n_outcomes == 1 else pair * n_outcomes + (noise >= cumulative[pair]).sum()
        following = successor[arrival]
        best = dynamic_slice(q, (following * n_actions,), (n_actions,)).max()
        target = pay[arrival] + jnp.where(ends[arrival], 0.0, mdp.discount * best)
        q = dynamic_update_slice(q, (q[pair] + ALPHA * (target - q[pair]))[None], (pair,))
        over = ends[arrival] | (length + 1 == LIMIT)
        return (q, jnp.where(over, start, following), jnp.where(over, 0, length + 1)), None

    def learn_block(key, carry):
        one, two, three = jax.random.split(key, 3)
        choices = jax.random.randint(two, (block,), 0, n_actions)
        noise = jax.random.uniform(three, (block, 1 if n_outcomes > 1 else 0))
        return scan(step, carry, (jax.random.uniform(one, (block,)), choices, noise))[0]

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

    probability, reward, start = dense(mdp)
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
    taken = [0]

    def transition(state, action):
        taken[0] += 1
        return states[sample(mdp, state.data[0], action)]

    def reward(state, action, following):
        return paid(mdp, state.data[0], action, following.data[0])

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

    actions = list(range(mdp.actions.size))
    successors = {
        (s, a): DictDistribution(merged(mdp, s, a))
        for s in np.flatnonzero(~mdp.terminal).tolist()
        for a in actions
    }
    model = QuickTabularMDP(
        lambda s, a: successors[s, a],
        reward=lambda s, a, following: paid(mdp, s, a, following),
        actions=actions,
        initial_state=int(mdp.start_states[0]),
        is_absorbing=lambda s: bool(mdp.terminal[s]),
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


# -- what they are given -------------------------------------------------------------------------


def dense(mdp):
    """Return (S, A, S) probabilities and rewards, (S,) start; ended states' rows are empty."""
    shape = (*mdp.outcome_row.shape, mdp.states.size)
    probability, reward, start = np.zeros(shape), np.zeros(shape), np.zeros(mdp.states.size)
    for s in np.flatnonzero(~mdp.terminal):
        for a, row in enumerate(mdp.outcome_row[s]):
            np.add.at(probability[s, a], mdp.next_state[row], mdp.probability[row])
            reward[s, a, mdp.next_state[row]] = mdp.reward[row]
    start[mdp.start_states] = 1 / len(mdp.start_states)
    return probability, reward, start


def merged(mdp, state, action):
    """Return successor -> probability."""
    row, found = mdp.outcome_row[state, action], {}
    for following, p in zip(mdp.next_state[row].tolist(), mdp.probability[row], strict=True):
        found[following] = found.get(following, 0.0) + float(p)
    return {following: p for following, p in found.items() if p > 0}


def sample(mdp, state, action):
    row = mdp.outcome_row[state, action]
    draw = random.random() if mdp.cumulative.shape[1] > 1 else 0.0
    return int(mdp.next_state[row, np.searchsorted(mdp.cumulative[row], draw, "right")])


def paid(mdp, state, action, following):
    row = mdp.outcome_row[state, action]
    return float(mdp.reward[row, np.argmax(mdp.next_state[row] == following)])
