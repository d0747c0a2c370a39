"""Train a short pole with Stable-Baselines3, alone and after an easier, longer pole.

Run as ``python train.py RUNS``. Each run writes its evaluations and the Monitor files of its two
environments into RUNS/ARM/SEED. RUNS.csv has the evaluations of all runs in one table.
"""

import csv
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor

SOURCE, TARGET, EVAL_FREQ = 4096, 10_240, 512  # steps
EASY, HARD = 0.5, 0.1  # half the length of a pole
ARMS, SEEDS = ("scratch", "pretrained"), range(8)


def pole(half_length: float) -> gym.Env:
    """Return a cart with a pole of a length, in episodes of at most 200 steps."""
    env = gym.make("CartPole-v1", max_episode_steps=200)
    cart = env.unwrapped
    cart.length, cart.polemass_length = half_length, cart.masspole * half_length
    return env


def train(folder: Path, seed: int, pretrained: bool) -> None:
    """Train a network with one seed, and write its evaluations and its episodes."""
    torch.set_num_threads(1)  # as small networks are slower with several
    settings = {"n_steps": 256, "batch_size": 64, "seed": seed, "device": "cpu"}
    target = make_vec_env(lambda: pole(HARD), n_envs=2, seed=seed, monitor_dir=str(folder))
    first = make_vec_env(lambda: pole(EASY), n_envs=2, seed=seed) if pretrained else target
    model = PPO("MlpPolicy", first, **settings)
    if pretrained:
        model.learn(SOURCE).set_env(target)
    judged = Monitor(pole(HARD))
    judged.reset(seed=1000 + seed)
    evaluation = EvalCallback(
        judged, n_eval_episodes=3, eval_freq=EVAL_FREQ // 2, log_path=str(folder), verbose=0
    )
    model.learn(TARGET, callback=evaluation)
    target.close()  # and the files of its monitors


if __name__ == "__main__":
    runs, rows = Path(sys.argv[1]), [("arm", "seed", "step", "return")]
    for arm in ARMS:
        for seed in SEEDS:
            folder = runs / arm / str(seed)
            if not folder.exists():
                train(folder, seed, arm == "pretrained")
            with np.load(folder / "evaluations.npz") as file:
                means = file["results"].mean(axis=1).round(3)
                rows += [(arm, seed, *pair) for pair in zip(file["timesteps"], means, strict=True)]
    with runs.with_suffix(".csv").open("w", newline="") as table:
        csv.writer(table, lineterminator="\n").writerows(rows)
