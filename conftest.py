"""Examples and tests that need an extra are left out where it is not installed."""

from importlib.util import find_spec

DEEP = ["src/curricle/deep/*.py", "docs/howto/your_own_network.md", "tests/deep/test_*.py"]
MINIGRID = ["docs/howto/minigrid.md"]

collect_ignore_glob = [
    *([] if find_spec("stable_baselines3") else DEEP),
    *([] if find_spec("minigrid") else MINIGRID),
]
