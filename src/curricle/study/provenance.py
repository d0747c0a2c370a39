"""What a run was made with: versions, machine, commit, command, seeds."""

import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from curricle.study.config.study_config import StudyConfig

LIBRARIES = ("numpy", "numba", "llvmlite", "gymnasium", "pyarrow", "pydantic")
OF_NETWORKS = ("torch", "stable-baselines3", "sb3-contrib")
"""Optional libraries."""


def provenance(study: StudyConfig) -> dict[str, Any]:
    """Return versions, the machine, the commit of the study's file, the seeds and the command.

    Examples
    --------
    >>> found = provenance(StudyConfig.from_data(
    ...     {"name": "a", "seeds": [3], "arms": {"b": {"tasks": {"c": {"type": "maze",
    ...      "map": "ST"}}}}}, Path()))
    >>> found["seeds"], found["versions"]["numpy"] == metadata.version("numpy")
    ([3], True)
    """
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "seeds": list(study.seeds),
        "commit": commit(study.folder),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.release()} {platform.machine()}",
        "versions": dict(_versions()),
    }


def _versions() -> Iterator[tuple[str, str]]:
    """Yield the version of each library; those for networks where they are installed."""
    for name in ("curricle", *LIBRARIES):
        yield name, metadata.version(name)
    for name in OF_NETWORKS:
        with suppress(metadata.PackageNotFoundError):
            yield name, metadata.version(name)


def commit(folder: Path) -> str | None:
    """Return the Git commit a folder is at, marked if files differ; None if it is in none."""
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
