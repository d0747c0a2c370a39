"""Examples and tests of deep learners need Stable-Baselines3: without it they are left out."""

from importlib.util import find_spec

DEEP = ["src/curricle/deep/*.py", "docs/howto/your_own_network.md", "tests/deep/test_*.py"]

collect_ignore_glob = [] if find_spec("stable_baselines3") else DEEP
