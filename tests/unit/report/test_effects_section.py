"""The figures and the section of a sweep or a tuning: what they show of given numbers."""

import xml.etree.ElementTree as ET

import pytest

from curricle.plotting.effects import (
    draw_main_effects,
    draw_parallel_coordinates,
    effect_colours,
)
from curricle.report.effects_section import effects_sections
from curricle.report.templates import render
from curricle.study.effects import SWEEP, TUNING, Effects, Level, Setting, Tried, tuning_effects
from curricle.study.tuning_record import SpaceRecord, TrialRecord, TunedArm, TuningRecord

RATE = "learner.learning_rate"
TUNED = TuningRecord(
    of="0f",
    of_settings="1e",
    optuna="4.4.0",
    seeds=(7, 8),
    total=500,
    space={
        RATE: SpaceRecord(low=0.01, high=1.0, log=True),
        "aggregate": SpaceRecord(values=("mean", "<b>minimum</b>")),
    },
    arms={
        "scratch": TunedArm(
            arm="scratch",
            trials=(
                TrialRecord(values={RATE: 0.02}, score=-9.0),
                TrialRecord(values={RATE: 0.5}, score=-3.0),
                TrialRecord(values={RATE: 0.6}, score=None),
            ),
        ),
        "a, b": TunedArm(
            arm="a",
            trials=(
                TrialRecord(values={RATE: 0.1, "aggregate": "mean"}, score=-4.0),
                TrialRecord(values={RATE: 0.9, "aggregate": "<b>minimum</b>"}, score=-2.0),
            ),
        ),
    },
)


def test_a_line_crosses_each_axis_at_its_value_and_ends_at_its_return():
    scratch, own = draw_parallel_coordinates(tuning_effects(TUNED), width=9).axes
    lines = [line.get_ydata() for line in own.lines if len(line.get_xdata()) == 3]
    best = [0.977, 1.0, 1.0]
    assert [[round(float(y), 3) for y in one] for one in lines] == [[0.5, 0.0, 0.714], best, best]
    assert (scratch.get_title("left"), own.get_title("left")) == (
        "scratch: 2 trials",
        "a: 2 trials",
    )
    assert [one.get_text() for one in own.get_xticklabels()][-1] == "mean return"


@pytest.mark.parametrize(("width", "columns"), [(3.4, 1), (8.6, 2)])
def test_panels_stand_below_each_other_where_it_is_narrow(width, columns):
    figure = draw_parallel_coordinates(tuning_effects(TUNED), width=width)
    figure.draw_without_rendering()
    assert len({round(axes.get_position().x0, 2) for axes in figure.axes}) == columns


def test_main_effects_have_each_level_s_mean_and_reach():
    setting = Setting(RATE, ("0.1", "0.3"), 0.0, 1.0, False, (0.1, 0.3))
    levels = {
        ("scratch", RATE): (Level("0.1", 2, -3.0, -4.0, -1.0), Level("0.3", 1, -5.0, -5.5, -4.5))
    }
    tried = (Tried("scratch", {RATE: 0.1}, -3.0, True),)
    (axes,) = draw_main_effects(Effects(SWEEP, (setting,), tried, levels)).axes
    (bars,) = axes.containers
    assert bars.lines[0].get_ydata().tolist() == [-3.0, -5.0]
    reach = [path.vertices[:, 1].tolist() for path in bars.lines[2][0].get_paths()]
    assert reach == [[-4.0, -1.0], [-5.5, -4.5]]
    assert [one.get_text() for one in axes.get_xticklabels()] == ["0.1", "0.3"]


def test_scratch_is_black_and_arms_have_the_page_s_colours():
    assert effect_colours(tuning_effects(TUNED)) == {"scratch": "#000000", "a": "#0072B2"}


def test_the_section_states_the_steps_of_trials_and_the_best_of_each_arm():
    (section,) = effects_sections([tuning_effects(TUNED)], TUNED)
    assert [(row.arm, row.trials, row.steps, row.score, row.values) for row in section.best] == [
        ("scratch", 3, "3,000", "−3", ("0.5", "–")),
        ("a, b", 2, "2,000", "−2", ("0.9", "<b>minimum</b>")),
    ]
    page = render("effects.html", settings_sections=[section])
    assert "the curves are not charged" in page
    assert "<b>minimum</b>" not in page
    assert 'id="tuning"' in page
    assert "7-8" in page


def test_figures_are_whole_svg_in_both_widths():
    (section,) = effects_sections([tuning_effects(TUNED)], TUNED)
    for drawn in (section.lines, section.main):
        assert set(drawn) == {"wide", "narrow"}
        for svg in drawn.values():
            ET.fromstring(str(svg).replace("xlink:href", "href"))


def test_equal_returns_are_drawn():
    setting = Setting(RATE, ("0.1",), 0.0, 0.0, False, (0.1,))
    found = Effects(TUNING, (setting,), (Tried("scratch", {RATE: 0.1}, 2.0, True),), {})
    assert draw_parallel_coordinates(found).axes[0].lines
