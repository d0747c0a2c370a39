"""Numbers of points, bins, and ends set apart: what holds for any space, edges and table."""

import pickle

import numpy as np
from gymnasium import spaces
from hypothesis import given, strategies as st

import curricle as cr
from curricle.interop.discrete import Number, Point, is_discrete, space_of
from tests.support.worlds_to_tabulate import Listed

SIZES = st.integers(1, 4)
LOWS = st.integers(-3, 3)
DISCRETE = st.builds(lambda n, low: spaces.Discrete(n, start=low), SIZES, LOWS)
MULTI = st.lists(st.tuples(SIZES, LOWS), min_size=1, max_size=3).map(
    lambda pairs: spaces.MultiDiscrete([n for n, _ in pairs], start=[low for _, low in pairs])
)
BINARY = st.lists(st.integers(1, 2), min_size=1, max_size=2).map(spaces.MultiBinary)
SPACES = st.recursive(
    DISCRETE | MULTI | BINARY,
    lambda parts: (
        st.lists(parts, min_size=1, max_size=2).map(spaces.Tuple)
        | st.dictionaries(st.sampled_from("abc"), parts, min_size=1, max_size=2).map(spaces.Dict)
    ),
    max_leaves=3,
)


@given(SPACES)
def test_points_have_numbers_and_numbers_points(space):
    assert is_discrete(space)
    number, point = Number(space), Point(space)
    size = space_of(space, "x").size
    some = np.unique(np.linspace(0, size - 1, 7).astype(int)).tolist()
    assert all(space.contains(point(n)) for n in some)
    assert [number(point(n)) for n in some] == some
    assert pickle.loads(pickle.dumps(number))(point(size - 1)) == size - 1
    space.seed(0)
    drawn = [number(space.sample()) for _ in range(5)]
    assert all(0 <= n < size for n in drawn)


NUMBERS = st.floats(-10, 10)


@given(
    st.lists(st.lists(NUMBERS, min_size=2, max_size=6, unique=True), min_size=1, max_size=3),
    st.data(),
)
def test_bins_are_numpys(edges, data):
    edges = [sorted(bounds) for bounds in edges]
    bins = cr.interop.Bins({f"x{i}": bounds for i, bounds in enumerate(edges)})
    on_edges = NUMBERS | st.sampled_from([edge for bounds in edges for edge in bounds])
    observation = data.draw(st.tuples(*[on_edges | st.just(np.inf) for _ in edges]))
    values = bins.states.decode(bins(np.array(observation)))
    expected = [np.digitize(x, bounds[1:-1]) for x, bounds in zip(observation, edges, strict=True)]
    assert [int(value) for value in values.values()] == expected


@st.composite
def tables(draw):
    """Return a table in which any outcome may end the episode, whatever it leads to."""
    n_states, n_actions = draw(st.integers(1, 4)), draw(st.integers(1, 2))
    outcome = st.tuples(st.integers(0, n_states - 1), st.integers(-3, 3), st.booleans())
    pair = st.lists(outcome, min_size=1, max_size=2).map(
        lambda outcomes: [(1 / len(outcomes), after, float(r), over) for after, r, over in outcomes]
    )
    return [[draw(pair) for _ in range(n_actions)] for _ in range(n_states)]


@given(tables(), st.randoms(use_true_random=False))
def test_ends_of_a_table_are_kept(table, random):
    """The value of acting at random from the start, by the table's own flags and by the task."""
    start = np.zeros(len(table))
    start[random.randrange(len(table))] = 1.0
    task = cr.from_gymnasium(Listed, discount=0.5, table=table, start=start)
    values = np.zeros(len(table))

    def worth(pair):
        return sum(p * (r + 0.5 * values[after] * (not over)) for p, after, r, over in pair)

    for _ in range(60):
        values = np.array([np.mean([worth(pair) for pair in pairs]) for pairs in table])
    n_states, n_actions = task.states.size, task.actions.size
    evaluated = cr.evaluate(task, np.full((n_states, n_actions), 1 / n_actions), tolerance=1e-9)
    assert abs(evaluated.values @ task.start - values @ start) < 1e-6
