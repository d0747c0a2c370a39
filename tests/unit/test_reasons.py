"""Why a curriculum pays: by what it knows, or by its optimism alone."""

import numpy as np
import pytest

from curricle.comparison import Comparison
from curricle.comparison.controls import Level
from curricle.comparison.verdicts import ASKING
from tests.comparisons import flat

NOISE = 0.1 * np.random.default_rng(5).permutation(12)


def level_of(mean, base=0.0, constant=True):
    return Level(np.full(12, mean), base, constant)


def compared(pays, constant, *, placebo=None, level=4.0, base=0.0):
    """A comparison of an arm that gains `pays` with constants that gain as much as `constant`."""
    arms = {"scratch": flat(NOISE[::-1]), "mean": flat(pays + NOISE)}
    if constant is not None:
        arms["mean, constant mean"] = flat(
            constant + np.roll(NOISE, 1), True, level=level_of(level, base)
        )
    if placebo is not None:
        values = placebo + np.roll(NOISE, 3)
        arms["mean, placebo"] = flat(values, True, level=level_of(level, None, constant=False))
    return Comparison("maze", arms, 10, 10, 0.5, 1)


@pytest.mark.parametrize(
    ("pays", "constant", "level", "reason"),
    [
        (10.0, 4.0, 4.0, "by what it knows"),
        (10.0, 10.0, 4.0, "by optimism alone"),
        (10.0, 11.0, 4.0, "by optimism alone"),
        (10.0, 11.0, -4.0, "by pessimism alone"),
        (10.0, 9.6, 4.0, "nearly all by optimism"),
        (10.0, 8.5, 4.0, "by what it knows"),  # 15 % of the gain is more than nothing
        (0.7, 0.65, 4.0, "not shown to be by what it knows"),
        (-3.0, -5.0, 4.0, ""),
        (-3.0, 5.0, 4.0, ""),
    ],
)
def test_a_reason_goes_no_further_than_what_was_shown(pays, constant, level, reason):
    found = compared(pays, constant, level=level)
    contrast = found.contrasts["mean"]
    assert contrast.reason == reason
    assert contrast.verdict == ("pays" if pays > 0 else "costs more than it brings")
    line = str(found).split("\n")[3]
    assert line.endswith(f"), {reason}" if reason else ")")
    assert found.rows()[1]["reason"] == reason


def test_the_cheaper_way_is_named_with_its_number():
    found = compared(10.0, 10.0, level=4.25, base=2.0)
    gain = found.contrasts["mean, constant mean"].strong_gain
    assert str(found).split("\n")[-1] == (
        "cheaper than mean: initial_value=6.25 without any source, which is its constant mean and "
        f"gains +{gain.estimate:.1f} [{gain.low:.1f}, {gain.high:.1f}]"
    )


@pytest.mark.parametrize(
    "found",
    [
        compared(10.0, 4.0),  # it knows more than that
        compared(10.0, 10.0, base=None),  # a constant is no initial value there
        compared(-3.0, 5.0),  # it does not pay: then its controls are no way to its gain
        compared(10.0, None, placebo=11.0),
    ],
    ids=["knowledge", "no initial value", "does not pay", "no constant"],
)
def test_otherwise_no_cheaper_way_is_named(found):
    assert "cheaper" not in str(found)


@pytest.mark.parametrize("placebo", [None, 3.0])
def test_a_placebo_alone_does_not_tell_knowledge_from_optimism(placebo):
    found = compared(10.0, None, placebo=placebo)
    assert found.contrasts["mean"].answer == "pays"
    assert found.reasons["mean"].why == "not asked"
    assert str(found).split("\n")[-1] == (
        f"by what it knows, or by optimism alone? Not asked: {ASKING}"
    )
    assert "Not asked" not in str(compared(-10.0, None, placebo=placebo))
    assert "Not asked" not in str(compared(10.0, 3.0, placebo=placebo))


def test_the_strongest_of_those_that_know_nothing_decides():
    found = compared(10.0, 4.0, placebo=11.0)
    assert found.contrasts["mean"].reason == "by optimism alone"
    assert found.knowledge_verdicts["mean"].rival == "mean, placebo"
    assert found.contrasts["mean"].answer == "pays, by optimism alone"
    # The other controls do not: a source that is the target itself knows the task.
    arms = {**compared(10.0, 4.0).arms, "mean, pretraining": flat(20.0 + NOISE, True)}
    other = Comparison("maze", arms, 10, 10, 0.5, 1)
    assert other.control_verdicts["mean"].rival == "mean, pretraining"
    assert other.contrasts["mean"].reason == "by what it knows"


def test_too_few_seeds_show_nothing():
    few = compared(10.0, 10.0)
    five = {name: arm.take(np.arange(5)) for name, arm in few.arms.items()}
    found = Comparison("maze", five, 10, 10, 0.5, 1)
    assert found.contrasts["mean"].answer == "too few seeds for a verdict (5; 6 or more)"
    assert "cheaper" not in str(found)


def test_the_verdict_is_the_same_whether_or_not_the_reason_is_asked():
    """p values of both halves are of families of their own."""
    plain, asked = compared(0.3, None), compared(0.3, 0.3, placebo=9.0)
    one, other = (found.contrasts["mean"] for found in (plain, asked))
    assert (one.verdict, one.adjusted_p) == (other.verdict, other.adjusted_p)
