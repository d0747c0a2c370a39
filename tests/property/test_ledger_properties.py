"""The ledger: sums do not depend on their order, nothing is lost, and cost is linear in prices."""

import json
from fractions import Fraction

from hypothesis import assume, example, given, strategies as st

from curricle.design import CLASSES, COMPUTATIONS, Ledger
from curricle.statistics import Interval

STEPS = st.dictionaries(st.sampled_from(CLASSES), st.integers(0, 10**12))
TIMES = st.dictionaries(st.sampled_from(COMPUTATIONS), st.integers(0, 10**15))
PRICES = st.dictionaries(st.sampled_from(CLASSES), st.floats(0, 1e6))
LEDGERS = st.builds(Ledger, steps=STEPS, nanoseconds=TIMES)
POSITIVE = st.floats(1e-6, 1e9)


@given(LEDGERS, LEDGERS, LEDGERS)
def test_addition_is_associative_and_commutative(one, other, third):
    assert (one + other) + third == one + (other + third)
    assert one + other == other + one
    assert one + Ledger() == one


@given(LEDGERS, LEDGERS)
def test_nothing_is_lost(one, other):
    both = one + other
    assert both.total_steps == one.total_steps + other.total_steps
    for name in CLASSES:
        assert both.steps[name] == one.steps[name] + other.steps[name]
    for name in COMPUTATIONS:
        assert both.nanoseconds[name] == one.nanoseconds[name] + other.nanoseconds[name]


@given(st.lists(st.tuples(st.sampled_from(CLASSES), st.integers(0, 10**9))))
def test_booking_one_by_one_is_booking_all(booked):
    ledger = Ledger()
    for name, steps in booked:
        ledger = ledger.book(**{name: steps})
    for one in CLASSES:
        assert ledger.steps[one] == sum(steps for name, steps in booked if name == one)


@given(LEDGERS, PRICES, st.integers(0, 1000))
def test_cost_is_linear_in_prices(ledger, prices, factor):
    priced = ledger.with_prices(**dict.fromkeys(CLASSES, 0)).with_prices(**prices)
    exact = sum(Fraction(price) * ledger.steps[name] for name, price in prices.items())
    assert abs(Fraction(priced.cost) - exact) <= exact * Fraction(1, 10**14)
    scaled = ledger.with_prices(**{k: factor * price for k, price in priced.prices.items()})
    assert abs(scaled.cost - factor * priced.cost) <= 1e-12 * scaled.cost


@given(LEDGERS, PRICES)
def test_files_keep_the_ledger(ledger, prices):
    priced = ledger.with_prices(**prices)
    assert Ledger.from_dict(json.loads(json.dumps(priced.to_dict()))) == priced


@example(6, 2.0)  # which three trainings pay exactly
@given(st.integers(1, 10**9), POSITIVE)
def test_break_even_is_the_first_training_that_pays(cost, saving):
    found = Ledger().book(miniatures=cost).break_even(saving).trainings
    assert found * Fraction(saving) >= cost > (found - 1) * Fraction(saving)


@given(st.integers(1, 10**9), st.floats(-1e9, 1e9), POSITIVE, POSITIVE)
def test_bounds_of_the_saving_bound_break_even(cost, saving, below, above):
    assume(saving - below < saving < saving + above)
    interval = Interval(saving, saving - below, saving + above, 0.95, 30)
    found = Ledger().book(miniatures=cost).break_even(interval)
    assert found.never == (saving <= 0)
    assert (found.fewest is None) == (saving + above <= 0)
    assert (found.most is None) == (saving - below <= 0)
    bounds = [n for n in (found.fewest, found.trainings, found.most) if n is not None]
    assert bounds == sorted(bounds)
