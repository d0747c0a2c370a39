"""Forecasts and certificates next to what was measured."""

from dataclasses import replace

import pytest

import curricle as cr
from curricle.report.sections import forecast_sections
from curricle.study import analysis as analysis_module
from curricle.study.analysis import analysed, curricula_record

from .studies import Reader, hunt_plan, page_of, shown


def test_the_forecast_stands_next_to_the_measured_start(pursuit):
    record, learnt, analysis = shown(pursuit.results)
    (found,) = forecast_sections(analysis, record, learnt)
    rows = {row.name: row for row in found.record.forecast.rows}
    assert found.used == {"minimum": ("min",), "mean": ("mean",)}
    for arm, name in (("min", "minimum"), ("mean", "mean")):
        measured = pursuit.results[arm]["hunt"].greedy_return[:, 0]
        assert found.measured[arm] == measured.mean()
        assert rows[name].start == pytest.approx(measured[:3].mean(), abs=0.5)
    (certificate,) = found.record.certificates
    assert certificate.arms == ("min", "mean")
    assert certificate.holds
    assert found.record.left_out == ()


def test_a_forecast_is_not_of_arms_whose_sources_are_trained_otherwise():
    short = hunt_plan(cr.minimum)
    long = replace(short, budget={"chase": 6000, "hunt": 8000})
    plans = {"short": short, "long": long}
    results = {arm: plan.train(2) for arm, plan in plans.items()}
    record, learnt, analysis = shown(results)
    (found,) = forecast_sections(analysis, record, learnt)
    assert found.record.arms == ("short", "long")
    assert (found.same_sources, found.other_sources) == (("short",), ("long",))
    assert found.used == {"minimum": ("short",)}
    alike = {"one": short, "two": replace(short, aggregate=cr.mean)}
    record, learnt, analysis = shown({arm: plan.train(2) for arm, plan in alike.items()})
    (found,) = forecast_sections(analysis, record, learnt)
    assert found.other_sources == ()


def test_a_sentence_names_what_is_left_out_and_how_to_get_it(pursuit, monkeypatch):
    monkeypatch.setattr(analysis_module, "EFFORT", 10)
    monkeypatch.setattr(analysis_module, "LARGEST_CERTIFIED", 10)
    words = Reader(page_of(pursuit)).words
    why = f"because hunt has {729 * 25:,} state-action pairs"
    assert f"min, mean: The forecast is left out, {why}: curricle.forecast" in words
    assert "Certificates are left out" in words


def test_values_that_were_not_kept_leave_both_out():
    plan = hunt_plan(cr.minimum)
    result = plan.train(2)
    bare = {name: replace(node, values=None) for name, node in result.nodes.items()}
    record = curricula_record({"min": plan}, {})
    (found,) = analysed({"min": replace(result, nodes=bare)}, record).sections
    assert found.forecast is None
    assert found.certificates == ()
    assert all("values were not kept" in sentence for sentence in found.left_out)


def test_a_potential_that_was_not_kept_is_made_again(pursuit):
    stored = {arm: replace(one, potentials={}) for arm, one in pursuit.results.items()}
    kept, again = (shown(results)[2].sections[0] for results in (pursuit.results, stored))
    assert kept.certificates == again.certificates
