"""JSON files with their own checksum."""

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

DIGEST_BYTES = 16


def sealed(value: Mapping[str, Any]) -> bytes:
    """Return JSON with its own checksum."""
    return as_json({**value, "digest": digest_of(as_json(value))})


def unsealed(content: bytes) -> dict[str, Any] | None:
    """Return what ``sealed`` was called on; None if the content has changed since.

    Examples
    --------
    >>> unsealed(sealed({"seeds": [0, 1]})), unsealed(sealed({"seeds": 1}).replace(b"1", b"2", 1))
    ({'seeds': [0, 1]}, None)
    """
    try:
        found = json.loads(content)
        digest = found.pop("digest")
        whole = digest == digest_of(as_json(found))
    except (ValueError, AttributeError, TypeError, KeyError, IndexError, RecursionError):
        return None
    return dict(found) if whole else None


def parsed_json(content: bytes) -> Any:
    """Return the value of JSON; ValueError if it is none, or nested deeply.

    Examples
    --------
    >>> parsed_json(b"[1, 2]")
    [1, 2]
    """
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("it must be JSON that is not nested deeply") from None
    except ValueError as error:
        raise ValueError(f"it must be JSON: {error}") from None


def as_json(value: Any) -> bytes:
    """Return indented JSON, numbers of a list in one line."""
    text = json.dumps(value, indent=1)
    # Within a string there is no line break.
    text = re.sub(r"\[\n[-+.\deE,\s]+\]", lambda found: " ".join(found[0].split()), text)
    return f"{text}\n".encode()


def digest_of(content: bytes) -> str:
    """Return the checksum of a content."""
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).hexdigest()
