"""Pursuit as vectors: the encoding, the environment and the task."""

import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, strategies as st

from curricle import Pursuit
from curricle.errors import SettingError, TaskError
from curricle.interop.environment import TaskEnvironment
from curricle.interop.vector_pursuit import (
    PursuitVectors,
    VectorPursuit,
    observed_pursuit,
)

NAME = "Curricle/VectorPursuit-v0"
RULES = {
    "one": Pursuit(3, 1),
    "joint": Pursuit(3, 2, moves=4, time_limit=15),
    "torus": Pursuit(4, 3, torus=True, capture="any"),
    "largest": Pursuit(10, 4),
}


def naive_vector(pursuit, cells):
    """A state's vector, number by number."""
    size = pursuit.size

    def place(cell):
        return [2 * axis / (size - 1) - 1 for axis in divmod(cell, size)]

    def shortest(away):
        ways = [away] if not pursuit.torus else [away - size, away, away + size]
        return min(ways, key=lambda way: (abs(way), way)) / (size - 1)

    prey, *predators = cells
    vector = place(prey)
    for predator in predators:
        ways = zip(divmod(prey, size), divmod(predator, size), strict=True)
        vector += place(predator) + [shortest(there - here) for there, here in ways]
    return np.array(vector, np.float32)


# -- vectors -----------------------------------------------------------------------------------


@st.composite
def some_states(draw):
    pursuit = Pursuit(draw(st.integers(2, 40)), draw(st.integers(1, 4)), torus=draw(st.booleans()))
    cell = st.integers(0, pursuit.cells - 1)
    row = st.tuples(*[cell] * (1 + pursuit.predators))
    return pursuit, np.array(draw(st.lists(row, min_size=1, max_size=5)))


@given(some_states())
def test_vectors_follow_their_definition_and_give_back_their_cells(drawn):
    pursuit, cells = drawn
    seen = PursuitVectors(pursuit)
    vectors = seen.of(cells)
    assert vectors.dtype == np.float32
    assert np.array_equal(vectors, [naive_vector(pursuit, row) for row in cells.tolist()])
    assert all(seen.space.contains(vector) for vector in vectors)
    read = seen.cells(vectors)
    assert read.dtype == np.int64
    assert np.array_equal(read, cells)


@pytest.mark.parametrize("size", [2, 3, 10, 101, 1000])
def test_each_cell_is_read_exactly(size):
    pursuit = Pursuit(size, 1)
    prey = np.arange(pursuit.cells)
    cells = np.stack([prey, prey[::-1]], axis=1)
    seen = PursuitVectors(pursuit)
    assert np.array_equal(seen.cells(seen.of(cells)), cells)


def test_a_vector_begins_with_that_of_fewer_predators():
    cells = np.random.default_rng(0).integers(25, size=(50, 4))
    three, two = PursuitVectors(Pursuit(5, 3)), PursuitVectors(Pursuit(5, 2))
    assert np.array_equal(three.of(cells)[:, :10], two.of(cells[:, :3]))


# -- the environment ---------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*not.*rendering")
@pytest.mark.parametrize("acting", ["all", "first"])
@pytest.mark.parametrize("rules", RULES)
def test_environments_pass_gymnasiums_checks(rules, acting):
    environment = VectorPursuit(RULES[rules], acting=acting, render_mode="rgb_array")
    check_env(environment, skip_render_check=True)


def test_the_registered_id_passes_gymnasiums_checks():
    made = gymnasium.make(NAME, size=5, predators=3, acting="first")
    assert made.unwrapped.task == Pursuit(5, 3)
    check_env(made.unwrapped)


@pytest.mark.parametrize("rules", RULES)
def test_episodes_are_those_of_the_joint_environment(rules):
    pursuit = RULES[rules]
    vectors, states = VectorPursuit(pursuit), TaskEnvironment(pursuit)
    rng = np.random.default_rng(1)
    for seed in range(5):
        seen, told = vectors.reset(seed=seed)
        state, info = states.reset(seed=seed)
        over = False
        while not over:
            cells = [pursuit.states.decode(state)[name] for name in pursuit.states.names]
            assert np.array_equal(vectors.cells(seen[None])[0], cells)
            assert (told, vectors.state) == (info, state)
            action = rng.integers(pursuit.actions.size)
            seen, *outcome, told = vectors.step(action)
            state, *expected, info = states.step(action)
            assert outcome == expected
            over = expected[1] or expected[2]


def test_the_first_predator_takes_the_action_and_the_others_move_at_random():
    pursuit = Pursuit(5, 3, torus=True)
    hunt = VectorPursuit(pursuit, acting="first")
    assert hunt.action_space == gymnasium.spaces.Discrete(5)
    start = {"prey": 24, "predator_1": 0, "predator_2": 12, "predator_3": 12}
    reached, others = set(), []
    for seed in range(300):
        hunt.reset(seed=seed, options={"state": start})
        seen, *_ = hunt.step(2)
        _, first, *rest = hunt.cells(seen[None])[0].tolist()
        reached.add(first)
        others += rest
    assert reached == {1}  # east of cell 0
    counts = [others.count(cell) for cell in pursuit.landing[12]]
    assert sum(counts) == 600
    assert min(counts) > 80  # of 120 expected, 4 standard deviations


@pytest.mark.parametrize("acting", ["all", "first"])
def test_invalid_actions_and_settings_are_refused(acting):
    hunt = VectorPursuit(Pursuit(3, 2), acting=acting)
    with pytest.raises(SettingError, match="reset"):
        hunt.step(0)
    hunt.reset(seed=0)
    for action in (-1, 25, "north"):
        with pytest.raises(SettingError, match="must lie in Discrete"):
            hunt.step(action)


def test_other_tasks_are_refused():
    with pytest.raises(SettingError, match="must be a Pursuit"):
        VectorPursuit("hunt")
    with pytest.raises(SettingError, match="acting must be one of all, first"):
        VectorPursuit(Pursuit(), acting="last")
    with pytest.raises(TaskError, match="must be a Pursuit"):
        observed_pursuit("hunt")
    with pytest.raises(TaskError, match="acting must be one of all, first"):
        observed_pursuit(Pursuit(), acting="last")


# -- the task ----------------------------------------------------------------------------------


def test_equal_pursuits_are_equal_tasks():
    known = Pursuit(5, 3, prey=np.full((25, 5), 0.2), discount=0.9)
    task, again = observed_pursuit(known), pickle.loads(pickle.dumps(observed_pursuit(known)))
    assert (
        task == again == observed_pursuit(Pursuit(5, 3, prey=np.full((25, 5), 0.2), discount=0.9))
    )
    assert hash(task) == hash(again)
    assert task.discount == 0.9
    assert task.environment().unwrapped.task == known
    for other in (Pursuit(5, 3), Pursuit(5, 2), Pursuit(4, 3)):
        assert observed_pursuit(other) != task
    assert observed_pursuit(known, acting="first") != task


def test_a_task_s_spaces_and_ends_are_its_environment_s():
    task = observed_pursuit(Pursuit(4, 2, time_limit=3, capture="all"))
    assert (task.observations.shape, task.n_actions, task.longest) == ((10,), 25, 3)
    environment = task.environment()
    environment.reset(options={"state": {"prey": 15, "predator_1": 0, "predator_2": 0}})
    ends = [environment.step(0)[2:4] for _ in range(3)]  # too far to be caught
    assert ends == [(False, False), (False, False), (False, True)]
