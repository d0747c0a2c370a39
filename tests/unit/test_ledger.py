"""The ledger of a design: booking, prices, break-even, files, and what results spent."""

import json
import pickle
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.design import Ledger, ledger_of
from curricle.errors import SettingError
from curricle.learning import learn
from curricle.statistics import Interval
from curricle.transfer.task_pair import SearchedMapping
from tests.comparisons import CORNER, MAZE, corner, pursuit
from tests.refusals import cases, check_refusal

BOOKED = (
    Ledger(prices={"target": 10, "miniatures": 0.5, "evaluation": 0})
    .book(target=1200, sources=300, miniatures=40_000, evaluation=7)
    .book_seconds(sweeps=1.5, exact_evaluations=0.25)
)


def interval(estimate, low, high):
    return Interval(estimate, low, high, 0.95, 30)


def test_cost_is_steps_times_price():
    assert BOOKED.costs["target"] == 12_000
    assert BOOKED.cost == 12_000 + 300 + 20_000
    assert BOOKED.total_steps == 1200 + 300 + 40_000 + 7
    assert BOOKED.seconds == {"sweeps": 1.5, "exact_evaluations": 0.25}


def test_booking_leaves_the_ledger_as_it_was():
    empty = Ledger()
    assert empty.book(target=5).total_steps == 5
    assert empty == Ledger()
    with pytest.raises(TypeError):
        empty.steps["target"] = 5


def test_a_price_is_1_unless_it_is_said():
    assert Ledger().book(sources=3, target=4).cost == 7
    assert BOOKED.with_prices(sources=2).cost == BOOKED.cost + 300


def test_it_prints_what_is_booked_with_units():
    assert str(BOOKED).splitlines() == [
        "                    steps  price a step    cost",
        "target              1,200            10  12,000",
        "sources               300             1     300",
        "miniatures         40,000           0.5  20,000",
        "evaluation              7             0       0",
        "total              41,507                32,300",
        "sweeps              1.5 s",
        "exact evaluations  0.25 s",
    ]


def test_it_goes_through_json_toml_and_pickle():
    plain = BOOKED.to_dict()
    assert Ledger.from_dict(json.loads(json.dumps(plain))) == BOOKED
    lines = [
        f"[{table}]\n" + "\n".join(f"{key} = {value!r}" for key, value in values.items())
        for table, values in plain.items()
    ]
    assert Ledger.from_dict(tomllib.loads("\n".join(lines))) == BOOKED
    again = pickle.loads(pickle.dumps(BOOKED))
    assert again == BOOKED
    assert hash(again) == hash(BOOKED)


@pytest.mark.parametrize(
    ("saving", "says"),
    [
        (250, "the search has paid after 4 trainings"),
        (1000, "the search has paid after 1 training"),
        (0, "the search never pays: a training with the design costs as much as one without"),
        (-80, "the search never pays: a training with the design costs 80 more than one without"),
        (interval(250, 100, 400), "the search has paid after 4 trainings [3, 10]"),
        (interval(250, -10, 400), "the search has paid after 4 trainings [3, never]"),
        (
            interval(-50, -200, 100),
            "the search never pays: a training with the design costs 50 more than one without; "
            "at the upper bound of its interval after 10 trainings",
        ),
        (interval(250, np.nan, np.nan), "the search has paid after 4 trainings"),
    ],
)
def test_break_even_in_words(saving, says):
    assert str(Ledger().book(miniatures=1000).break_even(saving)) == says


def test_a_search_that_cost_nothing_has_paid_before():
    assert Ledger().break_even(5).trainings == 0
    assert Ledger().break_even(-5).never


REFUSALS = {
    SettingError: {
        "unknown class": (lambda: Ledger().book(sorces=5), r"'sorces', did you mean 'sources'"),
        "unknown class of prices": (lambda: Ledger(prices={"seconds": 1}), "got 'seconds'"),
        "unknown computation": (lambda: Ledger().book_seconds(target=1), "class of computations"),
        "negative steps": (lambda: Ledger().book(target=-1), "at least 0: got -1"),
        "half a step": (lambda: Ledger().book(target=0.5), "whole number"),
        "infinite steps": (lambda: Ledger().book(target=float("inf")), "steps of target"),
        "negative price": (lambda: Ledger().with_prices(target=-1), "price of target"),
        "infinite price": (lambda: Ledger().with_prices(target=float("nan")), "must be finite"),
        "no price": (lambda: Ledger().with_prices(target=None), "price of target must be a number"),
        "negative seconds": (lambda: Ledger().book_seconds(sweeps=-0.1), "seconds of sweeps"),
        "no dict": (lambda: Ledger(5), "steps of a ledger must be a dict"),
        "two prices": (
            lambda: BOOKED + Ledger().book(target=1),
            "that of target is 10 and 1",
        ),
        "price missing in a file": (
            lambda: Ledger.from_dict({"steps": {"target": 5}, "prices": {"sources": 1}}),
            "the price of target is missing: 5 steps",
        ),
        "unknown table in a file": (lambda: Ledger.from_dict({"step": {}}), r"got \['step'\]"),
        "file of another kind": (lambda: Ledger.from_dict([1]), r"got \[1\]"),
        "saving not finite": (lambda: BOOKED.break_even(float("nan")), "saving of a training"),
        "saving of many": (
            lambda: BOOKED.break_even(interval(*np.ones((3, 2)))),
            "must be one interval",
        ),
        "no result": (lambda: ledger_of("a maze"), "a ledger is made of the result"),
    }
}


