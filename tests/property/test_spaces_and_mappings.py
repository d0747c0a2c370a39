"""Round trips of spaces and the algebra of mappings, on random examples."""

import itertools

import numpy as np
from hypothesis import given, strategies as st

from curricle import Component, FiniteMDP, Space
from curricle.transfer import ENDED, UNMAPPED, StateActionMapping, TableValues

VALUES = st.floats(-100, 100)


@st.composite
def components(draw):
    sizes = draw(st.lists(st.integers(1, 4), min_size=1, max_size=4))
    return [Component(f"c{i}", n, low=draw(st.integers(-3, 3))) for i, n in enumerate(sizes)]


def every_point(parts):
    return list(itertools.product(*(range(c.low, c.low + c.size) for c in parts)))


@given(components())
def test_a_box_decodes_to_all_combinations_and_encodes_back(parts):
    space = Space(parts)
    decoded = space.decode()
    assert list(zip(*(decoded[n].tolist() for n in space.names), strict=True)) == every_point(parts)
    assert space.encode(**decoded).tolist() == list(range(space.size))


@given(components(), st.data())
def test_a_listed_space_finds_its_points_and_no_others(parts, data):
    everything = every_point(parts)
    points = data.draw(st.lists(st.sampled_from(everything), min_size=1, unique=True))
    space = Space(parts, points)
    asked = np.array(everything)
    numbers = space.encode(**{n: asked[:, i] for i, n in enumerate(space.names)})
    expected = [points.index(p) if p in points else -1 for p in everything]
    assert numbers.tolist() == expected
    assert space.encode(**space.decode()).tolist() == list(range(len(points)))


def ring(n_states, n_actions):
    """A small task: every action moves on by one; the last state ends."""
    step = [[[(1.0, s + 1, 0.0)]] * n_actions for s in range(n_states - 1)]
    end = [False] * (n_states - 1) + [True]
    return FiniteMDP.from_outcomes([*step, [[]] * n_actions], terminal=end, start=0, discount=0.9)


@st.composite
def mappings(draw):
    """Random mappings between two small tasks."""
    target, source = (ring(draw(st.integers(2, 4)), draw(st.integers(1, 3))) for _ in range(2))
    alive = (source.states.size - 1) * source.actions.size
    shape = (target.states.size, target.actions.size)
    entries = st.integers(ENDED, alive - 1)
    flat = draw(st.lists(entries, min_size=shape[0] * shape[1], max_size=shape[0] * shape[1]))
    return StateActionMapping(target, source, np.array(flat).reshape(shape), draw(VALUES))


@given(mappings(), st.integers(0, 1000), VALUES, VALUES)
def test_a_batch_of_states_reads_what_the_whole_table_reads(f, seed, scale, shift):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(f.source.states.size, f.source.actions.size))
    batch = rng.integers(f.target.states.size, size=7)
    by_batch = f.pairs(TableValues(q), batch, scale, shift)
    np.testing.assert_array_equal(by_batch, f.read(q, scale, shift)[batch])


@given(mappings())
def test_coverage_agrees_with_counting_pair_by_pair(f):
    pairs = f.index[:-1].ravel().tolist()
    read = [p for p in pairs if p >= 0]
    available = (f.source.states.size - 1) * f.source.actions.size
    c = f.coverage()
    assert c.size == len(pairs)
    assert c.mapped == len(read) / len(pairs)
    assert c.ended == pairs.count(ENDED) / len(pairs)
    assert c.unmapped == pairs.count(UNMAPPED) / len(pairs)
    assert (c.source_pairs, c.never_used) == (available, available - len(set(read)))
    assert c.most_readers == max((read.count(p) for p in read), default=0)
    assert np.isclose(c.mean_readers, len(read) / len(set(read)) if read else 0)
