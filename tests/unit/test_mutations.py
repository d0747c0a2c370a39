"""What `make mutations` changes is in the library, once, and its tests exist."""

import pytest

from tests.mutations import MUTATIONS, PACKAGE, ROOT


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_it_can_be_made(mutation):
    text = (ROOT / PACKAGE / mutation.file).read_text("utf-8")
    assert mutation.applied(text) != text
    for test in mutation.tests:
        file, _, name = test.partition("::")
        assert f"def {name.partition('[')[0]}" in (ROOT / file).read_text("utf-8")
