"""What Curricle costs a deep learner, compared with the same learner without it.

Part A is what shaping adds to a step: Gymnasium's wrapper and the vector environments of
Stable-Baselines3, whose steps are counted per sub-environment, with tables (FrozenLake-v1) and
with the values of a DQN's network of two layers of 64 (CartPole-v1). Contestants take turns and
are measured in processor time; what is printed is the median over the turns: microseconds a step,
how many of them are more than the plain environment's in the same turn, and the ratio of the two.
Actions are random; resets and the checks at the end of an episode are part of it.

Part B is what a residual costs DQN, acting and learning: plain DQN and DQN on phi + residual take
turns to continue learning, exploring in one step of twenty, phi from tables (three predators on 7x7
read one on 7x7; of 125 actions the residual reads Phi(s) alone, unless set to read all of phi) and
from the network of an easier car.

Part C is what a pull towards a source's policy and the shaping of rewards cost PPO, acting and
learning in CartPole, where an environment's step costs next to nothing: networks of two layers of
128, the source of the same size.

Part D is what the compiled view saves PPO, acting and learning, in a level of MiniGrid: with
MiniGrid's own view, and with the compiled one that tasks have.

    python benchmarks/deep_overhead.py [--quick] [--turns N] [--view]

With --view part D alone.
"""

from functools import partial
from statistics import median

import gymnasium as gym
import numpy as np
import torch
from bench_shaping_wrapper import BAR, lake, potential, report, stepping
from networks.pursuit import SIZE, places_and_ways, read_alone
from stable_baselines3 import DQN
from stable_baselines3.common.vec_env import DummyVecEnv
from timing import arguments, in_turns, on_one_thread

import curricle as cr
from curricle.deep.models import model_for
from curricle.deep.networks import NetworkValues
from curricle.deep.vec_env import ShapedVecEnv
from curricle.interop import MiniGridFullView, MiniGridView
from curricle.interop.potential_shaping import PotentialShaping

COUNTS = 1, 8, 64  # sub-environments
TABLE, TABLES, NETWORK = "one table", "two tables", "a network's V"


def cart():
    return gym.make("CartPole-v1")


