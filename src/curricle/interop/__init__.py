"""Other people's worlds: Gymnasium, both ways, and trackers of runs."""

import lazy_loader
from gymnasium.envs import registration

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_ENVIRONMENTS = {
    "Curricle/Maze-v0": "MazeEnvironment",
    "Curricle/Pursuit-v0": "PursuitEnvironment",
}


def register() -> None:
    """Register Curricle's domains with Gymnasium, once; classes are imported when first made."""
    for name, maker in _ENVIRONMENTS.items():
        if name not in registration.registry:
            # No max_episode_steps: a task truncates its episodes at its own time limit.
            registration.register(name, f"curricle.interop.gymnasium:{maker}")
