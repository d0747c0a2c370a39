"""Study files with mistakes in them: one sentence each, no other exception, and no endless wait."""

import contextlib
import importlib
import shutil
from collections import Counter

import pytest

from tests.durability.fuzzing import built, outcome, previewed
from tests.durability.study_mutations import STUDIES, mutated

FEW, MANY = 5, 250
"""Mutations of each study: every run of the tests builds a few, and `make slow` previews many as
``curricle check`` does."""


@pytest.fixture(scope="module", autouse=True)
def torch_loaded():
    """Load torch where it is installed: loading it takes nearly all memory that a study may take,
    and with less memory a library that it loads ends the interpreter."""
    with contextlib.suppress(ImportError):
        importlib.import_module("torch._dynamo")  # which torch's first optimizer loads


def folder_of(study, tmp_path):
    """Return a folder with the modules that a study names."""
    for module in study.parent.glob("*.py"):
        shutil.copy(module, tmp_path)
    return tmp_path


def outcomes(study, seeds, tmp_path, what):
    """Return how often each outcome came, and what is wrong with those that must not."""
    counts, bad = Counter(), []
    folder = folder_of(study, tmp_path)
    for seed in seeds:
        kind, why = outcome(mutated(study, seed), folder, what)
        counts[kind] += 1
        if kind in ("foreign", "hang") or (kind == "refused" and len(why) > 10_000):
            bad.append(f"{study.name}, seed {seed}: {kind}\n{why[-3000:]}")
    return counts, bad


def named(study):
    return f"{study.parent.name}/{study.stem}"


@pytest.mark.parametrize("study", STUDIES, ids=named)
def test_a_few_mistakes_are_refused(study, tmp_path):
    _, bad = outcomes(study, range(MANY, MANY + FEW), tmp_path, built)
    assert not bad, "\n".join(bad)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The system font")  # of pygame, where a mistake opens a window
@pytest.mark.parametrize("study", STUDIES, ids=named)
def test_every_mistake_is_refused_in_a_sentence(study, tmp_path):
    counts, bad = outcomes(study, range(MANY), tmp_path, previewed)
    print(study.name, dict(counts))
    assert not bad, f"{len(bad)} of {MANY}\n" + "\n".join(bad)
    assert counts["refused"] > MANY / 5
    assert counts["fine"] > MANY / 20
