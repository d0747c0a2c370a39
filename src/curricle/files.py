"""Files that are either whole or absent."""

import os
import tempfile
from pathlib import Path

PART = ".part"
"""Ending of a file being written; a killed run may leave one, which means nothing."""


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place and move it there when it is complete.

    Examples
    --------
    >>> place = Path(tempfile.mkdtemp()) / "a.txt"
    >>> write_whole(place, b"whole")
    >>> place.read_bytes()
    b'whole'
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=PART)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # the name must not come before the content
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
