"""How Curricle refuses what makes no sense: cases as data, and what holds of every message."""

import re

import pytest


def cases(tables):
    """Return a parameter for each case; tables are {exception: {name: (call, what it says)}}."""
    return [
        pytest.param(error, *case, id=f"{error.__name__}-{name}")
        for error, table in tables.items()
        for name, case in table.items()
    ]


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
