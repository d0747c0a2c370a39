"""Files that are either whole or absent."""

import os
import tempfile
from pathlib import Path
from urllib.parse import quote

PART = ".part"
"""Ending of a file being written; a killed run may leave one, which means nothing."""


def file_name(text: str) -> str:
    """Return a file name that no other text has, whatever characters there are in it.

    Examples
    --------
    >>> file_name("hunt 2"), file_name("../a")
    ('hunt 2', '%2E%2E%2Fa')
    """
    return quote(text, safe=" ").replace(".", "%2E")


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
