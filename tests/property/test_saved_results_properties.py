"""What is saved is loaded bit for bit, whatever arrays a result has, and equal ones alike."""

import tempfile
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays

import curricle as cr
from curricle.learning import LearningResult, SparseValues, TabularPolicy, harmonic, linear
from curricle.learning.record import Snapshots
from curricle.learning.result import CURVES

TASK = cr.GridWorld(["S.", ".T"])
N_STATES, N_ACTIONS = 4, 4
ANY_RETURN = st.floats(width=64, allow_infinity=False)
LEARNERS = st.sampled_from(
    [
        cr.QLearning(learning_rate=0.3, epsilon=linear(1.0, 0.1, steps=90)),
        cr.SARSA(inverse_temperature=2.0),
        cr.DoubleQLearning(learning_rate=harmonic(), initial_value=-1.5),
        cr.learning.OptimisticQLearning(value_range=(-5.0, 9.0)),
        cr.learning.RMax(value_range=(-5.0, 9.0), min_visits=3),
    ]
)


def array(shape, elements, dtype):
    return arrays(dtype, shape, elements=elements)


@st.composite
def values(draw, n_seeds):
    """Dense tables of either precision, sparse ones, or none."""
    kind = draw(st.sampled_from(["float64", "float32", "sparse", "none"]))
    if kind == "none":
        return None
    if kind != "sparse":
        width = 64 if kind == "float64" else 32
        numbers = st.floats(width=width)
        return draw(array((n_seeds, N_STATES, N_ACTIONS), numbers, kind))
    draws = []
    for _ in range(n_seeds):
        states = sorted(draw(st.sets(st.integers(0, N_STATES - 1), min_size=1)))
        rows = draw(array((len(states), N_ACTIONS), st.floats(width=64), "float64"))
        draws.append(SparseValues(np.array(states, dtype=np.int64), rows))
    return tuple(draws)


@st.composite
def results(draw):
    n_seeds, n = draw(st.integers(1, 3)), draw(st.integers(1, 4))
    seeds = draw(st.lists(st.integers(0, 2**40), min_size=n_seeds, max_size=n_seeds, unique=True))
    counts = st.integers(0, 2**53)
    freq = draw(st.integers(1, 10**9))
    curves = {
        name: draw(array((n_seeds, n), counts, "int64"))
        if name == "episodes"
        else draw(array((n_seeds, n), ANY_RETURN, "float64"))
        for name in CURVES
    }
    totals = {
        name: draw(array((n_seeds,), counts, "int64"))
        for name in ("steps_used", "episodes_used", "evaluation_steps", "floor_steps")
    }
    flags = {
        name: draw(array((n_seeds,), st.booleans(), "bool"))
        for name in ("out_of_memory", "own_rewards")
    }
    ends = st.sampled_from(["all steps used", "memory full", "threshold reached"])
    levels = {
        "ended_by": draw(array((n_seeds,), ends, "U64")),
        "level": draw(array((n_seeds,), st.floats(), "float64")),
        "floor": draw(array((n_seeds,), st.floats(), "float64")),
    }
    snapshots = None
    if draw(st.booleans()):
        tables = array((2, N_STATES, N_ACTIONS), st.floats(width=32, allow_infinity=False), "f4")
        snapshots = Snapshots(draw(st.sampled_from(seeds)), np.array([0, 5]), draw(tables))
    return LearningResult(
        task=TASK,
        learner=draw(LEARNERS),
        seeds=tuple(seeds),
        values=draw(values(n_seeds)),
        steps=np.arange(n) * freq,
        snapshots=snapshots,
        **curves,
        **totals,
        **levels,
        **flags,
    )


def bits(value):
    """A field as something that is equal only where each bit of it is."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, SparseValues):
        return bits(value.states), bits(value.values)
    if isinstance(value, Snapshots):
        return value.seed, bits(value.steps), bits(value.values)
    return tuple(map(bits, value)) if isinstance(value, tuple) else value


@settings(deadline=None, max_examples=60)
@given(results())
def test_a_result_is_loaded_bit_for_bit_and_saved_to_the_same_bytes(result):
    with tempfile.TemporaryDirectory() as folder:
        file = result.save(f"{folder}/one")
        again = LearningResult.load(file, TASK)
        for field in fields(result):
            assert bits(getattr(again, field.name)) == bits(getattr(result, field.name)), field.name
        copy = replace(result, steps=result.steps.copy())
        assert again.save(f"{folder}/two").read_bytes() == file.read_bytes()
        assert copy.save(f"{folder}/three").read_bytes() == file.read_bytes()
        assert not again.steps.flags.writeable


@settings(deadline=None, max_examples=40)
@given(values(1))
def test_a_policy_is_loaded_bit_for_bit(given_values):
    if given_values is None:
        return
    policy = TabularPolicy(TASK, given_values[0])
    with tempfile.TemporaryDirectory() as folder:
        file = policy.save(f"{folder}/one")
        again = TabularPolicy.load(file, TASK)
        assert bits(again.values) == bits(policy.values)
        assert again.save(f"{folder}/two").read_bytes() == file.read_bytes()


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_a_file_with_a_bit_changed_is_refused(data):
    result = data.draw(results())
    with tempfile.TemporaryDirectory() as folder:
        file = result.save(f"{folder}/one")
        content = bytearray(file.read_bytes())
        if data.draw(st.booleans()):
            content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(
                st.integers(0, 7)
            )
        else:
            content = content[: data.draw(st.integers(0, len(content) - 1))]
        file.write_bytes(content)
        with pytest.raises(cr.errors.StoreError) as caught:
            LearningResult.load(file, TASK)
        assert "\n" not in str(caught.value)
