"""Gymnasium's environments as tasks, tasks as environments, and trackers of runs."""

import lazy_loader
from gymnasium.envs import registration

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_ENVIRONMENTS = {
    "Curricle/Maze-v0": "maze_environment",
    "Curricle/Pursuit-v0": "pursuit_environment",
}


def register() -> None:
    """Register Curricle's domains with Gymnasium, once; nothing heavy is imported before."""
    for name, maker in _ENVIRONMENTS.items():
        if name not in registration.registry:
            # No max_episode_steps: a task truncates its episodes at its own time limit.
            registration.register(name, f"curricle.interop.gymnasium:{maker}")
