"""Curricula: which task is trained when, how often, and on what."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.errors import CurriculumError
from curricle.learning import OptimisticQLearning

MAZE = cr.GridWorld(["S...", "....", "...T"])
TASKS = {
    "far": MAZE,
    "left": MAZE.crop(rows=(1, 3), columns=(0, 4)),
    "right": MAZE.crop(rows=(0, 3), columns=(2, 4)),
    "near": MAZE.crop(rows=(1, 3), columns=(2, 4)),
}
DIAMOND = [("near", "left"), ("near", "right"), ("left", "far"), ("right", "far")]
CHAIN = [("near", "left"), ("left", "far")]


def edges(pairs, **settings):
    return [cr.Transfer(s, t, cr.same_position(TASKS[t], TASKS[s], **settings)) for s, t in pairs]


def one_each(kind, result, name):
    return [kind(potential) for potential in result.potentials[name]]


def build(pairs, **settings):
    names = {name for pair in pairs for name in pair}
    tasks = {name: task for name, task in TASKS.items() if name in names}
    plain = {"budget": cr.StoppingRule(300), "shaping": cr.QInitialisation()}
    return cr.Curriculum(**{"tasks": tasks, "transfers": edges(pairs), **plain, **settings})


def same(first, second):
    return (
        np.array_equal(first.values, second.values)
        and np.array_equal(first.greedy_return, second.greedy_return)
        and np.array_equal(first.training_return, second.training_return, equal_nan=True)
    )


def test_source_steps_count_every_ancestor_once():
    steps = {"near": 100, "left": 200, "right": 400, "far": 800}
    budget = {name: cr.StoppingRule(most) for name, most in steps.items()}
    result = build(DIAMOND, budget=budget).train(seeds=2)
    assert result.source_steps("far").tolist() == [700, 700]
    assert result.source_steps("right").tolist() == [100, 100]
    assert result.source_steps("near").tolist() == [0, 0]


def test_a_target_starts_from_its_source_seed_by_seed():
    result = build([("near", "far")]).train(seeds=[4, 2])
    (edge,) = result.curriculum.in_edges("far")
    for k in range(2):
        read = edge.mapping.read(result["near"].values[k])
        assert np.isnan(read).any()  # states outside of the source
        assert (result.potentials["far"][k].values == np.nan_to_num(read)).all()
    started = {"shaping": one_each(cr.QInitialisation, result, "far"), "stream": "far"}
    assert same(cr.learn(MAZE, budget=300, seeds=[4, 2], **started), result["far"])


def test_knowledge_passes_through_an_intermediate_task():
    # Nothing is learnt on the way: what arrives is what the first task knew.
    result = build(CHAIN, learner={"left": cr.QLearning(learning_rate=0)}).train()
    near, through = result["near"].values[0], result.potentials["far"][0].values
    assert near.any()
    for row, column in [(1, 2), (1, 3), (2, 2)]:
        here, there = TASKS["near"].state(row, column), MAZE.state(row, column)
        assert (through[there] == near[here]).all()


def test_one_source_serves_through_two_mappings():
    hunt, chase = cr.Pursuit(size=2, predators=2), cr.Pursuit(size=2, predators=1)
    both = [
        cr.Transfer("chase", "hunt", cr.project(hunt, chase, predator=p), scale=scale)
        for p, scale in (("predator_1", 1), ("predator_2", 3))
    ]
    seen, settings = [], {"budget": cr.StoppingRule(200)}
    settings["aggregate"] = lambda p: seen.append(p) or p[1]
    result = cr.Curriculum({"hunt": hunt, "chase": chase}, both, **settings).train()
    q = result["chase"].values[0]
    assert [p.shape for p in seen] == [(2, 64, 25)]
    assert (seen[0][0] == both[0].mapping.read(q)).all()
    assert (seen[0][1] == both[1].mapping.read(3 * q)).all()
    assert result.source_steps("hunt").tolist() == [200]


def test_the_end_is_worth_nothing_whatever_is_handed_on():
    shifted = [
        cr.Transfer(t.source, t.target, t.mapping, shift=50)
        for t in edges([("near", "far")], unmapped_value=9)
    ]
    tasks = {name: TASKS[name] for name in ("near", "far")}
    result = cr.Curriculum(tasks, shifted, budget=100, aggregate=lambda p: p[0] + 1000).train()
    assert (result.potentials["far"][0].values[MAZE.mdp.terminal] == 0).all()
    assert (result["far"].values[0][MAZE.mdp.terminal] == 0).all()
    assert result.potentials["far"][0].values[0, 0] == 1009


def test_results_do_not_depend_on_the_order_of_the_tasks_or_edges():
    straight = build(DIAMOND).train(seeds=2)
    turned = cr.Curriculum(
        dict(reversed(TASKS.items())),
        list(reversed(edges(DIAMOND))),
        budget=cr.StoppingRule(300),
        shaping=cr.QInitialisation(),
    ).train(seeds=2)
    for name in TASKS:
        assert same(straight[name], turned[name])


def test_trained_results_and_their_values_are_reused_bit_for_bit():
    fresh = build(DIAMOND).train(seeds=2)
    before = {name: fresh[name].values.copy() for name in TASKS}
    kept = {name: fresh[name] for name in ("near", "right")}
    again = build(DIAMOND).train(seeds=2, trained=kept)
    assert again["near"] is fresh["near"]
    assert set(again.potentials) == {"left", "far"}
    assert all(same(fresh[name], again[name]) for name in TASKS)
    assert all((before[name] == fresh[name].values).all() for name in TASKS)
    assert set(kept) == {"near", "right"}
    # Values are all that later tasks need of a source.
    read = build(DIAMOND).train(seeds=2, trained={name: fresh.sources[name] for name in kept})
    assert set(read.nodes) == {"left", "far"}
    assert all(same(fresh[name], read[name]) for name in read.nodes)
    for result in (again, read):
        assert result.source_steps("far").tolist() == fresh.source_steps("far").tolist()


def test_each_task_may_have_its_own_settings():
    result = build(
        CHAIN,
        learner={"left": cr.SARSA(learning_rate=0.5)},
        budget={"near": cr.Episodes(3), "left": 50},
        eval_freq={"near": 10, "left": 25, "far": 50_000},
        evaluation={"left": cr.GreedyEvaluation(discounted=False)},
    ).train()
    assert result["near"].learner == OptimisticQLearning()  # the default of a first source
    assert result["left"].learner == cr.SARSA(learning_rate=0.5)
    assert result["near"].episodes_used.tolist() == [3]
    assert result["left"].steps.tolist() == [0, 25, 50]
    assert result["far"].steps.tolist() == [0, 50_000, 100_000]
    by_hand = cr.learn(
        TASKS["left"], cr.SARSA(learning_rate=0.5), 50, eval_freq=25,
        shaping=one_each(cr.QInitialisation, result, "left"),
        evaluation=cr.GreedyEvaluation(discounted=False), stream="left",
    )  # fmt: skip
    assert same(by_hand, result["left"])


def test_state_shaping_uses_the_largest_action_value_of_a_state():
    result = build([("near", "far")], shaping={"far": cr.StateShaping()}).train()
    (phi,) = result.potentials["far"]
    assert isinstance(phi, cr.StateActionPotential)
    state = phi.to_state()
    assert (state.values[0] == phi.values.max(axis=1)).all()
    by_hand = cr.learn(MAZE, budget=300, shaping=cr.StateShaping(state), stream="far")
    assert same(by_hand, result["far"])
    assert not same(build([("near", "far")]).train()["far"], result["far"])


def test_a_curriculum_does_not_change_with_the_callers_containers():
    tasks, transfers = {"near": TASKS["near"], "far": MAZE}, edges([("near", "far")])
    curriculum = cr.Curriculum(tasks, transfers, budget=10)
    tasks.clear()
    transfers.clear()
    assert set(curriculum.train().nodes) == {"near", "far"}


@pytest.mark.parametrize(
    ("storage", "last", "expected"),
    [("auto", True, True), ("sparse", True, True), ("dense", True, False), ("auto", False, False)],
)
def test_large_tasks_have_portfolios_where_their_tables_may_be_sparse(storage, last, expected):
    huge, chase = cr.Pursuit(50, 2), cr.Pursuit(3, 1)
    tasks = {"chase": chase, "hunt": huge, "more": cr.Pursuit(50, 2, time_limit=99)}
    of = [cr.Transfer("chase", "hunt", cr.project(huge, chase, predator="predator_1"))]
    of += [cr.Transfer("hunt", "more", cr.project(tasks["more"], huge))]
    tasks, of = (tasks, of) if not last else (dict(list(tasks.items())[:2]), of[:1])
    plan = cr.Curriculum(tasks, of, storage={"hunt": cr.Storage(storage)})
    assert (plan.setting("shaping", "hunt").portfolio is not None) == expected


def test_tasks_that_have_sources_have_portfolios():
    result = build(CHAIN, budget=2000, shaping=cr.QInitialisation(portfolio=cr.Portfolio())).train()
    assert np.isnan(result["near"].source_share).all()
    assert np.isin(result["far"].source_share, (0, 1)).all()


def test_only_some_tasks_are_trained_with_what_they_build_on():
    plan = cr.Curriculum(tasks=TASKS, transfers=edges(DIAMOND), budget=100)
    assert plan.target == "far"
    result = plan.train(only="left")
    assert list(result.nodes) == ["near", "left"]
    rest = plan.train(trained=result.nodes)
    whole = plan.train()
    np.testing.assert_array_equal(rest["far"].values, whole["far"].values)
    with pytest.raises(CurriculumError, match="a task must be one of"):
        plan.train(only=["left", "nowhere"])


def test_potentials_are_those_that_training_starts_from():
    plan = cr.Curriculum(tasks=TASKS, transfers=edges(DIAMOND), budget=200, aggregate=cr.minimum)
    result = plan.train(seeds=2)
    for expected, used in zip(
        plan.potentials("far", result.nodes), result.potentials["far"], strict=True
    ):
        np.testing.assert_array_equal(expected.values, used.values)
    alone = plan.potentials("far", result.nodes, transfers=plan.in_edges("far")[:1])
    doubled = replace(plan, aggregate=cr.total).potentials("far", result.nodes)
    single = plan.in_edges("far")[0].potential(result["left"].values[0])
    single = np.where(MAZE.mdp.terminal[:, None], 0, np.nan_to_num(single))
    np.testing.assert_array_equal(alone[0].values, single)
    assert (doubled[0].values != result.potentials["far"][0].values).any()
    assert plan.potentials("near", result.nodes) == []


def trained_on_a_bonus():
    """Values that contain what shaping added, as a source's."""
    shaped = cr.learn(TASKS["left"], budget=300, shaping=cr.RewardBonus(np.ones((8, 4))))
    return build([("left", "far")]).train(trained={"left": shaped})


