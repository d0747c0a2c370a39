"""Comparisons at one total budget: what is held equal, what is refused, what is read off."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle import (
    UNMAPPED,
    Curriculum,
    Episodes,
    FiniteMDP,
    GreedyEvaluation,
    GridWorld,
    Pursuit,
    Transfer,
    compare,
)
from curricle.comparison import Arm, Comparison
from curricle.errors import CurriculumError, SettingError
from curricle.planning import target as judging
from curricle.statistics import Curve, charge_source
from curricle.transfer import StateActionMapping

MAZE = GridWorld(["....T", ".PPP.", "S...."], time_limit=50)
CORNER = MAZE.crop(rows=(0, 2), columns=(2, 5))
HERE = cr.same_position(MAZE, CORNER)
NOWHERE = StateActionMapping(MAZE, CORNER, np.full(HERE.index.shape, UNMAPPED))
ALL = ("random_start", "pretraining", "placebo", "scaled", "negated")
LABELS = ("placebo", "scaled x 0.5", "scaled x 2", "negated", "random start", "pretraining")


def corner(mapping=HERE, source=500, target=3000, eval_freq=100, **settings):
    """Return a curriculum from a corner of the maze to the maze."""
    return Curriculum(
        tasks={"corner": CORNER, "maze": MAZE},
        transfers=[Transfer("corner", "maze", mapping)],
        budget={"corner": source, "maze": target},
        eval_freq={"maze": eval_freq},
        **settings,
    )


def copied(task, target="far", **settings):
    """Return a curriculum from a task to itself."""
    return Curriculum(
        tasks={"near": task, target: task},
        transfers=[Transfer("near", target, cr.transfer.identity(task))],
        **({"budget": 100} | settings),
    )


@pytest.fixture
def calls(monkeypatch):
    """Return the list of all trainings from now on: their arguments, and what came of them."""
    noted, learn = [], cr.learn

    def noting(task, learner, budget, **settings):
        result = learn(task, learner, budget, **settings)
        charged = settings["charged"]
        left = budget if charged is None else budget - int(min(charged))
        noted.append({"task": task, "budget": left, "result": result, **settings})
        return result

    monkeypatch.setattr("curricle.node.learn", noting)
    return noted


def assert_same(one, other):
    """Two arms are equal, bit for bit."""
    np.testing.assert_array_equal(one.curve.steps, other.curve.steps)
    np.testing.assert_array_equal(one.curve.values, other.curve.values)
    np.testing.assert_array_equal(one.curve.source_steps, other.curve.source_steps)
    np.testing.assert_array_equal(one.training_return, other.training_return)
    np.testing.assert_array_equal(one.guard_share, other.guard_share)
    assert one.control == other.control


def assert_held(arm, last):
    """Nothing of an arm changes after these checkpoints, one a seed; before them it did."""
    for k, place in enumerate(last):
        for rows in (arm.curve.values, arm.training_return, arm.guard_share):
            np.testing.assert_array_equal(
                rows[k, place:], np.full_like(rows[k, place:], rows[k, place])
            )
        assert len(set(arm.training_return[k, place - 10 : place + 1].tolist())) > 1


# -- one total budget ------------------------------------------------------------------------------


def test_every_arm_has_the_same_total(calls):
    found = compare({"small": corner(), "large": corner(source=1500)}, seeds=2, controls=ALL)
    assert (found.budget, found.total) == (3000, 4500)
    trained = [(call["stream"], call["budget"]) for call in calls]
    again = [("control source", 500), ("maze", 4000)]
    assert trained[:9] == [("maze", 4500), ("corner", 500), *[("maze", 4000)] * 5, *again]
    assert trained[9:11] == again
    again = [("control source", 1500), ("maze", 3000)]
    assert trained[11:] == [("corner", 1500), *[("maze", 3000)] * 5, *again, *again]
    for name, arm in found.arms.items():
        spent = 0 if name == "scratch" else 500 if name.startswith("small") else 1500
        assert arm.curve.source_steps.tolist() == [spent, spent]
        assert arm.curve.steps.tolist() == list(range(0, 4501, 100))
        assert_held(arm, [(4500 - spent) // 100] * 2)


def test_the_total_is_a_whole_number_of_checkpoints():
    found = compare(corner(source=300, target=1000, eval_freq=70), seeds=1, window=1)
    assert found.total == 1330
    assert found.arms["transfer"].curve.steps[-1] == 1330


def test_sources_that_take_each_seed_another_time_leave_it_another_time(calls):
    """In a budget of 40 episodes no two seeds take the same steps; 40 x 50 are the most."""
    settings = {"eval_freq": {"far": 20}, "learner": {"near": cr.QLearning(epsilon=0.5)}}
    settings["budget"] = {"near": Episodes(40), "far": 3000}
    found = compare(copied(MAZE, **settings), seeds=3, controls=ALL)
    assert found.total == 5000
    spent = found["transfer"].curve.source_steps
    assert len(set((spent // 20).tolist())) == 3
    for name in list(found.arms)[1:]:
        assert found[name].curve.source_steps.tolist() == spent.tolist()
        assert_held(found[name], (5000 - spent) // 20)
    for k in range(3):
        settings["budget"] = {"near": Episodes(40), "far": int(5000 - spent[k])}
        alone = copied(MAZE, **settings).train([k])["far"]
        n, arm = len(alone.steps), found["transfer"]
        np.testing.assert_array_equal(arm.curve.values[k, :n], alone.greedy_return[0])
        np.testing.assert_array_equal(arm.training_return[k, :n], alone.training_return[0])
    controls = [call for call in calls if call["stream"] == "control source"]
    assert sorted(call["budget"] for call in controls) == sorted([*spent.tolist()] * 2)
    for call in controls:
        assert call["budget"] == spent[call["seeds"][0]]


# -- common random numbers -------------------------------------------------------------------------


def test_an_arm_that_is_told_nothing_is_the_direct_learner_a_little_later():
    found = compare(corner(NOWHERE), seeds=4)
    scratch, arm = found.scratch, found["transfer"]
    assert np.ptp(scratch.curve.values) > 0
    own = 3000 // 100 + 1
    np.testing.assert_array_equal(arm.curve.values[:, :own], scratch.curve.values[:, :own])
    np.testing.assert_array_equal(arm.training_return[:, :own], scratch.training_return[:, :own])
    charged = arm.charged(scratch).values
    np.testing.assert_array_equal(charged[:, 5:], scratch.curve.values[:, :-5])
    assert (charged[:, :5] == scratch.curve.values[:, :1]).all()


def test_equal_arms_are_equal():
    found = compare({"one": corner(), "two": corner()}, seeds=3)
    assert_same(found["one"], found["two"])
    one, two = (list(map(str, vars(contrast).values())) for contrast in found.contrasts.values())
    assert one == two


def test_an_arm_is_the_training_of_its_curriculum():
    found = compare(corner(), seeds=[3, 5])["transfer"]
    alone = corner().train([3, 5])
    np.testing.assert_array_equal(found.curve.values[:, :31], alone["maze"].greedy_return)
    np.testing.assert_array_equal(found.training_return[:, :31], alone["maze"].training_return)


def test_the_direct_learner_is_the_targets_own():
    learner, evaluation = cr.QLearning(epsilon=0.3), GreedyEvaluation(discounted=False)
    found = compare(corner(learner={"maze": learner}, evaluation={"maze": evaluation}), seeds=2)
    alone = cr.learn(
        MAZE, learner, 3500, seeds=2, eval_freq=100, evaluation=evaluation, stream="maze"
    )
    np.testing.assert_array_equal(found.scratch.curve.values, alone.greedy_return)
    np.testing.assert_array_equal(found.scratch.training_return, alone.training_return)


def test_equal_seeds_agree_and_different_ones_differ():
    one, same, other = (compare(corner(), seeds=seeds) for seeds in ([0, 1], [0, 1], [2, 3]))
    for name in one.arms:
        assert_same(one[name], same[name])
        assert (one[name].curve.values != other[name].curve.values).any()


# -- what enters with the arms ---------------------------------------------------------------------


def pursuit(**settings):
    hunt, chase = Pursuit(3, 2, time_limit=50), Pursuit(3, 1, time_limit=50)
    changes = {"calibrate": settings.pop("calibrate", False)}
    return Curriculum(
        tasks={"chase": chase, "hunt": hunt},
        transfers=[
            Transfer("chase", "hunt", cr.project(hunt, chase, predator=name), **changes)
            for name in hunt.predator_names
        ],
        aggregate=cr.minimum,
        budget={"chase": 5000, "hunt": 8000},
        eval_freq={"hunt": 100},
        evaluation=GreedyEvaluation(method="rollouts", episodes=10),
        **settings,
    )


def test_the_steps_of_a_calibration_are_charged(calls):
    arms = {"raw": pursuit(), "calibrated": pursuit(calibrate=True)}
    found = compare(arms, seeds=2, controls=["scaled"])
    assert found.total == 13_000
    hunts = [call for call in calls if call["stream"] == "hunt"]
    assert [call["budget"] for call in hunts] == [13_000] + [8000] * 6
    warm_ups = hunts[-3]["before"]
    assert not any(call.get("before") for call in hunts[:-3])
    assert [call["before"] for call in hunts[-2:]] == [warm_ups] * 2  # of its controls too
    curve = found["calibrated"].curve.values
    for k, warm_up in enumerate(warm_ups):
        assert len(warm_up.lengths) == 200
        assert np.ptp(curve[k, : warm_up.steps // 100 + 1]) == 0
        assert curve[k, warm_up.steps // 100 + 5] != curve[k, 0]
    assert curve[0, 0] == pytest.approx(found["raw"].curve.values[0, 0])  # it is the same policy


def test_a_guard_watches_over_the_arm_and_its_controls():
    arms = {"bare": corner(), "guarded": corner(guard={"maze": cr.Guard(pace=0.5)})}
    found = compare(arms, seeds=2, controls=ALL)
    for name, arm in found.arms.items():
        if name.startswith("guarded"):
            assert (arm.guard_share[:, 0] == 0.5).all()
            assert np.ptp(arm.guard_share) > 0
        else:
            assert np.isnan(arm.guard_share).all()


# -- controls --------------------------------------------------------------------------------------


def test_controls_follow_their_arm_in_order():
    found = compare({"one": corner(), "two": corner()}, seeds=1, controls=ALL)
    expected = [
        f"{arm}{label}" for arm in ("one", "two") for label in ("", *map(", ".__add__, LABELS))
    ]
    assert list(found.arms) == ["scratch", *expected]
    assert [name for name, arm in found.arms.items() if arm.control] == [
        name for name in expected if ", " in name
    ]


def test_pretraining_and_a_random_start_cost_what_the_sources_did(calls):
    found = compare(corner(), seeds=2, controls=["pretraining", "random_start"])
    anywhere, itself = (call for call in calls if call["stream"] == "control source")
    alive = ~MAZE.mdp.terminal
    np.testing.assert_allclose(anywhere["task"].mdp.start, alive / alive.sum())
    assert itself["task"] is MAZE
    for call, name in ((anywhere, "transfer, random start"), (itself, "transfer, pretraining")):
        assert call["budget"] == 500
        assert found[name].curve.source_steps.tolist() == [500, 500]
        # What the target starts with is what its source ended with.
        target = calls[calls.index(call) + 1]
        for k, phi in enumerate(target["potential"]):
            np.testing.assert_array_equal(phi.values, call["result"].values[k])
    plain = cr.learn(MAZE, budget=500, seeds=2, stream="control source")
    np.testing.assert_array_equal(itself["result"].values, plain.values)
    np.testing.assert_array_equal(
        found["transfer, pretraining"].curve.values[:, 0], plain.greedy_return[:, -1]
    )


@pytest.mark.parametrize("task", [MAZE.mdp, Pursuit(3, 1)], ids=["tables", "pursuit"])
def test_any_task_with_tables_can_be_started_anywhere(task, calls):
    compare(copied(task), seeds=1, controls=["random_start"])
    (source,) = (call["task"] for call in calls if call["stream"] == "control source")
    alive = ~task.mdp.terminal
    np.testing.assert_allclose(source.mdp.start, alive / alive.sum())
    assert source.mdp.reward is task.mdp.reward


@pytest.mark.parametrize("plan", [corner, pursuit])
def test_controls_change_the_values_of_phi_alone(plan, calls):
    found = compare(plan(), seeds=[4, 9], controls=["placebo", "scaled", "negated"])
    assert len(found.arms) == 6
    target = plan().target
    arm, placebo, half, twice, negated = (call for call in calls[1:] if call["stream"] == target)
    alive = ~plan().tasks[target].mdp.terminal
    for k in range(2):
        phi = arm["potential"][k].values
        assert len(np.unique(phi)) > 5
        np.testing.assert_allclose(half["potential"][k].values, phi / 2, rtol=1e-15)
        np.testing.assert_array_equal(twice["potential"][k].values, 2 * phi)
        np.testing.assert_array_equal(negated["potential"][k].values, -phi)
        dealt = placebo["potential"][k].values
        np.testing.assert_array_equal(np.sort(dealt[alive].ravel()), np.sort(phi[alive].ravel()))
        assert not dealt[~alive].any()
        assert (dealt[alive] != phi[alive]).mean() > 0.3
    keep = (
        "task",
        "seeds",
        "how",
        "guard",
        "eval_freq",
        "evaluation",
        "storage",
        "stream",
        "budget",
    )
    for call in (placebo, half, twice, negated):
        assert {name: call[name] for name in keep} == {name: arm[name] for name in keep}


def test_each_seed_is_dealt_its_own_hand(calls):
    """At rate 1 all seeds learn the same of a deterministic maze, after a while."""
    learner = cr.QLearning(learning_rate=1.0, epsilon=1.0)
    plan = copied(MAZE, learner={"near": learner}, budget={"near": 20_000, "far": 100})
    compare(plan, seeds=2, controls=["placebo"], window=1)
    (one, other), dealt = (call["potential"] for call in calls[2:])
    np.testing.assert_array_equal(one.values, other.values)
    assert (dealt[0].values != dealt[1].values).mean() > 0.5


def test_a_potential_of_states_is_changed_before_it_is_one(calls):
    compare(corner(how="state"), seeds=1, controls=["negated"])
    arm, negated = (call for call in calls[2:] if call["stream"] == "maze")
    (q,) = (call["result"].values[0] for call in calls if call["stream"] == "corner")
    phi = HERE.read(q)
    np.testing.assert_array_equal(arm["potential"][0].values[0], phi.max(axis=1))
    np.testing.assert_array_equal(negated["potential"][0].values[0], (-phi).max(axis=1))


def test_controls_of_a_target_whose_values_are_not_kept(calls):
    plan = corner(storage={"maze": cr.Storage(save_values=False)})
    found = compare(plan, seeds=1, controls=ALL)
    assert len(found.arms) == 8
    assert all(call["result"].values is None for call in calls if call["stream"] == "maze")


def test_knowing_the_optimum_pays_and_its_negation_does_not():
    """What the controls are for. 8 seeds: the least p of them is 2^-7, times 3 arms 0.02."""
    plan = copied(MAZE, budget={"near": 20_000, "far": 20_000}, eval_freq={"far": 200})
    found = compare(plan, seeds=8, controls=["placebo", "negated"], window=1)
    free = {name: arm.curve.values[:, :101].mean() for name, arm in found.arms.items()}
    assert free["transfer"] > free["scratch"] > free["transfer, negated"]
    assert free["transfer"] > free["transfer, placebo"]
    assert found.contrasts["transfer, negated"].verdict == "costs more than it brings"
    assert found.contrasts["transfer"].jumpstart.low > 0


# -- measures, by hand -----------------------------------------------------------------------------

STEPS = np.array([0, 10, 20, 30, 40])


def arm(rows, source=0, control=False):
    values = np.array(rows, dtype=float)
    return Arm(Curve(STEPS, values, np.full(len(values), source)), values, values, control)


BY_HAND = Comparison(
    target="maze",
    arms={
        "scratch": arm([[0, 0, 1, 2, 3], [0, 0, 1, 2, 3]]),
        "taught": arm([[2, 4, 4, 4, 4], [2, 4, 4, 4, 4]], source=20),
        "misled": arm([[-2, -2, 0, 0, 1], [-2, 0, 2, 2, 2]], source=10, control=True),
    },
    budget=20,
    total=40,
    threshold=2.0,
    window=1,
)


def test_measures_by_hand():
    """Charged, the arms are 0, 0, 2, 4, 4 and 0, -2, -2, 0, 0 or 0, -2, 0, 2, 2."""
    taught, misled = (BY_HAND.contrasts[name] for name in ("taught", "misled"))
    assert BY_HAND.seeds == 2
    assert taught.jumpstart.estimate == 2.0
    assert taught.saved.estimate == 20.0  # direct never within its own 20 steps, hence 20
    assert taught.strong_steps_saved.estimate == 10.0  # 30 against 20
    assert taught.gain.estimate == (0 + 10 + 30 + 40) / 40 - (0 + 5 + 15 + 25) / 40
    assert taught.final.estimate == 1.0
    assert taught.better.estimate == 1.0
    assert misled.jumpstart.estimate == -2.0
    assert misled.saved.estimate == 0.0  # 20 and 20 at most, and 20 and 20
    assert misled.strong_steps_saved.estimate == (30 - 40 + 30 - 30) / 2
    assert (
        misled.gain.estimate == ((-10 - 20 - 10 - 0) / 40 + (-10 - 10 + 10 + 20) / 40) / 2 - 1.125
    )
    assert misled.final.estimate == -2.0
    assert misled.better.estimate == 0.0
    assert BY_HAND.times("misled").reached.tolist() == [False, True]
    assert BY_HAND.times("misled").steps.tolist() == [40.0, 30.0]
    assert BY_HAND.times("misled", strong=False).steps.tolist() == [20.0, 20.0]
    assert BY_HAND.times("taught", strong=False).steps.tolist() == [0.0, 0.0]
    assert BY_HAND.height("taught").estimate == 2.0


def test_measures_are_those_of_the_metrics():
    arms = {"one": corner(HERE, 100, 200, 10), "two": corner(HERE, 160, 200, 10)}
    found = compare(arms, seeds=8, window=3, threshold=150)
    free = slice(0, 21)
    scratch = found.scratch.curve
    base = Curve(scratch.steps[free], scratch.values[:, free])
    for name in ("one", "two"):
        curve, contrast = found[name].curve, found.contrasts[name]
        weak, charged = Curve(base.steps, curve.values[:, free]), charge_source(scratch, curve)
        settings = {"threshold": 150.0, "window": 3}
        expected = {
            "jumpstart": cr.statistics.jumpstart(base, weak),
            "saved": cr.statistics.steps_saved(base, weak, **settings),
            "strong_steps_saved": cr.statistics.steps_saved(scratch, charged, **settings),
            "gain_free": cr.statistics.mean_return(weak) - cr.statistics.mean_return(base),
            "gain": cr.statistics.mean_return(charged) - cr.statistics.mean_return(scratch),
            "final": cr.statistics.asymptotic_performance(charged)
            - cr.statistics.asymptotic_performance(scratch),
        }
        for measure, values in expected.items():
            assert values.any(), measure
            interval, wanted = getattr(contrast, measure), cr.statistics.bootstrap(values)
            assert (interval.estimate, interval.low, interval.high) == pytest.approx(
                (wanted.estimate, wanted.low, wanted.high)
            ), measure
        np.testing.assert_array_equal(found[name].gain(found.scratch), expected["gain"])
        wins = cr.statistics.probability_of_improvement(
            cr.statistics.mean_return(charged), cr.statistics.mean_return(scratch)
        )
        assert contrast.better.estimate == wins.estimate
        middle = np.sort(cr.statistics.mean_return(charged))[2:-2].mean()  # of eight
        assert found.height(name).estimate == pytest.approx(middle)
        assert contrast.p == cr.statistics.sign_flip_test(expected["gain"])


def test_tests_are_corrected_for_the_number_of_arms():
    found = compare({"one": corner(), "two": corner(source=900)}, seeds=6, controls=["scaled"])
    assert len(found.contrasts) == 6
    assert "scratch" not in found.contrasts
    adjusted = cr.statistics.holm({name: one.p for name, one in found.contrasts.items()})
    assert {name: one.adjusted for name, one in found.contrasts.items()} == adjusted
    assert any(one.adjusted > one.p for one in found.contrasts.values())


@pytest.mark.parametrize(
    ("height", "verdict"),
    [(1, "pays"), (-1, "costs more than it brings"), (0, "no difference shown")],
)
def test_verdicts(height, verdict):
    """Seven seeds of equal sign have p = 2^-6 = 0.016; among four equal arms 0.0625."""
    scratch, other = arm(np.zeros((7, 5))), arm(np.full((7, 5), height))
    for arms, expected in ((1, verdict), (4, "no difference shown")):
        names = [f"arm {i}" for i in range(arms)]
        found = replace(BY_HAND, arms={"scratch": scratch, **dict.fromkeys(names, other)})
        assert found.contrasts["arm 0"].verdict == expected
        assert found.contrasts["arm 0"].p == (2**-6 if height else 1.0)


# -- the threshold ---------------------------------------------------------------------------------


def test_the_threshold_lies_nine_tenths_of_the_way_to_the_optimum():
    found = compare(corner(), seeds=1)
    target = cr.planning.Target.of(MAZE)
    assert found.threshold == pytest.approx(0.9 * target.optimum + 0.1 * target.random_return)
    assert compare(corner(), seeds=1, threshold=50).threshold == 50.0


def test_the_threshold_of_a_target_too_large_to_solve_is_the_direct_learners(monkeypatch):
    monkeypatch.setattr(judging, "LARGEST_SOLVED", 0)
    found = compare(corner(), seeds=3)
    assert found.threshold == cr.statistics.midpoint(found.scratch.curve)


@pytest.mark.parametrize(
    "task",
    [
        FiniteMDP.from_outcomes(
            [[[(1.0, 1, 5.0)]], [[]]], terminal=[False, True], start=0, discount=0.9
        ),
        GridWorld("S..T", discount=1.0, time_limit=20),
        # 1 now or 5 later: at this discount 1 now is optimal, and half of the 6 is more.
        FiniteMDP.from_outcomes(
            [[[(1.0, 2, 1.0)], [(1.0, 1, 0.0)]], [[(1.0, 2, 5.0)]] * 2, [[], []]],
            terminal=[False, False, True],
            start=0,
            discount=0.1,
            time_limit=20,
        ),
    ],
    ids=["nothing to choose", "discount 1", "too impatient"],
)
def test_where_an_optimum_tells_nothing_the_direct_learner_does(task):
    summed = GreedyEvaluation(discounted=False)
    found = compare(copied(replace(task, time_limit=20), evaluation=summed), seeds=2)
    assert found.threshold == cr.statistics.midpoint(found.scratch.curve)


# -- more seeds ------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", [500, Episodes(40)], ids=["steps", "episodes"])
def test_seeds_are_added_as_if_they_had_been_there(source):
    """Looks at 2, 4 and 7 seeds, none of them precise enough."""
    plan = corner(source=source, target=1000)
    grown = compare(plan, seeds=2, precision=1e-9, most_seeds=7, controls=ALL)
    once = compare(plan, seeds=7, controls=ALL)
    assert grown.seeds == 7
    assert (grown.budget, grown.total, grown.threshold) == (once.budget, once.total, once.threshold)
    for name in once.arms:
        assert_same(grown[name], once[name])


def test_no_more_seeds_than_it_takes():
    plan = copied(MAZE, budget={"near": 20_000, "far": 2000}, eval_freq={"far": 100})
    assert compare(plan, seeds=3, precision=1000.0).seeds == 3
    found = compare(plan, seeds=3, difference=True, most_seeds=50)
    assert 3 <= found.seeds < 50
    gains = found["transfer"].gain(found.scratch)
    alone = cr.statistics.add_seeds(
        lambda seeds: gains[list(seeds)], first=3, most=50, difference=True
    )
    assert alone.stopped_by == "difference"
    assert alone.values.size == found.seeds


# -- as data and as text ---------------------------------------------------------------------------


def test_rows_are_a_table():
    rows = BY_HAND.rows()
    assert [row["arm"] for row in rows] == ["scratch", "taught", "misled"]
    assert len({tuple(row) for row in rows}) == 1
    scratch, taught, misled = rows
    assert (scratch["control"], misled["control"]) == (False, True)
    assert (taught["source_steps"], taught["steps_to_threshold"], taught["reached"]) == (20, 20, 2)
    assert (misled["source_steps"], misled["steps_to_threshold"], misled["reached"]) == (10, 35, 1)
    assert {row["seeds"] for row in rows} == {2}
    for row in (taught, misled):
        contrast = BY_HAND.contrasts[row["arm"]]
        for measure in (
            "jumpstart",
            "saved",
            "strong_steps_saved",
            "gain_free",
            "gain",
            "final",
            "better",
        ):
            interval = getattr(contrast, measure)
            found = row[measure], row[f"{measure}_low"], row[f"{measure}_high"]
            assert found == (interval.estimate, interval.low, interval.high)
            assert np.isnan([scratch[measure], scratch[f"{measure}_low"]]).all()
        assert (row["p"], row["p_adjusted"]) == (contrast.p, contrast.adjusted)
        assert row["verdict"] == contrast.verdict
    assert scratch["return"] == 1.125
    assert scratch["verdict"] == ""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(scratch))
    writer.writeheader()
    writer.writerows(rows)
    assert len(text.getvalue().splitlines()) == 4


def test_a_comparison_prints_as_a_table():
    lines = str(BY_HAND).split("\n")
    assert lines[0] == "'maze' in 40 steps, sources charged; 2 seeds; threshold 2"
    assert [line.split()[0] for line in lines[2:]] == ["scratch", "taught", "misled"]
    assert lines[2].split(maxsplit=2)[1:] == ["30", "1.12 [1.12, 1.12]"]
    assert lines[3].endswith("3.25 [3.25, 3.25]     no difference shown (p = 1)")
    assert "> 35 (1 never)" in lines[4]
    headings = (
        "steps to threshold",
        "mean return (IQM)",
        "gain over direct",
        "sources free",
        "verdict",
    )
    for column in headings:
        assert column in lines[1]
    assert lines[1].index("gain over direct") == lines[3].index("0.875")


def test_a_line_for_each_arm():
    found = compare({"one": corner(), "two": corner()}, seeds=2, controls=ALL)
    lines = str(found).split("\n")
    assert len(lines) == 2 + len(found.arms)
    for name, line in zip(found.arms, lines[2:], strict=True):
        assert line.startswith(name + "  ")


def test_progress_is_told_of_each_arm():
    told = []
    found = compare(corner(), seeds=1, controls=["scaled"], progress=told.append)
    assert told == list(found.arms)


def test_an_unknown_arm():
    with pytest.raises(CurriculumError) as caught:
        BY_HAND["best"]
    assert str(caught.value) == "an arm must be one of direct, taught, misled: got 'best'"


# -- refusals: targets that are not one ------------------------------------------------------------

FORK = [[[(1.0, 1, 1.0)], [(1.0, 2, 1.0)]], [[(1.0, 3, 2.0)]] * 2, [[(1.0, 3, 2.0)]] * 2, [[], []]]


def fork(outcomes=FORK, **changes):
    settings = {"terminal": [False] * 3 + [True], "start": 0, "discount": 0.9} | changes
    return FiniteMDP.from_outcomes(outcomes, **settings)


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (
            fork(terminal=[False, False, True, True]),
            "end rule (state 2 ends one of them only)",
        ),
        (
            fork([FORK[0], [[(1.0, 3, 5.0)]] * 2, *FORK[2:]]),
            "reward (from state 1: 2 against 5)",
        ),
        (fork([[FORK[0][0]] * 2, *FORK[1:]]), "transitions (from state 0)"),
        (fork(start=2), "start (state 0: 1 against 0)"),
        (fork(discount=0.5), "discount (0.9 against 0.5)"),
        (fork(time_limit=7), "time_limit (None against 7)"),
        (
            fork([*FORK, FORK[3]], terminal=[False] * 3 + [True] * 2),
            "states (4 against 5)",
        ),
    ],
    ids=["end", "reward", "transitions", "start", "discount", "limit", "states"],
)
def test_targets_that_are_not_one_problem_are_refused(other, difference, calls):
    arms = {"one": copied(fork()), "two": copied(fork()), "three": copied(other)}
    with pytest.raises(CurriculumError) as caught:
        compare(arms, seeds=1)
    assert str(caught.value) == (
        f"arms must share their target: those of 'one' and 'three' differ in {difference}"
    )
    assert calls == []


def test_all_differences_are_named_at_once():
    with pytest.raises(CurriculumError) as caught:
        compare({"one": copied(fork()), "two": copied(fork(discount=0.5, start=1))}, seeds=1)
    assert str(caught.value).endswith(
        "differ in discount (0.9 against 0.5); start (state 0: 1 against 0)"
    )


def test_one_problem_in_other_words_is_compared():
    found = compare({"maze": copied(MAZE), "tables": copied(MAZE.mdp)}, seeds=2)
    assert_same(found["maze"], found["tables"])


@pytest.mark.parametrize(
    ("which", "mine", "yours"),
    [
        ("evaluation", GreedyEvaluation(), GreedyEvaluation(discounted=False)),
        ("budget", 100, 200),
        ("learner", cr.QLearning(), cr.QLearning(epsilon=0.2)),
        ("learner", cr.QLearning(), cr.SARSA()),
        ("eval_freq", 10, 20),
    ],
)
def test_targets_that_are_not_learnt_alike_are_refused(which, mine, yours, calls):
    one, two = (copied(MAZE, **{which: {"far": setting}}) for setting in (mine, yours))
    with pytest.raises(CurriculumError) as caught:
        compare({"one": one, "two": two}, seeds=1)
    assert str(caught.value) == (
        f"arms must share their target's {which}: 'one' and 'two' have {mine} and {yours}"
    )
    assert calls == []


def test_sources_may_be_learnt_otherwise():
    one, two = (copied(MAZE, learner={"near": kind()}) for kind in (cr.QLearning, cr.SARSA))
    assert compare({"one": one, "two": two}, seeds=1).seeds == 1


def test_targets_of_other_names_are_refused():
    with pytest.raises(CurriculumError) as caught:
        compare({"one": copied(MAZE), "two": copied(MAZE, target="away")}, seeds=1)
    assert str(caught.value) == (
        "arms must share their target: 'one' and 'two' have 'far' and 'away'"
    )


# -- refusals: what makes no sense -----------------------------------------------------------------

RING = cr.ComputedMDP(
    cr.Space([cr.Component("place", 9)]),
    cr.Space([cr.Component("move", 2)]),
    lambda data, bits: 1,
    lambda data, state, action, bits: (state - 1 + 2 * action, -1.0, state < 1),
)


@pytest.mark.parametrize(
    ("arms", "settings", "message"),
    [
        ({}, {}, "a comparison needs at least one curriculum: got none"),
        ([corner()], {}, r"arms, unless they are one curriculum, must be a Mapping: got \["),
        ({"mine": 3}, {}, "arm 'mine' must be a Curriculum: got 3"),
        ({"scratch": corner()}, {}, "an arm 'scratch' is always there: name yours otherwise"),
        (
            corner(target=Episodes(9)),
            {},
            "a comparison at one total budget needs the target's in steps: 'maze' has 9 episodes",
        ),
        (
            Curriculum({"a": MAZE, "b": MAZE}),
            {},
            "a curriculum must have one task that no other builds on: got a, b",
        ),
        (
            copied(replace(MAZE, time_limit=None), budget={"near": Episodes(3), "far": 100}),
            {},
            "a budget in episodes needs a task with a time limit: none set",
        ),
        (
            corner(),
            {"controls": ["negated", "magic"]},
            "a control must be one of random_start, .*, negated: got 'magic'",
        ),
        (
            {"plain": Curriculum({"maze": MAZE}, budget=100)},
            {"controls": ["scaled"]},
            "controls need a transfer into the target: arm 'plain' has none into 'maze'",
        ),
        (
            {"mine": copied(RING)},
            {"controls": ["placebo"]},
            "a task given by functions or played live has no tables to look at",
        ),
        (
            {"mine": pursuit(storage={"hunt": cr.Storage(kind="sparse")})},
            {"controls": ["scaled", "pretraining"]},
            "controls other than 'scaled' need dense tables of the target: the storage of 'hunt' "
            "is sparse in arm 'mine'",
        ),
        (corner(), {"window": 0}, "window must be a whole number, at least 1: got 0"),
        (
            corner(),
            {"window": 32},
            "window must be at most 31, the checkpoints within the target's budget: got 32",
        ),
        (corner(), {"threshold": float("nan")}, "threshold must be finite: got nan"),
        (corner(), {"seeds": 0}, "seeds must be a whole number, at least 1: got 0"),
        (
            corner(),
            {"seeds": 1, "precision": 1.0},
            "to begin adding with must be a whole number, at least 2",
        ),
        (corner(), {"seeds": 5, "precision": 0.0}, "precision must be above 0: got 0"),
        (
            corner(),
            {"seeds": 5, "precision": 1.0, "difference": True},
            "stops at a precision or at a difference, one of them",
        ),
        (
            corner(),
            {"seeds": 30, "difference": True, "most_seeds": 20},
            "most must be a whole number, at least 30: got 20",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_trained(arms, settings, message, calls):
    with pytest.raises((CurriculumError, SettingError, cr.errors.TaskError), match=message):
        compare(arms, **({"seeds": 1} | settings))
    assert calls == []


def test_the_largest_window_is_the_targets_whole_budget():
    found = compare(corner(), seeds=2, window=31)
    assert len(str(found).split("\n")) == 4


def test_a_curriculum_without_transfers_is_the_direct_learner():
    plan = Curriculum({"maze": MAZE}, budget={"maze": 1000}, eval_freq=100)
    found = compare({"plain": plan}, seeds=3)
    assert found.total == 1000
    np.testing.assert_array_equal(found["plain"].curve.values, found.scratch.curve.values)
    assert found.contrasts["plain"].p == 1.0


def test_scaled_potentials_serve_sparse_tables_too():
    plan = pursuit(storage={"hunt": cr.Storage(kind="sparse")})
    found = compare(plan, seeds=1, controls=["scaled"])
    dense = compare(pursuit(), seeds=1, controls=["scaled"])
    for name in dense.arms:
        assert_same(found[name], dense[name])
