"""Retraining of sources: when, at whose cost, and what stays the same."""

from dataclasses import replace

import numpy as np
import pytest

from curricle import (
    SARSA,
    Curriculum,
    DoubleQLearning,
    Episodes,
    Guard,
    Pursuit,
    QInitialisation,
    QLearning,
    StateShaping,
    StoppingRule,
    Storage,
    Transfer,
    project,
)
from curricle.curriculum import RetrainSources
from curricle.curriculum.retraining import _Source
from curricle.curriculum.sources import Progress
from curricle.errors import CurriculumError, SettingError
from curricle.learning import harmonic, linear
from curricle.planning.target import Target

HUNT = Pursuit(size=3, predators=2, time_limit=50)
CHASE = Pursuit(size=3, predators=1, time_limit=50)


def plan(retrain, **settings):
    """The mean of two optimistic sources: it starts well and decays within a thousand steps."""
    given = {"budget": {"chase": StoppingRule(1500), "hunt": 9000}, "eval_freq": {"hunt": 150}}
    given |= {"learner": QLearning(learning_rate=0.1, epsilon=0.3)}
    given |= {"shaping": QInitialisation()} | settings
    return Curriculum(
        {"chase": CHASE, "hunt": HUNT},
        [
            Transfer("chase", "hunt", project(HUNT, CHASE, predator=name))
            for name in HUNT.predator_names
        ],
        retrain={"hunt": retrain},
        **given,
    )


ALWAYS = RetrainSources(drop=0.0, steps=400, times=2, patience=1)
NEVER = RetrainSources(drop=1e9, steps=400)


def test_a_target_that_never_loses_anything_is_trained_as_without():
    one, other = (plan(one).train(seeds=3) for one in (NEVER, None))
    for name in ("values", "greedy_return", "training_return", "steps_used", "episodes"):
        np.testing.assert_array_equal(getattr(one["hunt"], name), getattr(other["hunt"], name))
    assert one.source_steps("hunt").tolist() == [1500] * 3
    assert [len(decisions) for decisions in one.decisions("hunt")] == [61] * 3


def test_retraining_is_charged_and_reported_and_the_target_trained_to_its_end():
    found = plan(ALWAYS).train(seeds=4, charge=True)
    extra = found.retrained["hunt"].extra
    assert (extra > 0).any()
    assert set(extra.tolist()) <= {0, 400, 800}
    np.testing.assert_array_equal(found.source_steps("hunt"), 1500 + extra)
    np.testing.assert_array_equal(found["hunt"].steps_used, 9000 - 1500 - extra)
    np.testing.assert_array_equal(found.sources["hunt"].steps_used, 9000 - 1500)
    for decisions, spent in zip(found.decisions("hunt"), extra, strict=True):
        sentences = [str(one) for one in decisions if one.then.startswith("retrains")]
        assert len(sentences) == spent // 400, decisions
        assert all(words.startswith("retrains chase; dropped: greedy") for words in sentences)
        steps = [one.step for one in decisions]
        assert steps == sorted(set(steps))


def test_a_seed_does_not_depend_on_the_others():
    together, alone = plan(ALWAYS).train(seeds=4), plan(ALWAYS).train(seeds=[2])
    for name in ("values", "steps_used", "episodes_used"):
        np.testing.assert_array_equal(
            getattr(together["hunt"], name)[2:3], getattr(alone["hunt"], name)
        )
    n = len(alone["hunt"].steps)
    np.testing.assert_array_equal(
        together["hunt"].greedy_return[2, :n], alone["hunt"].greedy_return[0]
    )


def test_seeds_in_another_order_have_the_same_results_in_that_order():
    seeds = [1, 3, 0]
    found, ascending = plan(ALWAYS).train(seeds), plan(ALWAYS).train(sorted(seeds))
    place = [sorted(seeds).index(seed) for seed in seeds]
    assert found["hunt"].seeds == found["chase"].seeds == tuple(seeds)
    for name in ("values", "steps_used", "episodes", "greedy_return"):
        np.testing.assert_array_equal(
            getattr(found["hunt"], name), getattr(ascending["hunt"], name)[place]
        )


def test_snapshots_go_on_after_retraining():
    found = plan(ALWAYS).train(seeds=2, snapshots=6)
    assert found.retrained["hunt"].extra[0] > 0
    steps = plan(NEVER).train(seeds=1, snapshots=6)["hunt"].snapshots.steps
    snapshots = found["hunt"].snapshots
    assert set(snapshots.steps.tolist()) >= set(steps.tolist())
    assert (np.diff(snapshots.steps) > 0).all()
    last = found["hunt"].values[0].astype(np.float32)
    np.testing.assert_array_equal(snapshots.values[-1], last)


def test_curves_before_retraining_are_those_without_it():
    with_it, without = plan(ALWAYS).train(seeds=3), plan(None).train(seeds=3)
    for k, decisions in enumerate(with_it.decisions("hunt")):
        first = next((one.step for one in decisions if one.dropped), 9000) // 150
        for curve in ("greedy_return", "training_return", "episodes"):
            np.testing.assert_array_equal(
                getattr(with_it["hunt"], curve)[k, : first + 1],
                getattr(without["hunt"], curve)[k, : first + 1],
            )


