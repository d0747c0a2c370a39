"""How Curricle refuses what makes no sense: cases as data, and what holds of every message."""

import os
import re

import pytest

KINDS_OF_NO_FILE = ("pipe", "folder", "device", "large")


def no_file(path, kind):
    """Put something in the place of a file that must not be read to its end."""
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "device":
            path.symlink_to("/dev/zero")
        case "large":
            path.touch()
            os.truncate(path, 2**34)  # 16 GB that take no place


def cases(tables):
    """Return a parameter for each case; tables are {exception: {name: (call, what it says)}}."""
    return [
        pytest.param(error, *case, id=f"{error.__name__}-{name}")
        for error, table in tables.items()
        for name, case in table.items()
    ]


def texts_of(value):
    """Yield a value, and each entry that it has, as a message shows them."""
    yield f"got {value!r}"
    for entry in value if isinstance(value, list | tuple | dict) else ():
        yield from texts_of(entry)


def check_values(error, call, wrong):
    """Hold each value of each argument, {name: values}, to be refused by a line that names it."""
    for name, values in wrong.items():
        for value in values:
            with pytest.raises(error) as caught:
                call(**{name: value})
            message = str(caught.value)
            assert type(caught.value) is error
            assert "\n" not in message
            assert any(text in message for text in (name, *texts_of(value))), (name, value, message)


def check_refusal(error, call, says):
    """Hold a call to raise this very exception, with one sentence in which a pattern is found."""
    with pytest.raises(error) as caught:
        call()
    assert type(caught.value) is error
    assert isinstance(caught.value, ValueError)
    message = str(caught.value)
    assert re.search(says, message), message
    assert "\n" not in message
    assert not re.search(r"\. |\.$", message.replace("# .:", "")), "one sentence, no full stop"
