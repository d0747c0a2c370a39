"""Every example runs, at reduced size."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_draws(path, tmp_path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    example.main(tmp_path / "picture.png", seeds=2)
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_there_are_examples():
    assert EXAMPLES
