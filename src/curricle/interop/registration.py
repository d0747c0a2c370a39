"""Curricle's own domains in Gymnasium's registry."""

from gymnasium.envs import registration

ENVIRONMENTS = {
    "Curricle/Maze-v0": "environment:MazeEnvironment",
    "Curricle/Pursuit-v0": "environment:PursuitEnvironment",
}


def register() -> None:
    """Register the ids of ``ENVIRONMENTS``, such as ``Curricle/Maze-v0``, once.

    Classes are imported when an environment is first made. No ``max_episode_steps`` is set: a task
    truncates its episodes at its own time limit.
    """
    for name, maker in ENVIRONMENTS.items():
        if name not in registration.registry:
            registration.register(name, f"curricle.interop.{maker}")
