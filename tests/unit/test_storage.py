"""Storage: dense and sparse tables say the same, memory that ends, single precision."""

import tracemalloc

import numpy as np
import pytest

import curricle as cr
from curricle import GreedyEvaluation, QLearning, Storage
from curricle.errors import SettingError
from curricle.learning import SparseValues
from curricle.transfer.potential import mapped_potential
from tests.support.refusals import check_values
from tests.support.tasks import predator_edges, random_mdp, with_masks

# By their tables, which share compiled loops with other tests.
CHASE, HUNT = cr.Pursuit(3, 1).mdp, cr.Pursuit(3, 2, time_limit=40).mdp
FAR = cr.Pursuit(4, 2, time_limit=40).mdp
ROLLED, EXACT = GreedyEvaluation("rollouts", episodes=5), GreedyEvaluation("exact")
CURVES = ("training_return", "greedy_return", "episodes", "steps", "steps_used", "episodes_used")
AGGREGATES = {"min": cr.minimum, "max": cr.maximum, "mean": cr.mean, "total": cr.total}
LEARNERS = {
    "greedy": QLearning(learning_rate=0.3, epsilon=0.2, initial_value=-1.5),
    "harmonic": QLearning(learning_rate=cr.learning.harmonic(0.9, 0.05, half=5)),
}
LEARNT = [
    *((name, "float64") for name in LEARNERS),
    pytest.param("greedy", "float32", marks=pytest.mark.slow),
]
"""Each a loop of its own to compile; a table's precision does not depend on the exploration."""


def potential(task, function=cr.minimum, seed=0, unmapped=(-7.0, -5.0)):
    """Return random values of two sources read through mappings; some pairs end or have none."""
    rng = np.random.default_rng(seed)
    read = zip(("predator_1", "predator_2"), unmapped, (2.0, -1.0), (0.5, 0.0), strict=True)
    edges = [
        cr.Transfer("chase", "hunt", cr.project(task, CHASE, predator=name, unmapped_value=u), x, y)
        for name, u, x, y in read
    ]
    return mapped_potential(task, edges, rng.normal(-8, 3, size=(2, 81, 5)), function)


def same_curves(result, other):
    for name in CURVES:
        np.testing.assert_array_equal(getattr(result, name), getattr(other, name), err_msg=name)


def both(task, learner, budget=3000, *, dtype="float64", **settings):
    """Learn with dense and with sparse tables, hold them equal and return both."""
    kinds = (Storage(kind, dtype) for kind in ("dense", "sparse"))
    dense, sparse = (cr.learn(task, learner, budget, storage=s, **settings) for s in kinds)
    same_curves(dense, sparse)
    for q, met in zip(dense.values, sparse.values, strict=True):
        assert (np.diff(met.states) > 0).all()
        assert met.values.dtype == q.dtype == dtype
        np.testing.assert_array_equal(q[met.states], met.values)
        assert not dense.task.mdp.terminal[met.states].any()
    assert not sparse.out_of_memory.any()
    return dense, sparse


@pytest.mark.parametrize(("name", "dtype"), LEARNT)
@pytest.mark.parametrize("aggregate", [None, *AGGREGATES])
def test_sparse_and_dense_tables_learn_the_same(name, aggregate, dtype):
    """From a potential or none; every other state that the first evaluation visits has no row."""
    settings = {"dtype": dtype, "evaluation": ROLLED, "seeds": 2}
    if aggregate is not None:
        phi = (potential(FAR, AGGREGATES[aggregate], seed) for seed in range(2))
        settings["shaping"] = [cr.QInitialisation(guess) for guess in phi]
    both(HUNT if aggregate is None else FAR, LEARNERS[name], **settings)


def test_a_sparse_row_starts_as_the_potential_and_the_initial_value():
    phi, asleep = potential(FAR), QLearning(learning_rate=0, initial_value=0.25)
    met = cr.learn(
        FAR, asleep, 500, shaping=cr.QInitialisation(phi), storage=Storage("sparse")
    ).values[0]
    np.testing.assert_array_equal(met.values, phi.values[met.states] + 0.25)
    assert {-7.0 + 0.25, -5.0 + 0.25} & set(met.values.ravel().tolist())  # some are unmapped


