"""The model of a live task: compiled loops that ask a Python object what comes of an action."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from curricle.tasks.draws import inlined
from curricle.tasks.generative_models import asides, cuts, failures, moves, starts

RESET = -1
"""What is asked instead of an action to start an episode."""
GOES_ON, CUT, FAILED = range(3)
"""What a step came to, beside reaching an end."""


class Live(NamedTuple):
    """Two environments of one task: the one that is learnt in, and one to evaluate policies in."""

    asked: npt.NDArray[np.uint64]  # (2,) where the callables lie that :func:`answer` asks
    status: npt.NDArray[np.int8]  # (2,) what the last step of each came to
    which: np.uint64  # which of the two is meant


@starts.body(Live)
def _live_start(model, bits):
    return _ask(model, RESET)[0]


@moves.body(Live)
def _live_step(model, state, action, bits):
    return _ask(model, np.int64(action))


@cuts.body(Live)
def _live_cut(model):
    return model.status[model.which] == CUT


@failures.body(Live)
def _live_failure(model):
    return max(model.status[0], model.status[1]) == FAILED


@asides.body(Live)
def _live_aside(model):
    return Live(model.asked, model.status, np.uint64(1))


@inlined
def _ask(model, action):
    state, reward, terminated, truncated = answer(model.asked[model.which], action)
    if state < 0:
        model.status[model.which] = FAILED
        return np.uint64(0), 0.0, True
    model.status[model.which] = CUT if truncated else GOES_ON
    return np.uint64(state), reward, terminated


@intrinsic
def answer(_, address, action):
    """Return what the Python callable at an address answers to a number.

    It returns a tuple: a state (int64; negative if it failed), a reward (float64), and whether the
    episode terminated or was truncated. What it raises instead, this raises too, though compiled
    code then gives no memory back: callables should rather keep it and answer that they failed.
    """
    parts = (types.int64, types.float64, types.boolean, types.boolean)

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        api = context.get_python_api(builder)
        flag = ir.IntType(32)
        places = [
            cgutils.alloca_once(builder, kind) for kind in (api.longlong, api.double, flag, flag)
        ]
        understood = cgutils.alloca_once_value(builder, ir.Constant(flag, 0))
        gil = api.gil_ensure()
        number = api.long_from_longlong(args[1])
        callee = builder.inttoptr(args[0], api.pyobj)
        answered = api.call_function_objargs(callee, [number])
        api.decref(number)
        with builder.if_then(cgutils.is_not_null(builder, answered)):
            builder.store(_parse(context, builder, api, answered, places), understood)
            api.decref(answered)
        api.gil_release(gil)
        raised = cgutils.is_null(builder, builder.load(understood))
        with builder.if_then(raised, likely=False):
            context.call_conv.return_exc(builder)
        state, reward, *flags = (builder.load(place) for place in places)
        values = [state, reward, *(cgutils.is_not_null(builder, value) for value in flags)]
        return context.make_tuple(builder, signature.return_type, values)

    return types.Tuple(parts)(types.uint64, types.int64), build


def _parse(context: Any, builder: Any, api: Any, answered: Any, places: list[Any]) -> Any:
    """Write the parts of an answer where they are to go; return 0 if it has others."""
    wording = "Ldpp;an answer must be a state, a reward and two flags"
    kind = ir.FunctionType(ir.IntType(32), [api.pyobj, api.cstring], var_arg=True)
    parse = cgutils.get_or_insert_function(builder.module, kind, "PyArg_ParseTuple")
    words = context.insert_const_string(builder.module, wording)
    return builder.call(parse, [answered, words, *places])
