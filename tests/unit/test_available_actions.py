"""Tasks that say which actions are available: where they say it, and who asks."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import chi2_contingency, chisquare

import curricle as cr
from curricle.comparison.task_differences import summary_differences, task_summary
from curricle.errors import SettingError, TaskError
from curricle.interop import from_gymnasium, tabulate, to_gymnasium
from curricle.learning import OptimisticQLearning, RMax
from curricle.planning.rollouts import random_rollouts, rollout
from curricle.tasks import ComputedMDP
from curricle.transfer.rollouts import potential_return
from curricle.transfer.search import score_mapping
from tests.support.tasks import dense_of, random_mdp, ring_start, with_masks

LIVE = [(1.0, 1, 0.0)]


def two_states(first, **settings):
    """Return a task that may end at once, its outcome lists of the first state as given."""
    terminal = [False, True]
    return cr.FiniteMDP.from_outcomes(
        [first, [[]] * len(first)], terminal=terminal, start=0, discount=0.9, **settings
    )


def test_tables_say_which_actions_are_available():
    task = two_states([[(1.0, 1, 1.0)], [], [(1.0, 1, 2.0)]])
    assert task.available.tolist() == [[True, False, True], [True, True, True]]
    assert cr.solve(task).action_values.tolist() == [[1.0, -np.inf, 2.0], [0.0, 0.0, 0.0]]
    assert task.random_policy.tolist()[0] == [0.5, 0.0, 0.5]
    task = cr.FiniteMDP.from_dense(
        [[[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0], [0.0, 1.0]]], [[5.0, 7.0], [0.0, 0.0]],
        terminal=[False, True], start=0, discount=0.9, available=[[1, 0], [1, 1]],
    )  # fmt: skip
    assert cr.solve(task).values.tolist() == [5.0, 0.0]
    # Where every action is available nothing is kept.
    assert two_states([LIVE, LIVE]).available is None
    task = random_mdp(0)
    assert replace(task, available=np.ones(task.outcome_row.shape)).available is None


def test_what_cannot_be_available_actions_is_refused():
    with pytest.raises(TaskError, match="needs an available action: state 0 has none"):
        two_states([[], []])
    for available in (np.ones(3), np.full((6, 3), 2), "all"):
        with pytest.raises(TaskError, match="available"):
            replace(random_mdp(0), available=available)
    with pytest.raises(TaskError, match="available of a computed task must return a flag"):
        cr.learn(replace(ring(), available=lambda n, state, action: "yes"), budget=100)


@pytest.mark.parametrize("policy", [[1, 0], [[0.5, 0.5], [1.0, 0.0]]])
def test_a_policy_that_takes_an_unavailable_action_is_refused(policy):
    task = two_states([LIVE, []], time_limit=5)
    for use in (cr.evaluate, rollout):
        with pytest.raises(SettingError, match=r"0 it takes action 1, available are \[0\]"):
            use(task, policy)


def test_derived_tasks_keep_the_available_actions():
    task = with_masks(random_mdp(1), 1)
    elsewhere = cr.tasks.with_start(task, "reachable")
    np.testing.assert_array_equal(elsewhere.mdp.available, task.available)
    np.testing.assert_array_equal(replace(task, discount=0.5).available, task.available)
    assert cr.tasks.with_start(random_mdp(1), "reachable").mdp.available is None


@pytest.mark.parametrize("by", ["tables", "functions"])
def test_random_rollouts_are_uniform_over_available_actions(by):
    # One state of five actions, two of them not available, and an outcome of chance: actions must
    # be uniform and say nothing about outcomes. Fixed seeds; a false alarm in 1,000 of them each.
    available = np.array([True, False, True, True, False])
    outcomes = [(0.5, 0, 0.0), (0.5, 0, 1.0)]
    if by == "tables":
        task = cr.FiniteMDP.from_outcomes(
            [[outcomes if a else [] for a in available]], terminal=[False], start=0, discount=0.9
        )
    else:
        task = ComputedMDP(
            cr.Space([cr.Component("state", 1)]), cr.Space([cr.Component("action", 5)]),
            lambda data, bits: 0,
            lambda data, state, action, bits: (0, 1.0 * (bits % 2), False),
            time_limit=None, available=lambda data, state, action: action in (0, 2, 3),
        )  # fmt: skip
    actions = random_rollouts(task, episodes=30, length=1000)[0].actions
    counts = np.bincount(actions, minlength=5)
    assert not counts[~available].any()
    assert chisquare(counts[available]).pvalue > 1e-3
    result = cr.learn(task, cr.QLearning(epsilon=1.0, learning_rate=0.001), 30_000)
    assert (np.isneginf(result.values[0][0]) == ~available).all()
    environment, rewards = to_gymnasium(task), []
    environment.reset(seed=0)
    environment.action_space.seed(0)
    for _ in range(300):
        mask = environment.action_masks().astype(np.int8)
        rewards.append(environment.step(environment.action_space.sample(mask))[1])
    assert 0.3 < np.mean(rewards) < 0.7


def test_a_redrawn_action_says_nothing_about_its_outcome():
    def step(data, state, action, bits):
        return cr.tasks.integers(bits, 2), 0.0, False

    task = ComputedMDP(
        cr.Space([cr.Component("state", 2)]), cr.Space([cr.Component("action", 4)]),
        lambda data, bits: 0, step, available=lambda data, state, action: action % 3 == 0,
    )  # fmt: skip
    steps, _ = random_rollouts(task, episodes=20, length=1000)
    rows = steps.states.reshape(20, 1000)
    table = np.zeros((2, 2))
    np.add.at(table, (steps.actions.reshape(20, 1000)[:, :-1] // 3, rows[:, 1:]), 1)
    assert chi2_contingency(table).pvalue > 1e-3


def test_values_of_the_task_itself_are_a_potential():
    task = with_masks(random_mdp(2, n_actions=4), 2)
    q = cr.solve(task).action_values
    phi = cr.StateActionPotential(task, q)
    assert np.isfinite(phi.values).all()
    np.testing.assert_array_equal(phi.to_state().values[0], q.max(axis=1))
    with pytest.raises(cr.CurricleError, match="finite"):  # where an action is available
        cr.StateActionPotential(task, np.where(task.available, -np.inf, 0.0))
    learnt = cr.learn(task, None, 1, shaping=cr.QInitialisation(q), eval_freq=1)
    assert learnt.greedy_return[0, 0] == pytest.approx(cr.planning.Target.of(task).optimum)
    for ends in ("zero", "given"):
        assert cr.certify(task, cr.StateShaping(q), ends=ends).holds
        assert cr.certify(task, cr.QInitialisation(q), ends=ends).holds


@pytest.mark.parametrize("aggregate", [cr.mean, cr.minimum, cr.maximum])
@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("by", ["index", "name"])
def test_a_source_knows_nothing_of_actions_that_it_lacks(by, aggregate, n):
    target = random_mdp(3, n_actions=4)
    mapping = cr.transfer.identity
    if by == "name":  # which is looked up while learning, but for the mean of several
        cells = cr.Space([cr.Component("row", 2), cr.Component("column", 3)])
        target, mapping = replace(target, states=cells), cr.project
    sources = {f"source {k}": with_masks(target, k) for k in range(n)}
    edges = [cr.Transfer(name, "target", mapping(target, of)) for name, of in sources.items()]
    tasks = {**sources, "target": target}
    result = cr.Curriculum(tasks, edges, budget=400, aggregate=aggregate).train()
    potential = result.potentials["target"][0]
    looked_up = isinstance(potential, cr.learning.MappedPotential)
    assert looked_up == (by == "name" and (n == 1 or aggregate is not cr.mean))
    phi = potential.values
    read = np.stack([result.sources[name].values[0] for name in sources])
    read[np.isneginf(read)] = np.nan
    expected = np.where(target.terminal[:, None], 0.0, np.nan_to_num(aggregate(read)))
    np.testing.assert_allclose(phi, expected)


def test_a_target_reads_no_value_for_an_action_that_it_lacks():
    source = random_mdp(4, n_actions=4)
    target = with_masks(source, 4)
    mapping = cr.transfer.identity(target, source)
    live = target.available & ~target.terminal[:, None]
    assert mapping.coverage().size == live.sum()
    q = cr.solve(source).action_values
    phi = cr.StateActionPotential(target, mapping.read(q))
    best = np.where(target.available, q, -np.inf).max(axis=1)
    np.testing.assert_array_equal(
        phi.to_state().values[0, ~target.terminal], best[~target.terminal]
    )


def test_a_potential_that_is_looked_up_skips_what_the_target_lacks():
    cells = cr.Space([cr.Component("row", 2), cr.Component("column", 3)])
    source = replace(random_mdp(8, n_actions=4, time_limit=9), states=cells)
    target = with_masks(source, 8)
    edge = cr.Transfer("source", "target", cr.project(target, source))
    tasks, shaping = {"source": source, "target": target}, cr.QInitialisation()
    plan = cr.Curriculum(tasks, [edge], budget=500, shaping=shaping)
    results = [plan.replace("target", storage=cr.Storage(kind=kind)).train().nodes["target"]
               for kind in ("dense", "sparse")]  # fmt: skip
    dense, sparse = (result.values[0] for result in results)
    np.testing.assert_array_equal(sparse.values, dense[sparse.states])
    phi = plan.train().potentials["target"][0]
    best = phi.values.max(axis=1)  # a pair that is not available has the value of another
    np.testing.assert_array_equal(phi.v(np.arange(6)), best)
    at_start = cr.planning.Target.of(target, cr.GreedyEvaluation(method="exact"))
    start = potential_return(phi, at_start)
    assert start == results[0].greedy_return[0, 0]


def test_searches_map_tasks_with_available_actions():
    task = with_masks(random_mdp(5, n_states=5, n_actions=3), 5)
    best = cr.transfer.find_mappings(task, task)[0]
    assert best.scores.regained == pytest.approx(1.0)
    np.testing.assert_array_equal(best.mapping.index[~task.available] >= 0, True)


def test_comparisons_and_controls_run():
    task = with_masks(random_mdp(6, n_actions=4, time_limit=10), 6)
    edge = cr.Transfer("source", "target", cr.transfer.identity(task))
    curriculum = cr.Curriculum({"source": task, "target": task}, [edge], budget=600)
    comparison = cr.compare(
        curriculum, seeds=3, opponents=[], controls=["placebo", "random_start", "unrelated"]
    )
    assert "inf" not in str(comparison)


def test_coarser_sources_average_the_actions_that_their_states_allow():
    cells = cr.Space([cr.Component("row", 1), cr.Component("column", 8)])
    task = with_masks(random_mdp(10, n_states=8, n_actions=4, time_limit=20), 10)
    task = replace(task, states=cells, terminal=np.arange(8) >= 6, start=np.eye(8)[0])
    merged = [c.task for c in cr.candidates.source_candidates(task) if c.kind == "coarser"]
    assert merged
    allowed = task.available[:6].reshape(3, 2, 4, 1)
    goes = dense_of(task)[0][:6].reshape(3, 2, 4, 4, 2).sum(axis=-1) * allowed
    with np.errstate(invalid="ignore"):
        mean = goes.sum(axis=1) / allowed.sum(axis=1)  # nan where neither state has the action
    for source in merged:
        first = source.available[:3] if source.available is not None else np.ones((3, 4), bool)
        np.testing.assert_array_equal(first, allowed.any(axis=(1, 3)))
        np.testing.assert_allclose(dense_of(source)[0][:3][first], mean[first])


class Matches(gym.Env):
    """Eleven matches; a move takes one to three, no more than there are."""

    observation_space, action_space = gym.spaces.Discrete(12), gym.spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = 11
        return self.left, {}

    def action_masks(self):
        return np.arange(1, 4) <= self.left

    def step(self, action):
        assert action < self.left
        self.left -= action + 1
        return self.left, -1.0 - (self.left % 4 == 0), self.left == 0, False, {}


class Informed(Matches):
    """The same, with the mask in ``info``."""

    action_masks = None

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed)[0], {"action_mask": self.mask()}

    def step(self, action):
        return (*super().step(action)[:-1], {"action_mask": self.mask()})

    def mask(self):
        return (np.arange(1, 4) <= self.left).astype(np.int8)


def by_hand():
    """Return the tables of :class:`Matches`."""
    outcomes = [
        [[(1.0, n - a, -1.0 - ((n - a) % 4 == 0))] if a <= n else [] for a in (1, 2, 3)]
        for n in range(12)
    ]
    ended = np.arange(12) == 0
    return cr.FiniteMDP.from_outcomes(
        outcomes, terminal=ended, start=11, discount=0.9, time_limit=30
    )


@pytest.mark.parametrize("kind", [Matches, Informed])
def test_a_tabulated_class_equals_its_tables_by_hand(kind):
    table = tabulate(kind, discount=0.9, action_masks=True, time_limit=30)
    hand = by_hand()
    n = table.states.decode()["n" if "n" in table.states.names else table.states.names[0]]
    q = cr.solve(table).action_values
    np.testing.assert_allclose(q, cr.solve(hand).action_values[n], atol=1e-9)
    assert table.record.transitions == table.mdp.available[~table.mdp.terminal].sum()
    listed = tabulate(
        kind, discount=0.9, time_limit=30,
        outcomes=lambda n, a: [] if a >= n else [
            (1.0, n - a - 1, -1.0 - ((n - a - 1) % 4 == 0), n == a + 1)
        ],
    )  # fmt: skip
    assert listed.mdp.available.sum() == hand.available.sum()


@pytest.mark.parametrize("learner", [cr.QLearning(), cr.SARSA(), cr.DoubleQLearning()])
@pytest.mark.parametrize("kind", [Matches, Informed])
def test_a_live_task_is_learnt_as_its_tables(kind, learner):
    live = from_gymnasium(kind, discount=0.9, action_masks=True, time_limit=30)
    settings = {"budget": 800, "eval_freq": 800}
    learnt, known = cr.learn(live, learner, **settings), cr.learn(by_hand(), learner, **settings)
    np.testing.assert_array_equal(learnt.values, known.values)
    np.testing.assert_array_equal(learnt.training_return, known.training_return)
    assert learnt.watch().actions.size
    steps, _ = random_rollouts(live, episodes=50, length=20)
    assert (steps.actions < steps.states).all()


def test_a_live_task_refuses_what_needs_masks_beforehand():
    live = from_gymnasium(Matches, discount=0.9, action_masks=True, time_limit=30)
    for kind in (OptimisticQLearning, RMax):
        with pytest.raises(SettingError, match=f"got {kind.__name__} and dense"):
            cr.learn(live, kind(value_range=(-9, 0)), 100)
    with pytest.raises(SettingError, match="got QLearning and sparse"):
        cr.learn(live, None, 100, storage=cr.Storage(kind="sparse"))


class Moody(Matches):
    """The mask changes with time."""

    def action_masks(self):
        self.asked = getattr(self, "asked", 0) + 1
        return super().action_masks() & ((np.arange(3) > 0) | (self.left < 2) | (self.asked % 2))


class Stuck(Matches):
    """No action is available."""

    def action_masks(self):
        return np.zeros(3, bool)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Moody, "must depend on the state alone"),
        (Stuck, "one of them True"),
        ("FrozenLake-v1", "has neither"),
    ],
)
def test_wrong_masks_of_a_live_task_are_named(kind, message):
    live = from_gymnasium(kind, discount=0.9, action_masks=True, live=True)
    with pytest.raises(TaskError, match=message):
        cr.learn(live, None, 500)


def test_taxi_has_masks_and_is_as_before_without_them():
    plain = from_gymnasium("Taxi-v4", discount=0.9)
    masked = from_gymnasium("Taxi-v4", discount=0.9, action_masks=True)
    assert plain.available is None
    assert masked.available.sum() < masked.available.size
    np.testing.assert_allclose(cr.solve(masked).values, cr.solve(plain).values, atol=1e-9)
    with pytest.raises(TaskError, match=r"action_mask\(state\)"):
        from_gymnasium("FrozenLake-v1", discount=0.9, action_masks=True)


def test_an_environment_of_a_task_shows_its_masks():
    environment = to_gymnasium(by_hand())
    _, info = environment.reset(options={"state": 2})
    assert info["action_mask"].dtype == np.int8
    assert info["action_mask"].tolist() == environment.action_masks().tolist() == [1, 1, 0]
    with pytest.raises(SettingError, match="action=2 is not in state=2"):
        environment.step(2)
    assert "action_mask" not in to_gymnasium(random_mdp(0, time_limit=5)).reset(seed=0)[1]


def ring(**settings):
    """Return a ring of functions, where a long step may be taken from every third place alone."""

    def step(n, state, action, bits):
        right = (action == 1) != (cr.tasks.uniform(bits) < 0.1)
        place = (state + (2 if action == 2 else 1 if right else n - 1)) % n
        return place, -1.0, place == 0

    def available(n, state, action):
        return action != 2 or (state % 3 == 0 and state > 0)

    spaces = cr.Space([cr.Component("place", 20)]), cr.Space([cr.Component("move", 3)])
    return ComputedMDP(*spaces, ring_start, step, 20, available=available, **settings)


def test_a_computed_task_in_dense_and_sparse_tables():
    task, expected = ring(), np.ones((20, 3), bool)
    expected[:, 2] = (np.arange(20) % 3 == 0) & (np.arange(20) > 0)
    dense = cr.learn(task, budget=5000).values[0]
    assert (np.isneginf(dense[1:]) == ~expected[1:]).all()
    assert np.isfinite(dense[0, :2]).all()
    sparse = cr.learn(task, budget=5000, storage=cr.Storage(kind="sparse")).values[0]
    np.testing.assert_array_equal(sparse.values, dense[sparse.states])
    steps, _ = random_rollouts(task, episodes=40, length=30)
    assert expected[steps.states, steps.actions].all()
    environment = to_gymnasium(task)
    environment.reset(options={"state": 3})
    assert environment.action_masks().tolist() == [True, True, True]


def test_a_saved_result_keeps_what_is_not_available(tmp_path):
    task = with_masks(random_mdp(7, n_actions=4, time_limit=10), 7)
    result = cr.learn(task, None, 500, snapshots=3)
    again = cr.learning.LearningResult.load(result.save(tmp_path / "result"), task)
    np.testing.assert_array_equal(again.values, result.values)
    np.testing.assert_array_equal(again.snapshots.values, result.snapshots.values)
    assert (again.policy.episode(max_steps=5).actions < 4).all()


def test_differences_of_tasks_name_available_actions():
    task = with_masks(random_mdp(7, n_actions=4), 7)
    first, other = map(task_summary, (task, replace(task, available=None)))
    assert any("available actions" in line for line in summary_differences(first, other))
    assert summary_differences(first, first) == ()


@pytest.mark.parametrize("kind", ["gymnasium", "tabulated"])
def test_a_study_file_asks_for_masks(kind, read):
    table = f'[tasks.taxi]\ntype = "{kind}"\nid = "Taxi-v4"\naction_masks = true\n'
    study = read(f'name = "taxi"\nbudget = 300\n{table}')
    task = study.curriculum("transfer").tasks["taxi"]
    assert (task.mdp.random_policy == 0).any()


def test_pairs_that_are_not_available_count_in_no_mean():
    outcomes = [[[(1.0, 1, -1.0)]] + [[]] * 9, [[(1.0, 2, -1.0)]] * 10, [[]] * 10]
    ends = [False, False, True]
    task = cr.FiniteMDP.from_outcomes(outcomes, terminal=ends, start=0, discount=0.9)
    index = np.where(np.arange(3)[:, None] == 0, -1, np.arange(30).reshape(3, 10))
    mapping = cr.transfer.StateActionMapping(task, task, index)
    assert score_mapping(mapping).coverage == pytest.approx(10 / 11)