@pytest.mark.parametrize(("error", "call", "says"), cases(REFUSALS))
def test_refusals(error, call, says):
    check_refusal(error, call, says)


# -- what results spent --------------------------------------------------------------------------


def test_of_learning_alone():
    result = learn(MAZE, budget=700, seeds=3)
    assert ledger_of(result).steps["target"] == 2100


def test_of_a_curriculum_adds_up_to_what_it_says():
    result = pursuit().train(seeds=2)
    spent = ledger_of(result).steps
    assert spent["target"] == result["hunt"].steps_used.sum() == 16_000
    assert spent["sources"] == result.source_steps("hunt").sum() == 10_000
    evaluations = sum(one.evaluation_steps.sum() for one in result.nodes.values())
    assert spent["evaluation"] == evaluations > 0


def test_calibration_is_part_of_a_tasks_own_steps():
    result = pursuit(calibrate=True).train(seeds=2)
    spent = ledger_of(result).steps
    assert spent["calibration"] == sum(one.steps for one in result.calibrations["hunt"]) > 0
    assert spent["target"] + spent["calibration"] == result["hunt"].steps_used.sum()
    assert spent["sources"] == result.source_steps("hunt").sum()


def test_a_search_for_mappings_is_charged_to_each_seed():
    found = cr.same_position(MAZE, CORNER)
    mapping = SearchedMapping(MAZE, CORNER, found.index, how="sampled", steps=40)
    result = corner(mapping=mapping).train(seeds=3)
    spent = ledger_of(result).steps
    assert spent["mapping_search"] == 120
    assert spent["sources"] + 120 == result.source_steps("maze").sum()


def test_retraining_is_booked_under_sources():
    # The mean of two optimistic sources starts well and then drops.
    retrain = cr.curriculum.RetrainSources(drop=0.0, steps=400, times=2, patience=1)
    learner = cr.QLearning(learning_rate=0.1, epsilon=0.3)
    plan = replace(pursuit(learner=learner), aggregate=cr.mean, retrain={"hunt": retrain})
    result = plan.train(seeds=4, charge=True)
    extra = result.retrained["hunt"].extra.sum()
    assert extra > 0
    spent = ledger_of(result).steps
    assert spent["sources"] == result.source_steps("hunt").sum() == 4 * 5000 + extra
    assert spent["target"] == result["hunt"].steps_used.sum()


def test_what_was_trained_before_is_booked_too():
    first = corner().train(seeds=2, only="corner")
    result = corner().train(seeds=2, trained={"corner": first["corner"]})
    assert ledger_of(result) == ledger_of(corner().train(seeds=2))
    assert ledger_of(first).steps["sources"] == 1000


def test_of_a_comparison_each_arm_costs_its_total():
    comparison = cr.compare({"corner": corner()}, seeds=3)
    spent = ledger_of(comparison).steps
    assert spent["sources"] == comparison["corner"].curve.source_steps.sum() == 1500
    assert sum(spent.values()) == 2 * 3 * comparison.total


def test_of_a_forecast_with_its_trial():
    forecast = cr.forecast(corner(), seeds=2, trial=True)
    spent = ledger_of(forecast, prices={"target": 10})
    trial = ledger_of(forecast.trial, prices={"target": 10})
    trained = sum(int(one.steps_used.sum()) for one in forecast.trained.values())
    assert trial.steps == ledger_of(forecast.trial.comparison).steps
    assert spent.steps["sources"] == trained + trial.steps["sources"]
    assert spent.steps["calibration"] == sum(
        one.steps for row in forecast.rows for one in row.calibrations
    )
    assert spent.costs["target"] == 10 * trial.steps["target"]


def test_sources_that_were_solved_took_no_steps():
    assert ledger_of(cr.forecast(corner(), perfect=True)).steps["sources"] == 0


def test_of_a_miniature_every_step_but_those_of_rollouts_is_one():
    result = pursuit(calibrate=True).train(seeds=2)
    small, whole = ledger_of(result, miniature=True), ledger_of(result)
    assert small.total_steps == whole.total_steps
    assert small.steps["evaluation"] == whole.steps["evaluation"]
    assert small.steps["miniatures"] == whole.total_steps - whole.steps["evaluation"]


def test_a_trial_on_a_relative_is_a_miniature():
    forecast = cr.forecast(corner(), seeds=2, trial=corner(source=100, target=300))
    assert forecast.trial.relative
    spent = ledger_of(forecast.trial).steps
    assert spent["miniatures"] == sum(spent.values()) > 0
