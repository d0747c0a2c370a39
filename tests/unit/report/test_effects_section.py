"""The section of a sweep or a tuning: what it shows of given numbers."""

from curricle.report.sections import effects_sections
from curricle.report.templates import render
from curricle.study.effects import tuning_effects
from curricle.study.tuning import SpaceRecord, TrialRecord, TunedArm, TuningRecord

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


def test_the_section_states_the_steps_of_trials_and_the_best_of_each_arm():
    (section,) = effects_sections([tuning_effects(TUNED)], TUNED)
    assert list(section.best) == [
        ("scratch", "3", "3,000", "−3", "0.5", "–"),
        ("a, b", "2", "2,000", "−2", "0.9", "<b>minimum</b>"),
    ]
    assert section.rows == (
        ("scratch", RATE, "0.01 to 0.0464", "1", "−9", "[−9, −9]"),
        ("scratch", RATE, "0.215 to 1", "1", "−3", "[−3, −3]"),
        ("a", RATE, "0.0464 to 0.215", "1", "−4", "[−4, −4]"),
        ("a", RATE, "0.215 to 1", "1", "−2", "[−2, −2]"),
        ("a", "aggregate", "mean", "1", "−4", "[−4, −4]"),
        ("a", "aggregate", "<b>minimum</b>", "1", "−2", "[−2, −2]"),
    )
    page = render("effects.html", settings_sections=[section])
    assert "the curves are not charged" in page
    assert "<b>minimum</b>" not in page
    assert 'id="tuning"' in page
    assert "7-8" in page