@pytest.mark.parametrize(
    ("dtype", "most"),
    [
        ("float64", 10**7),
        ("float64", 0),
        pytest.param("float32", 10**7, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_a_portfolio_learns_the_same_in_sparse_tables(aggregate, dtype, most, monkeypatch):
    """Also of pairs that no source knows, and of more pairs than have bounds from rewards."""
    for module in ("run", "potential"):
        monkeypatch.setattr(f"curricle.learning.{module}.MOST_SHARED", most)
    phi = [potential(FAR, AGGREGATES[aggregate], seed, (None, None)) for seed in range(2)]
    phi[1] = phi[1].rescaled(-1.0)
    assert np.isnan(phi[0].known[~FAR.terminal]).any()
    shaping = [cr.QInitialisation(guess, portfolio=cr.Portfolio()) for guess in phi]
    both(FAR, QLearning(), dtype=dtype, evaluation=ROLLED, seeds=2, shaping=shaping)


def test_a_portfolio_of_sparse_tables_takes_phi_as_an_array_and_masks():
    task = with_masks(random_mdp(3, n_states=40, n_actions=4, time_limit=12), 3)
    rng, shape = np.random.default_rng(3), task.available.shape
    unknown = (rng.random(shape) < 0.3) & ~task.terminal[:, None]
    phi = cr.StateActionPotential(task, rng.normal(size=shape), unknown)
    for portfolio in (cr.Portfolio(), None):
        shaping = cr.QInitialisation(phi, portfolio)
        both(task, QLearning(), evaluation=EXACT, eval_freq=50, shaping=shaping)


def test_sparse_tables_hand_on_phi_while_it_is_ahead():
    maze = cr.GridWorld(["....T", ".PPP.", "S...."])
    shaping = cr.QInitialisation(cr.solve(maze).action_values, portfolio=cr.Portfolio())
    dense, _ = both(maze, QLearning(), shaping=shaping)
    assert dense.source_share[0, -1] == 1


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_the_values_of_the_sources_bound_phi_where_it_is_not_read(aggregate, monkeypatch):
    for seed, unmapped in enumerate([(None, None), (-7.0, -5.0)]):
        phi = potential(FAR, AGGREGATES[aggregate], seed, unmapped).rescaled(-2.0, 1.0)
        low, high = phi.extremes
        assert (low, high) == (np.nanmin(phi.known), np.nanmax(phi.known))
        with monkeypatch.context() as patch:
            patch.setattr("curricle.learning.potential.MOST_SHARED", 0)
            bounds = potential(FAR, AGGREGATES[aggregate], seed, unmapped).rescaled(-2.0, 1.0)
            assert bounds.extremes[0] <= low < high <= bounds.extremes[1]


@pytest.mark.parametrize("limit", [None, 30])
def test_exact_evaluation_reads_sparse_tables(limit):
    small = cr.Pursuit(2, 2, time_limit=limit).mdp
    both(small, QLearning(epsilon=0.3), 800, evaluation=EXACT, eval_freq=50)


def test_automatic_storage_is_sparse_where_dense_does_not_fit():
    values = HUNT.states.size * HUNT.actions.size * 8
    kind = {
        m: cr.learn(HUNT, budget=100, storage=Storage(memory_limit=m)) for m in (values, 2 * values)
    }
    assert isinstance(kind[values].values[0], SparseValues)
    assert isinstance(kind[2 * values].values, np.ndarray)


def test_ten_thousand_million_states_are_learnt():
    huge, chase = cr.Pursuit(50, 2), cr.Pursuit(3, 1)
    result = cr.Curriculum(
        {"chase": chase, "hunt": huge},
        predator_edges(huge, chase),
        budget={"chase": 1000, "hunt": 2000},
        evaluation=GreedyEvaluation(episodes=2),
    ).train(2)["hunt"]
    assert np.isfinite(result.source_share[:, -1]).all()  # it was a portfolio
    assert result.steps_used.tolist() == [2000, 2000]
    for met in result.values:
        assert 1000 < len(met.states) <= 2011
        assert 10**10 < met.states.max() < 2500**3


def limited(rows, tables=1, **settings):
    sparse = Storage("sparse")
    bytes_a_row = 10_000 / sparse.rows_within(10_000_000, HUNT.actions.size) * 1000
    storage = Storage("sparse", memory_limit=int((rows + 0.5) * bytes_a_row) * tables)
    assert storage.rows_within(storage.limit // tables, HUNT.actions.size) == rows
    learner = QLearning(epsilon=0.5)
    return cr.learn(HUNT, learner, 20_000, eval_freq=20, storage=storage, **settings)


@pytest.mark.parametrize("rows", [1, 17, 100])
@pytest.mark.parametrize(("portfolio", "tables"), [(None, 1), (cr.Portfolio(), 5)])
def test_a_run_that_is_out_of_memory_ends_as_a_prefix(rows, portfolio, tables):
    settings = {"shaping": cr.QInitialisation(potential(HUNT), portfolio), "evaluation": ROLLED}
    short = limited(rows, tables, **settings)
    whole = cr.learn(HUNT, QLearning(epsilon=0.5), 20_000, eval_freq=20, **settings)
    assert short.out_of_memory.all()
    assert not whole.out_of_memory.any()
    used, n = int(short.steps_used[0]), len(short.steps)
    assert used < 20_000
    assert n == used // 20 + 1
    for name in ("training_return", "greedy_return", "episodes", "steps"):
        first, other = getattr(short, name), getattr(whole, name)[..., :n]
        np.testing.assert_array_equal(first, other, err_msg=name)
    # The values, too, are those of a run of just as many steps.
    (met,) = short.values
    assert len(met.states) == rows
    if used:
        again = cr.learn(HUNT, QLearning(epsilon=0.5), used, eval_freq=min(20, used), **settings)
        np.testing.assert_array_equal(again.values[0][met.states], met.values)
        assert again.episodes_used[0] == short.episodes_used[0]


@pytest.mark.parametrize("kind", [QLearning, cr.DoubleQLearning])
def test_counted_updates_take_as_much_memory_as_values(kind):
    learner = kind(learning_rate=cr.learning.harmonic())
    enough = HUNT.states.size * (2 * kind.tables * HUNT.actions.size * 8 + 12)
    cr.learn(HUNT, learner, 10, storage=Storage("dense", memory_limit=enough), evaluation=EXACT)
    with pytest.raises(SettingError, match="must fit the memory_limit"):
        cr.learn(HUNT, learner, 10, storage=Storage("dense", memory_limit=enough - 1))


def test_memory_is_shared_by_the_seeds_that_hold_values():
    kept = limited(100, seeds=4, evaluation=ROLLED)
    assert [len(met.states) for met in kept.values] == [25] * 4


def test_a_run_that_just_fits_is_not_out_of_memory():
    line = cr.GridWorld("S..T").mdp  # three states are met
    rows = Storage("sparse").rows_within
    enough = next(m for m in range(1, 10_000) if rows(m, 4) == 3)
    fits = cr.learn(line, budget=500, storage=Storage("sparse", memory_limit=enough))
    assert not fits.out_of_memory[0]
    assert fits.steps_used[0] == 500
    less = Storage("sparse", memory_limit=enough - 1)
    assert cr.learn(line, budget=500, storage=less).out_of_memory[0]
    short = cr.learn(HUNT, budget=cr.Episodes(500), storage=Storage("sparse", memory_limit=5000))
    assert short.out_of_memory[0]
    assert short.episodes_used[0] < 500


@pytest.mark.parametrize(
    ("kind", "learner"), [("dense", QLearning()), ("dense", cr.SARSA()), ("sparse", QLearning())]
)
def test_values_need_not_be_kept(kind, learner):
    settings = {"budget": 1000, "seeds": 3, "evaluation": ROLLED}
    kept = cr.learn(HUNT, learner, storage=Storage(kind), **settings)
    dropped = cr.learn(HUNT, learner, storage=Storage(kind, save_values=False), **settings)
    assert dropped.values is None
    same_curves(kept, dropped)


def test_seeds_that_keep_nothing_need_memory_only_one_at_a_time():
    values = 2 * HUNT.states.size * HUNT.actions.size * 8
    unsaved = Storage("dense", memory_limit=values, save_values=False)
    cr.learn(HUNT, budget=50, seeds=5, workers=1, storage=unsaved, evaluation=ROLLED)
    with pytest.raises(SettingError, match="values of 5 seeds must fit"):
        cr.learn(HUNT, budget=50, seeds=5, workers=1, storage=Storage("dense", memory_limit=values))


def test_dense_tables_that_do_not_fit_are_refused_before_they_are_made():
    tracemalloc.start()
    wanted = r"25,000,000 states|100,000,000 states x 125 actions in float64 take 101 GB"
    with pytest.raises(SettingError, match=wanted):
        cr.learn(cr.Pursuit(10, 3), budget=10, storage=Storage("dense", memory_limit="8 GB"))
    assert tracemalloc.get_traced_memory()[1] < 10**7
    tracemalloc.stop()


def test_a_curriculum_asks_for_sources_whose_values_are_kept():
    edge = cr.Transfer("hunt", "far", cr.project(FAR, HUNT))
    for storage in (Storage("sparse"), Storage(save_values=False)):
        settings = {"budget": 50, "storage": {"hunt": storage}, "evaluation": ROLLED}
        curriculum = cr.Curriculum({"hunt": HUNT, "far": FAR}, [edge], **settings)
        with pytest.raises(cr.errors.CurriculumError, match="those of 'hunt', which 'far' reads"):
            curriculum.train()


ARRAY = cr.StateActionPotential(CHASE, np.zeros((81, 5)))


def test_what_sparse_tables_cannot_do_is_refused():
    for settings, message in (
        ({"learner": cr.SARSA()}, "are for QLearning .* got SARSA"),
        ({"shaping": cr.StateShaping(ARRAY)}, "got QLearning with StateShaping"),
    ):
        with pytest.raises(SettingError, match=message):
            cr.learn(CHASE, budget=10, storage=Storage("sparse"), **settings)


SIZES = {"1.5 GiB": 3 * 2**29, "2 GB": 2 * 10**9, " 2GB ": 2 * 10**9, "7 B": 7, "1. KiB": 1024}


def test_memory_is_read_with_its_unit():
    for text, limit in SIZES.items():
        assert Storage(memory_limit=text).limit == Storage(memory_limit=limit).limit == limit


BAD = ["", "GB", ". GB", "1.2.3 GB", "2 gb", "2 TB", "-2 GB", "2", "1e3 MB", "0 GB", "0.1 B"]
BAD += ["9" * 400 + " GB", "nan GB", 0, -1, 1.5, True, type(None)]


def test_wrong_values_are_named():
    wrong = {"kind": ["hash"], "dtype": ["float16"], "save_values": [1], "memory_limit": BAD}
    check_values(SettingError, Storage, wrong)


def test_sparse_values_are_found_by_state():
    met = SparseValues(np.array([2, 5, 9]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    assert met.at(5).tolist() == [3, 4]
    assert met.at([9, 2, 9])[:, 0].tolist() == [5, 1, 5]
    assert met.at([[2], [5]]).shape == (2, 1, 2)
    for state in (0, 3, 10):
        with pytest.raises(SettingError, match=f"visited states only: {state} was not visited"):
            met.at([2, state])


def test_as_many_actions_as_can_be_numbered():
    def bandit(n):
        last = [[(1.0, 1, float(a == n - 1), True)] for a in range(n)]
        return cr.FiniteMDP.from_outcomes([last, [[]] * n], start=0, discount=0.9)

    optimistic = QLearning(learning_rate=1, epsilon=0, initial_value=1.0)
    most = cr.learn(bandit(32_768), optimistic, 100_000, eval_freq=100_000)
    assert most.greedy_return[0, -1] == 1
    with pytest.raises(SettingError, match="at most 32,768 actions: got 32,769"):
        cr.learn(bandit(32_769), budget=10)


@pytest.mark.parametrize(
    "kind",
    [
        *(QLearning, cr.DoubleQLearning),
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in (cr.SARSA, cr.ExpectedSARSA)),
    ],
)
def test_single_precision_is_close_to_double(kind):
    # All explore at random, so that rounding changes no path.
    learner = kind(learning_rate=0.1, epsilon=1.0)
    settings = {"budget": 20_000, "evaluation": ROLLED, "eval_freq": 20_000}
    double = cr.learn(HUNT, learner, **settings).values
    single = cr.learn(HUNT, learner, storage=Storage(dtype="float32"), **settings).values
    assert single.dtype == np.float32
    assert 0 < abs(double - single).max() < 1e-4


@pytest.mark.parametrize(
    ("kind", "exploration"),
    [
        ("dense", {"epsilon": 0.3}),
        ("dense", {"inverse_temperature": 1.0}),
        pytest.param("sparse", {"epsilon": 0.3}, marks=pytest.mark.slow),
    ],
)
def test_learning_that_diverges_ends_all_the_same(kind, exploration, monkeypatch):
    # Such rewards are infinite in single precision, and two of them add up to no number.
    monkeypatch.setattr("curricle.tasks.mdp.LARGEST_REWARD", 1e100)
    pay = [[(0.5, 0, 1e100, False), (0.5, 1, -1e100, False)] for _ in range(70)]
    wild = cr.FiniteMDP.from_outcomes([pay, pay], start=0, discount=0.9, time_limit=10)
    learner = QLearning(learning_rate=0.5, **exploration)
    storage = Storage(kind, dtype="float32")
    learnt = cr.learn(wild, learner, 5000, storage=storage, evaluation=ROLLED)
    values = learnt.values[0].values if kind == "sparse" else learnt.values
    assert learnt.steps_used[0] == 5000
    assert np.isnan(values).any()
