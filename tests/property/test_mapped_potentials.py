"""Mapped potentials against the same as arrays, on random mappings by name."""

import itertools
import tracemalloc

import numpy as np
from hypothesis import given, settings, strategies as st

import curricle as cr
from curricle.transfer.aggregate import aggregate
from curricle.transfer.by_components import ComponentMapping
from curricle.transfer.potential import mapped_potential
from tests.support.tasks import predator_edges

AGGREGATES = [cr.minimum, cr.maximum, cr.mean, cr.total]
NUMBERS = st.sampled_from([0.0, -1.0, 0.1, 3.7, -12.3])
UNMAPPED_VALUES = st.sampled_from([None, None, -12.3])


def values_of(task, rng):
    return rng.normal(size=(task.states.size, task.actions.size))


def random_task(states, actions, rng):
    """Return an MDP on these spaces, a third of it terminal, each action leading anywhere."""
    n_states, n_actions = states.size, actions.size
    terminal = rng.random(n_states) < 0.3
    terminal[rng.integers(n_states)] = False
    alive = np.flatnonzero(~terminal)
    rows = np.arange(n_states * n_actions).reshape(n_states, n_actions)
    return cr.FiniteMDP(
        states=states,
        actions=actions,
        outcome_row=rows,
        probability=np.ones((rows.size, 1)),
        next_state=rng.integers(n_states, size=(rows.size, 1)),
        reward=rng.normal(size=(rows.size, 1)),
        terminal=terminal,
        start=np.bincount(alive, minlength=n_states) / len(alive),
        discount=0.9,
        time_limit=20,
    )


@st.composite
def spaces(draw, prefix):
    """Spaces whose components overlap in part: by number from different lows, or by labels."""
    parts = []
    for i in range(draw(st.integers(1, 3))):
        size, low = draw(st.integers(1, 4)), draw(st.integers(-2, 2))
        labels = None
        if draw(st.booleans()):
            chosen = draw(st.permutations(["n", "e", "s", "w", "x"]))
            labels = tuple(chosen[:size])
        parts.append(cr.Component(f"{prefix}{i}", size, low, labels))
    return cr.Space(parts)


@st.composite
def pursuit_transfers(draw):
    """A pursuit and transfers into it from smaller, larger and equal ones."""
    game = cr.Pursuit(draw(st.integers(2, 3)), 2, capture=draw(st.sampled_from(["all", "any"])))
    edges = []
    for _ in range(draw(st.integers(1, 3))):
        source = cr.Pursuit(draw(st.integers(2, 4)), draw(st.integers(1, 2)))
        offered = ("prey", *game.predator_names)
        renaming = {"prey": draw(st.sampled_from(offered))}
        renaming |= {n: draw(st.sampled_from(game.predator_names)) for n in source.predator_names}
        mapping = cr.project(game, source, unmapped_value=draw(UNMAPPED_VALUES), **renaming)
        edges.append(cr.Transfer("source", "game", mapping, draw(NUMBERS), draw(NUMBERS)))
    return game, edges


@st.composite
def space_transfers(draw):
    """Random MDPs whose spaces have several components, read by any component of the target."""
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    task = random_task(draw(spaces("s")), draw(spaces("a")), rng)
    edges = []
    for _ in range(draw(st.integers(1, 3))):
        source = random_task(draw(spaces("x")), draw(spaces("y")), rng)
        renaming = {n: draw(st.sampled_from(task.states.names)) for n in source.states.names}
        renaming |= {n: draw(st.sampled_from(task.actions.names)) for n in source.actions.names}
        mapping = ComponentMapping(task, source, renaming, draw(UNMAPPED_VALUES))
        edges.append(cr.Transfer("source", "task", mapping, draw(NUMBERS), draw(NUMBERS)))
    return task, edges


def array_potential(task, edges, values, function, unknown_value=0.0):
    phis = [edge.potential(q) for edge, q in zip(edges, values, strict=True)]
    return cr.StateActionPotential(task, aggregate(function, np.stack(phis), unknown_value))


def pair_by_pair(task, edges, values, function, unknown_value):
    """Return phi as an array, each pair's sources asked for what they know, one after the other."""
    join = {cr.minimum: min, cr.maximum: max, cr.total: sum}
    join[cr.mean] = lambda numbers: sum(numbers) / len(numbers)
    index = [index_point_by_point(edge.mapping) for edge in edges]
    phi = np.full(index[0].shape, unknown_value)
    for s, a in np.ndindex(*phi.shape):
        known = []
        for edge, q, where in zip(edges, values, index, strict=True):
            if where[s, a] >= 0:
                known.append(edge.scale * q.ravel()[where[s, a]] + edge.shift)
            elif where[s, a] == cr.transfer.ENDED:
                known.append(edge.shift)
            elif edge.mapping.unmapped_value is not None:
                known.append(edge.mapping.unmapped_value)
        if known:
            phi[s, a] = join[function](known)
    phi[task.mdp.terminal] = 0.0
    return phi