def test_episodes_go_on_being_counted():
    found = plan(ALWAYS).train(seeds=3)
    assert (np.diff(found["hunt"].episodes, axis=1) >= 0).all()
    np.testing.assert_array_equal(found["hunt"].episodes[:, -1], found["hunt"].episodes_used)


def test_retraining_brings_in_what_the_source_learnt_since():
    """A source that hardly learnt before catches up: the target ends better than without."""
    retrain = RetrainSources(drop=1.0, steps=20_000, times=1)
    budget = {"chase": 500, "hunt": 60_000}
    found, without = (
        plan(one, budget=budget).train(seeds=4, charge=True) for one in (retrain, None)
    )
    retrained = found.retrained["hunt"].extra > 0
    assert retrained.any()
    gained = (
        found["hunt"].greedy_return[retrained, -1] - without["hunt"].greedy_return[retrained, -1]
    )
    assert gained.mean() > 1.0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"shaping": {"hunt": StateShaping()}}, "without a guard: 'hunt' has StateShaping"),
        ({"shaping": {"hunt": QInitialisation(guard=Guard())}}, "'hunt' has QInitialisation"),
        ({"budget": {"hunt": Episodes(5)}}, "needs a budget in steps or a StoppingRule"),
    ],
)
def test_settings_that_exclude_retraining_are_refused_before_training(settings, words):
    with pytest.raises(SettingError, match=words):
        plan(NEVER, **settings)


def test_calibrated_potentials_exclude_retraining():
    edge = Transfer("chase", "hunt", project(HUNT, CHASE, predator="predator_1"), calibrate=True)
    with pytest.raises(CurriculumError, match="must then not be calibrated"):
        Curriculum({"chase": CHASE, "hunt": HUNT}, [edge], retrain=NEVER)


def further(learner, steps=400):
    """Return a trained source, and the same after further training."""
    curriculum = plan(NEVER, learner=learner)
    learnt = curriculum.train(only="chase").sources["chase"]
    source = _Source.of("chase", curriculum.node("chase"), learnt, 0)
    return source, source.trained_on((0,), steps, turn=1)


def test_the_schedules_of_a_source_go_on_where_its_training_stopped():
    """The rate has come down to 0 after the 1,500 steps of the source: it learns nothing more."""
    fading = linear(0.5, 0.0, steps=1500)
    source, same = further(QLearning(learning_rate=fading))
    np.testing.assert_array_equal(source.values, same.values)
    assert (source.done.steps, same.done.steps) == (1500, 1900)
    source, other = further(QLearning(epsilon=linear(1.0, 0.0, steps=1500)))
    assert not np.array_equal(source.values, other.values)


@pytest.mark.parametrize("kind", [QLearning, DoubleQLearning])
def test_the_counts_of_a_source_go_on_where_its_training_stopped(kind):
    source, after = further(kind(learning_rate=harmonic(), epsilon=0.3))
    before, counts = source.done.visits, after.done.visits
    assert (before.sum(), counts.sum()) == (1500, 1900)
    assert (counts >= before).all()
    if kind is QLearning:  # a pair that was not visited again keeps its value
        untouched = counts[0] == before[0]
        np.testing.assert_array_equal(source.values[0][untouched], after.values[0][untouched])


def test_the_counts_of_the_target_go_on_and_its_first_updates_wipe_nothing():
    """Each visited pair moves by its share of a sample mean, not all the way as in 0.1.0."""
    learner = QLearning(learning_rate=harmonic(), epsilon=0.3)
    found = plan(ALWAYS, learner=learner).train(seeds=3)
    assert (found.retrained["hunt"].extra > 0).any()
    used = found["hunt"].steps_used
    np.testing.assert_array_equal(found["hunt"].visits.sum(axis=(1, 2, 3)), used)


def test_sources_that_cannot_be_trained_further_are_refused():
    curriculum = plan(ALWAYS, learner=QLearning(learning_rate=harmonic()))
    learnt = curriculum.train(only="chase").sources["chase"]
    for progress in (None, Progress(learnt.steps_used, None)):
        unknown = {"chase": replace(learnt, progress=progress)}
        with pytest.raises(CurriculumError, match="those of 'chase' are not known"):
            curriculum.train(trained=unknown)
    for storage in (Storage("sparse"), Storage(save_values=False)):
        with pytest.raises(CurriculumError, match="those of 'hunt' are not; see Storage"):
            plan(ALWAYS, storage={"hunt": storage}).train()


def test_a_target_is_solved_once_however_often_it_is_retrained(monkeypatch):
    calls, solve = list[int](), Target.of.__func__
    monkeypatch.setattr(
        Target, "of", classmethod(lambda cls, *given: (calls.append(1), solve(cls, *given))[1])
    )
    rule = StoppingRule(9000, fraction=1.0)
    found = plan(ALWAYS, budget={"chase": StoppingRule(1500), "hunt": rule}).train(seeds=2)
    assert (found.retrained["hunt"].extra > 0).any()
    assert len(calls) == 1


def test_other_learners_retrain_too():
    found = plan(ALWAYS).replace("hunt", learner=SARSA()).train(seeds=2)
    assert found["hunt"].steps_used.tolist() == [9000, 9000]


@pytest.mark.parametrize(
    "wrong",
    [{"drop": -1, "steps": 5}, {"drop": 1, "steps": 0}, {"drop": 1, "steps": 5, "times": 0}],
)
def test_a_return_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(SettingError, match="of RetrainSources"):
        RetrainSources(**wrong)
