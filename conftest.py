"""Examples and tests that need an extra are left out where it is not installed."""

from importlib.util import find_spec

DEEP = ["src/curricle/deep/*.py", "docs/howto/your_own_network.md", "tests/deep/test_*.py"]
DASK = ["src/curricle/study/engines/dask_engine.py"]
RAY = ["src/curricle/study/engines/ray_engine.py"]
CLUSTER = ["tests/cluster/test_*.py"]
MINIGRID = ["docs/howto/your_own_network.md"]

collect_ignore_glob = [
    *([] if find_spec("stable_baselines3") else DEEP),
    *([] if find_spec("distributed") else [*DASK, *CLUSTER]),
    *([] if find_spec("ray") else RAY),
    *([] if find_spec("minigrid") else MINIGRID),
]