def all_trained_before():
    plan = build([("near", "left")])
    return plan.train(trained=plan.train().sources)


SEEN = cr.transfer.identity(cr.observation_task("MountainCar-v0"))
CONSTANT = {"far": cr.StateShaping(np.zeros(12))}
EPISODES = {"budget": {"far": cr.Episodes(30)}}
REFUSED = [
    (lambda: build(CHAIN).replace("far", rate=0.1), r"must be one of aggregate, .*: got 'rate'"),
    (lambda: build(CHAIN).replace("farther", budget=10), r"task must be one of .*: got 'farther'"),
    (lambda: build([("near", "far")], shaping=CONSTANT), r"of its own.*: that of far has"),
    (lambda: build(CHAIN, shaping={"left": cr.RewardBonus()}), "own rewards: RewardBonus changes"),
    (trained_on_a_bonus, "'left', which 'far' reads, contain shaping"),
    (lambda: build(CHAIN, **EPISODES).train(charge=True), "that of target 'far' is 30 episodes"),
    (lambda: all_trained_before().frame(), "a frame needs a task that was trained here: all came"),
    (lambda: cr.Transfer("a", "b", SEEN).potential(np.zeros((3, 3))), "a -> b reads observations"),
]


@pytest.mark.parametrize(("call", "says"), REFUSED)
def test_what_makes_no_sense_is_refused(call, says):
    with pytest.raises(CurriculumError, match=says):
        call()
