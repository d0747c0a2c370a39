"""Deep learners need Stable-Baselines3: without it these tests are left out."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("stable_baselines3") else ["test_*.py"]