def stepping_many(venv, steps):
    """Return the rate, steps of sub-environments a second, at which they are stepped at random."""
    shape = max(steps // venv.num_envs, 1), venv.num_envs
    actions = np.random.default_rng(0).integers(venv.action_space.n, size=shape)

    def run():
        venv.seed(0)
        venv.reset()
        for row in actions:
            venv.step(row)

    return on_one_thread(run, actions.size)


def shaping(turns, steps):
    """Part A: print what shaping adds to a step; return what missed the bar."""
    phi = potential()
    tables = {TABLE: phi, TABLES: {"one": phi, "two": phi}}
    network = {NETWORK: NetworkValues(DQN("MlpPolicy", cart(), buffer_size=1).policy)}
    missed = []

    def compare(title, plain, shaped, step):
        print(f"\n{title}")
        contestants = {"plain": plain, **shaped}
        more = report({name: partial(step, env, steps) for name, env in contestants.items()}, turns)
        missed.extend(f"{title}, {name}" for name in tables if more.get(name, 0.0) > BAR)

    print(f"{'microseconds a step':<44}{'all':>12}{'more':>12}{'ratio':>9}\n{'-' * 77}")
    for make, potentials in (lake, tables), (cart, network):
        shape = partial(PotentialShaping, discount=0.99)
        shaped = {name: shape(make(), each) for name, each in potentials.items()}
        compare("PotentialShaping", make(), shaped, stepping)
        for n in COUNTS:
            shape = partial(ShapedVecEnv, discount=0.99)
            shaped = {
                name: shape(DummyVecEnv([make] * n), each) for name, each in potentials.items()
            }
            compare(f"ShapedVecEnv of {n}", DummyVecEnv([make] * n), shaped, stepping_many)
    return missed


RESIDUAL_BAR = 1.3  # times the wall time of plain DQN
READING_ALL = "all of phi"  # a wider network, to which the bar does not apply


def hunt():
    """Return a task of three predators and the potential of one, as tables."""
    task = cr.observation_task(
        "Curricle/Pursuit-v0", discount=0.95, encode=places_and_ways,
        size=SIZE, predators=3, observation="components",
    )  # fmt: skip
    chase, table = cr.Pursuit(SIZE, 1), cr.transfer.TableValues(np.zeros((SIZE**4, 5)))
    edges = [cr.Transfer("chase", "hunt", read_alone(task, chase, which)) for which in range(3)]
    return task, cr.transfer.ObservationPotential(task, edges, [table] * 3, cr.minimum)


def car():
    """Return a car and the potential of another car's network."""
    task = cr.observation_task("MountainCar-v0", discount=0.98)
    network = NetworkValues(DQN("MlpPolicy", "MountainCar-v0", buffer_size=1).policy)
    return task, cr.transfer.ObservationPotential.of(task, network)


def learning(task, potential, envs, settings, reads):
    """Return a function that continues a DQN for some steps and returns the steps a second."""
    network = {"learning_starts": 100, "policy_kwargs": {"net_arch": [128, 128], **reads}}
    learner = cr.deep.DeepLearner("DQN", envs=envs, settings=network | settings)
    model = model_for(task, learner, shaping=cr.QInitialisation(potential), steps=10_000)
    model.learn(1_000)
    on = partial(model.learn, reset_num_timesteps=False)
    return lambda steps: on_one_thread(partial(on, steps), steps)


def residual(turns, steps):
    """Part B: print what a residual costs; return what missed the bar."""
    missed = []
    print(
        f"\n{'microseconds a step of DQN':<44}{'plain':>12}{'residual':>12}{'ratio':>9}\n{'-' * 77}"
    )
    cases = {"three tables": hunt(), READING_ALL: hunt(), "a network": car()}
    for name, (task, phi) in cases.items():
        reads = {"reads": "actions"} if name == READING_ALL else {}
        for envs, often, gradients in (1, 4, 1), (1, 1, 1), (8, 1, 2):
            settings = {"train_freq": often, "batch_size": 64, "gradient_steps": gradients}
            sides = {"plain": (None, {}), "residual": (phi, reads)}
            learners = {
                side: partial(learning(task, potential, envs, settings, extra), steps)
                for side, (potential, extra) in sides.items()
            }
            rates = in_turns(learners, turns)
            ratio = median(a / b for a, b in zip(rates["plain"], rates["residual"], strict=True))
            plain, ours = (1e6 / median(rates[side]) for side in sides)
            case = f"{name}, envs {envs}, a gradient step every {envs * often // gradients}"
            print(f"{case:<44}{plain:>12.0f}{ours:>12.0f}{ratio:>9.2f}")
            missed += [case] * (ratio > RESIDUAL_BAR and not reads)
    return missed


PULL_BAR = 1.15  # times the processor time of plain PPO
PPO = cr.deep.DeepLearner(
    "PPO", envs=8,
    settings={
        "n_steps": 128, "batch_size": 256, "n_epochs": 4, "policy_kwargs": {"net_arch": [128, 128]},
    },
)  # fmt: skip


def actor_critics(turns, steps):
    """Part C: print what a source costs PPO; return what missed the bar."""
    task = cr.observation_task("CartPole-v1")
    source = NetworkValues(model_for(task, PPO, seed=1).policy)
    phi = cr.transfer.ObservationPotential.of(task, source)
    shapings = {
        "plain": None,
        "a pull": cr.deep.PolicyReuse(phi, kl=1.0),
        "shaped rewards": cr.StateShaping(phi),
    }
    learners = {name: partial(rollouts(task, one), steps) for name, one in shapings.items()}
    rates = in_turns(learners, turns)
    missed = []
    print(f"\n{'microseconds a step of PPO':<44}{'all':>12}{'ratio':>9}\n{'-' * 65}")
    for name, found in rates.items():
        ratio = median(a / b for a, b in zip(rates["plain"], found, strict=True))
        print(f"{name:<44}{1e6 / median(found):>12.0f}{ratio:>9.2f}")
        missed += [name] * (ratio > PULL_BAR)
    return missed


VIEW_BAR = 1.4  # times as fast as with MiniGrid's own view
LEVEL = "minigrid:MiniGrid-DoorKey-8x8-v0"
ENCODERS = {"MiniGridView": MiniGridView(), "MiniGridFullView": MiniGridFullView(8, 8)}


def views(turns, steps):
    """Part D: print what the compiled view saves PPO; return what missed the bar."""
    missed = []
    print(
        f"\n{'microseconds a step of PPO':<44}{'own':>12}{'compiled':>12}{'ratio':>9}\n{'-' * 77}"
    )
    for name, encode in ENCODERS.items():
        tasks = {
            side: cr.observation_task(LEVEL, encode=encode, compiled_view=side == "compiled")
            for side in ("own", "compiled")
        }
        learners = {side: partial(rollouts(task, None), steps) for side, task in tasks.items()}
        rates = in_turns(learners, turns)
        ratio = median(a / b for a, b in zip(rates["compiled"], rates["own"], strict=True))
        own, compiled = (1e6 / median(rates[side]) for side in tasks)
        print(f"{name:<44}{own:>12.0f}{compiled:>12.0f}{ratio:>9.2f}")
        missed += [name] * (ratio < VIEW_BAR)
    return missed


def rollouts(task, shaping):
    """Return a function that lets a PPO learn for some steps and returns the steps a second."""
    model = model_for(task, PPO, shaping, seed=2)

    def run(steps):
        # Of a budget so large that the pull stays strong.
        model.learn(1_000_000, callback=lambda told, _: told["self"].num_timesteps < steps)

    return lambda steps: on_one_thread(partial(run, steps), steps)


def main():
    parser = arguments(__doc__)
    parser.add_argument("--view", action="store_true", help="part D alone")
    given = parser.parse_args()
    torch.set_num_threads(1)
    turns = given.turns or (5 if given.quick else 15)
    missed = views(turns, steps=2_048)
    verdict = f"MISSED by {', '.join(missed)}" if missed else "ok"
    print(f"\nbar: {VIEW_BAR:g} times as fast as with MiniGrid's own view: {verdict}")
    if given.view:
        return
    missed = shaping(turns, 2_000 if given.quick else 10_000)
    verdict = f"MISSED by {', '.join(missed)}" if missed else "ok"
    print(f"\nbar: {BAR:g} us more a step with tables: {verdict}")
    missed = residual(turns, steps=200)
    verdict = f"MISSED by {', '.join(missed)}" if missed else "ok"
    print(f"\nbar: {RESIDUAL_BAR:g} times plain DQN's time: {verdict}")
    missed = actor_critics(turns, steps=2_048)
    verdict = f"MISSED by {', '.join(missed)}" if missed else "ok"
    print(f"\nbar: {PULL_BAR:g} times plain PPO's time: {verdict}")


if __name__ == "__main__":
    main()
