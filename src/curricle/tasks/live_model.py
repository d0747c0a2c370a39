"""The generative model of a live task: compiled loops call a Python object for each step."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from curricle.tasks.generative_models import (
    evaluation_models,
    failures,
    first_states,
    transitions,
    truncations,
)
from curricle.tasks.overloads import inlined

RESET = -1
"""Sent instead of an action to start an episode."""
RUNNING, TRUNCATED, FAILED = range(3)
"""What the last step led to, termination apart."""


class Live(NamedTuple):
    """Two environments of one task: the one that is learnt in, and one to evaluate policies in."""

    asked: npt.NDArray[np.uint64]  # (2,) the addresses of the callables of :func:`answer`
    status: npt.NDArray[np.int8]  # (2,) what the last step of each led to
    which: np.uint64  # which of the two is used


@first_states.body(Live)
def _live_start(model, bits):
    return _ask(model, RESET)[0]


@transitions.body(Live)
def _live_step(model, state, action, bits):
    return _ask(model, np.int64(action))


@truncations.body(Live)
def _live_truncated(model):
    return model.status[model.which] == TRUNCATED


@failures.body(Live)
def _live_failure(model):
    return max(model.status[0], model.status[1]) == FAILED


@evaluation_models.body(Live)
def _live_evaluation_model(model):
    return Live(model.asked, model.status, np.uint64(1))


@inlined
def _ask(model, action):
    state, reward, terminated, truncated = answer(model.asked[model.which], action)
    if state < 0:
        model.status[model.which] = FAILED
        return np.uint64(0), 0.0, True
    model.status[model.which] = TRUNCATED if truncated else RUNNING
    return np.uint64(state), reward, terminated


@intrinsic
def answer(_, address, action):
    """Return what the Python callable at an address returns for a number.

    A tuple: a state (int64; negative if it failed), a reward (float64), and whether the episode
    terminated or was truncated. Exceptions pass through, but compiled code then leaks its memory:
    callables should keep an exception and return that they failed.
    """
    parts = (types.int64, types.float64, types.boolean, types.boolean)

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        api = context.get_python_api(builder)
        flag = ir.IntType(32)
        slots = [
            cgutils.alloca_once(builder, kind) for kind in (api.longlong, api.double, flag, flag)
        ]
        parsed = cgutils.alloca_once_value(builder, ir.Constant(flag, 0))
        gil = api.gil_ensure()
        number = api.long_from_longlong(args[1])
        callee = builder.inttoptr(args[0], api.pyobj)
        answered = api.call_function_objargs(callee, [number])
        api.decref(number)
        with builder.if_then(cgutils.is_not_null(builder, answered)):
            builder.store(_parse(context, builder, api, answered, slots), parsed)
            api.decref(answered)
        api.gil_release(gil)
        raised = cgutils.is_null(builder, builder.load(parsed))
        with builder.if_then(raised, likely=False):
            context.call_conv.return_exc(builder)
        state, reward, *flags = (builder.load(slot) for slot in slots)
        values = [state, reward, *(cgutils.is_not_null(builder, value) for value in flags)]
        return context.make_tuple(builder, signature.return_type, values)

    return types.Tuple(parts)(types.uint64, types.int64), build


def _parse(context: Any, builder: Any, api: Any, answered: Any, slots: list[Any]) -> Any:
    """Write the parts of an answer to the slots; return 0 if their types do not fit."""
    expected = "Ldpp;an answer must be a state, a reward and two flags"
    kind = ir.FunctionType(ir.IntType(32), [api.pyobj, api.cstring], var_arg=True)
    parse = cgutils.get_or_insert_function(builder.module, kind, "PyArg_ParseTuple")
    constant = context.insert_const_string(builder.module, expected)
    return builder.call(parse, [answered, constant, *slots])
