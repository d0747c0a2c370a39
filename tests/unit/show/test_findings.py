"""Findings and measures of a comparison in words."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import Arm, Reference
from curricle.comparison.sentences import findings, headline, page_table
from curricle.show.report import forest
from curricle.statistics.curves import Curve


def line(height, source=0, seeds=8, curriculum=""):
    """An arm of constant height; seeds differ a little, from arm to arm by another amount."""
    steps = np.arange(0, 101, 10)
    values = np.full((seeds, 11), float(height)) + 0.01 * (height + np.arange(seeds)[:, None])
    values += 0.001 * height * np.arange(seeds)[:, None]
    return Arm(Curve(steps, values, np.full(seeds, source)), curriculum=curriculum)


def compared(seeds=8, threshold=5.0, **arms):
    with_scratch = {"scratch": line(0, seeds=seeds), **arms}
    return Comparison("hunt", with_scratch, 80, 100, Reference(threshold), 1)


def test_the_headline_names_what_paid_and_by_how_much():
    result = compared(good=line(10, 20), better=line(20, 20), bad=line(-5, 10))
    gain = result.contrasts["better"].strong_gain
    text = headline(result).replace("\xa0", " ")
    assert text.startswith(
        "2 of 3 curricula pay for themselves, 1 of 3 curricula costs more than it brings: bet"
    )
    assert f"+{gain.estimate:.1f} [{gain.low:.1f}, {gain.high:.1f}]" in text
    assert text.endswith("over 8 seeds.")


def test_a_headline_claims_nothing_that_was_not_shown():
    assert headline(compared(same=line(0))).startswith("No curriculum is shown to differ")
    both = headline(compared(one=line(-5), two=line(-6)))
    assert both.startswith("2 of 2 curricula cost more than they bring: two most")
    result = compared(good=line(10), placebo=line(10, curriculum="good"))
    assert headline(result).startswith("The curriculum pays for itself: +")


def test_it_is_said_where_no_arm_learns():
    result = compared(good=line(4), bad=line(-5))
    warning = "o arm reaches the threshold of 5 in any seed"
    assert warning in headline(result)
    assert f"n{warning}" in result.text()
    assert warning not in headline(compared(good=line(6), bad=line(-5)))


def test_a_curriculum_is_compared_with_its_own_controls():
    result = compared(
        good=line(10), weak=line(4, curriculum="good"), strong=line(9, curriculum="good")
    )
    curriculum, *controls = findings(result)
    text = curriculum.sentences[4].replace("\xa0", " ")
    assert text.startswith("Gains more than each of its 2 controls: yes, +1.01 [")
    assert text.endswith("the strongest is strong.")
    assert not any("(p" in finding.sentences[0] for finding in controls)


@pytest.mark.parametrize(("seeds", "arms", "needed"), [(1, 1, 6), (5, 1, 6), (5, 2, 7)])
def test_too_few_seeds_are_said_to_be(seeds, arms, needed):
    result = compared(seeds, **{f"arm {i}": line(10, seeds=seeds) for i in range(arms)})
    assert all(finding.tone == "open" for finding in findings(result))
    assert headline(result) == f"Too few seeds for a verdict ({seeds}; {needed} or more)."


def test_the_table_holds_the_numbers_of_the_comparison(pursuit):
    cells, rows = page_table(pursuit.comparison), pursuit.comparison.rows()
    assert list(cells) == [row["arm"] for row in rows]
    gains = "strong_gain", "weak_gain", "jumpstart", "asymptotic_gain"
    for row in rows:
        if row["arm"] in pursuit.comparison.scratches:
            continue
        for measure in (*gains, "probability_of_improvement", "mean_return"):
            text, below = cells[row["arm"]][measure]
            wanted = [row[measure], row[f"{measure}_low"], row[f"{measure}_high"]]
            numbers = [text, *below.strip("[]").split(", ")]
            read = [float(number.replace("−", "-")) for number in numbers]
            assert read == pytest.approx(wanted, abs=0.006 * max(map(abs, wanted)))


def test_saved_steps_are_bounds_where_seeds_never_got_there():
    cells = page_table(compared(good=line(10, 20), bad=line(1)))
    assert cells["good"]["share_of_steps_saved"].text == "at least 0.800"
    assert cells["bad"]["weak_steps_saved"].text == "never reached"
    assert cells["bad"]["share_of_steps_saved"].below == "(seeds of both never get there)"
    reverse = Comparison("hunt", {"scratch": line(10), "bad": line(0)}, 80, 100, Reference(5.0), 1)
    assert page_table(reverse)["bad"]["weak_steps_saved"].text == "−80.0"
    # Reached after 70 of 80 target steps: 110 with those of the source, beyond all 100 steps.
    steps, values = np.arange(0, 101, 10), np.repeat([[0.0] * 7 + [10.0] * 4], 8, axis=0)
    late = Arm(Curve(steps, values, np.full(8, 40)))
    cells = page_table(compared(late=late))["late"]
    assert cells["weak_steps_saved"] == ("10.0", "")
    assert cells["share_of_steps_saved"].text.startswith("unknown")


@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), min_size=1, max_size=5))
def test_a_forest_keeps_order_and_stays_on_its_axis(gains):
    ordered = [sorted(gain) for gain in gains]
    gains = [SimpleNamespace(low=low, estimate=middle, high=high) for low, middle, high in ordered]
    contrasts = {f"{i}": SimpleNamespace(strong_gain=gain) for i, gain in enumerate(gains)}
    zero, places = forest(contrasts)
    flat = [zero, *(place for three in places.values() for place in three)]
    assert min(flat) >= -1e-9
    assert max(flat) <= 100 + 1e-9
    assert all(low <= middle <= high for low, middle, high in places.values())


def constant(height):
    opponent = line(height, curriculum="good")
    return replace(opponent, scratch=True, initial_values=np.full(8, 30.0))


def asked(height):
    """A comparison of a curriculum with a placebo that gains `height` and a useless constant."""
    placebo = line(height, 20, curriculum="good")
    beside = {"good, placebo": placebo, "good, constant mean": constant(-1)}
    return compared(good=line(10, 20), **beside)


def test_why_a_curriculum_pays_is_part_of_its_verdict_and_of_the_headline():
    for height, reason in (
        (4, "by what it knows"),
        (12, "not by what it knows: a placebo gains more"),
    ):
        result = asked(height)
        assert findings(result)[0].verdict == f"pays, {reason}"
        assert findings(result)[0].tone == "pays"
        assert headline(result).endswith(f"over 8 seeds. It pays {reason}.")
    best = compared(good=line(10, 20), **{"good, constant mean": constant(2)})
    against = "against the best opponent, good, constant mean, source steps counted"
    assert against in headline(best)
    assert len(findings(best)) == 1