def drawn(transfers, function, seed):
    """Return what a mapped potential is made of, its sources' values drawn."""
    task, edges = transfers
    rng = np.random.default_rng(seed)
    return task, edges, [values_of(edge.mapping.source, rng) for edge in edges], function, -3.25


@given(pursuit_transfers() | space_transfers(), st.sampled_from(AGGREGATES), st.integers(0, 99))
def test_a_mapped_potential_is_the_array_bit_for_bit(transfers, function, seed):
    made_of = drawn(transfers, function, seed)
    mapped, expected = mapped_potential(*made_of), array_potential(*made_of)
    np.testing.assert_array_equal(mapped.values, expected.values)
    np.testing.assert_array_equal(mapped.to_state().values, expected.to_state().values)


@settings(max_examples=25)
@given(space_transfers(), st.sampled_from(AGGREGATES), st.integers(0, 99))
def test_both_are_what_the_sources_know_of_each_pair(transfers, function, seed):
    task, *made_of = drawn(transfers, function, seed)
    expected, mapped = pair_by_pair(task, *made_of), mapped_potential(task, *made_of)
    np.testing.assert_allclose(mapped.values, expected, rtol=1e-14, atol=1e-14)
    rescaled = mapped.rescaled(2.0, 0.5)
    expected = np.where(task.mdp.terminal[:, None], 0.0, 2.0 * mapped.values + 0.5)
    np.testing.assert_array_equal(rescaled.values, expected)


def index_point_by_point(mapping):
    """Return the index array of a mapping by name, component by component of each pair."""
    target, source, renaming = mapping.target, mapping.source, mapping.renaming

    def counterpart(here, there, number):
        place = {}
        for component in there.components:
            origin = here.component(renaming.get(component.name, component.name))
            value = int(here.decode(number)[origin.name])
            if component.labels is not None and origin.labels is not None:
                label = origin.labels[value - origin.low]
                if label not in component.labels:
                    return None
                value = component.low + component.labels.index(label)
            place[component.name] = value
        point = int(there.encode(**place))
        return None if point < 0 else point

    index = np.full((target.states.size, target.actions.size), cr.transfer.UNMAPPED)
    for s, a in itertools.product(range(target.states.size), range(target.actions.size)):
        state = counterpart(target.states, source.states, s)
        action = counterpart(target.actions, source.actions, a)
        if state is not None and action is not None:
            index[s, a] = state * source.actions.size + action
            if source.mdp.terminal[state]:
                index[s, a] = cr.transfer.ENDED
        if target.mdp.terminal[s]:
            index[s, a] = cr.transfer.ENDED
    return index


@settings(max_examples=25)
@given(space_transfers())
def test_the_index_is_that_of_reading_each_point(transfers):
    _, edges = transfers
    for edge in edges:
        index = edge.mapping.index
        assert index.tolist() == index_point_by_point(edge.mapping).tolist()
        kept = cr.transfer.StateActionMapping(edge.mapping.target, edge.mapping.source, index)
        assert edge.mapping.coverage() == kept.coverage()
        assert not edge.mapping.why_empty or kept.why_empty


def line_by_points(points, n_actions=2, seed=0):
    rng = np.random.default_rng(seed)
    box = [cr.Component("row", 3), cr.Component("column", 3)]
    return random_task(cr.Space(box, points), cr.Space([cr.Component("move", n_actions)]), rng)


def test_listed_spaces_need_arrays():
    everywhere = list(itertools.product(range(3), repeat=2))
    listed, box = line_by_points(everywhere[::2]), line_by_points(None, seed=1)
    for target, source in ((listed, box), (box, listed), (listed, listed)):
        edge = cr.Transfer("source", "target", cr.project(target, source, unmapped_value=-3), 2, 1)
        values = values_of(source, np.random.default_rng(0))
        assert edge.mapping.lookups() is None
        assert mapped_potential(target, [edge], [values], cr.mean) is None
        assert edge.mapping.index.tolist() == index_point_by_point(edge.mapping).tolist()
        curriculum = cr.Curriculum({"source": source, "target": target}, [edge], budget=500)
        result = curriculum.train(2)
        for phi, q in zip(result.potentials["target"], result["source"].values, strict=True):
            assert isinstance(phi, cr.StateActionPotential)
            expected = array_potential(target, [edge], [q], cr.mean)
            np.testing.assert_array_equal(phi.values, expected.values)


def test_mappings_and_potentials_of_huge_targets_need_little_memory():
    near = cr.Pursuit(10, 1)
    q = np.zeros((near.states.size, near.actions.size))
    tracemalloc.start()
    huge = cr.Pursuit(10, 4)
    edges = predator_edges(huge, near)
    phi = mapped_potential(huge, edges, [q] * 4, cr.minimum)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert phi is not None
    assert peak < 20 * q.nbytes
    for function in (lambda phi: phi[0], np.median):  # of a user: it needs arrays
        assert mapped_potential(huge, edges, [q] * 4, function) is None
