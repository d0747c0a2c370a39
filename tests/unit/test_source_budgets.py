"""The comparison of ways to say how long a source learns: its arms, and its table."""

import pytest

from benchmarks.pairs.playing import pair_named
from benchmarks.pairs.source_budgets import RULE, arms, table
from curricle import StoppingRule
from curricle.learning.stopping import SETTLED


def test_arms_differ_in_the_source_alone():
    pair = pair_named("mazes/2, treasure")
    found = arms(pair)
    budgets = {name: one.setting("budget", "source") for name, one in found.items()}
    assert budgets == {
        RULE: StoppingRule(3_000, settled=SETTLED),
        "by hand, a cap": StoppingRule(1_500, settled=SETTLED),
        "by hand, exactly": StoppingRule(1_500),
        "a 30th of the target's": StoppingRule(1_000),
        "a tenth": StoppingRule(3_000),
        "a third": StoppingRule(10_000),
    }
    assert {one.setting("budget", "target") for one in found.values()} == {30_000}
    # Nothing else is set where the rule is judged.
    assert found[RULE].setting("eval_freq", "source") is None


def row(family, rule, hand):
    def played(gain):
        return {"gain": gain, "loss": -gain, "steps": 0.25}

    return {"pair": family, "family": family, "split": "", RULE: played(rule), "hand": played(hand)}


def test_a_family_counts_once_and_intervals_are_over_families():
    rows = [row("a", 0.2, 0.0), row("a", 0.4, 0.2), row("b", 0.3, -0.2)]
    head, rule, hand = table(rows)
    assert "rule gains more by" in head
    assert rule.split()[-3:] == ["+0.300", "0", "25%"]
    # Family a: 0.3 and 0.1; family b: 0.3 and -0.2. Student's 0.975 of 1 degree is 12.7.
    assert "-0.050" in hand
    more, low, high = (
        float(part) for part in hand.replace("(", "").replace(",", "").replace(")", "").split()[2:5]
    )
    assert more == pytest.approx(0.35)
    assert (low, high) == pytest.approx((0.35 - 12.706 * 0.15, 0.35 + 12.706 * 0.15), abs=1e-3)
    assert "3 of 3" in hand
    assert hand.split()[-2:] == ["1", "25%"]
