"""The kernel under compiled loops: machine code on disk, parts by type, random draws, vector code.

A random stream is a (1,) uint64 counter: drawing adds a constant and mixes the bits of the sum
(SplitMix64; Steele, Lea, Flood 2014). The n-th draw depends only on n and on the stream's start.
"""

import hashlib
import inspect
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir
from numba import _dynfunc, config, njit, types  # type: ignore[attr-defined]  # no stub
from numba._dispatcher import compute_fingerprint
from numba.core import cgutils, codegen, compiler, imputils, typed_passes
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.compiler_machinery import register_pass
from numba.core.cpu import CPUContext
from numba.core.typing.templates import Signature
from numba.extending import intrinsic, overload

from curricle.checks import number, whole_number
from curricle.errors import SettingError, TaskError

if config.DISABLE_JIT:  # type: ignore[attr-defined]  # Numba sets it when it is imported
    raise SettingError(
        "loops must be compiled, as plain Python cannot run them: unset NUMBA_DISABLE_JIT"
    )

# -- machine code on disk --------------------------------------------------------------------------

MARKS = (b"numba", b"tasks.kernel", b".body(")
"""Each file with compiled code contains one of these: an import, or a decorator."""

ENTRY: Any = {"nogil": True, "no_cfunc_wrapper": True}  # no C code calls a loop
entered_from_python: Any = njit(**ENTRY)
"""Compiles a function that Python calls, in each process anew."""


def compiled_once(function: Callable[..., Any]) -> Any:
    """Return a function that is compiled when it is first called, and then kept on disk."""
    compiled = entered_from_python(function)
    with suppress(RuntimeError):  # no folder can be written to: it is compiled in each process
        compiled._cache = LoopCache(function)
    return compiled


@cache
def compiled(loop: Callable[..., Any], users_code: bool) -> Any:
    """Return a loop compiled; cached on disk unless a user's functions are compiled into it."""
    return entered_from_python(loop) if users_code else compiled_once(loop)


@cache
def code_digest() -> str:
    """Return a digest of Curricle's version and of each of its files with compiled code."""
    # Numba by itself asks only whether the loop's own file has changed. It would go on with machine
    # code into which an older function of another file was compiled.
    root = Path(__file__).parents[1]
    digest = hashlib.sha256((root / "__init__.py").read_bytes())
    for file in sorted(root.rglob("*.py")):
        content = file.read_bytes()
        if any(mark in content for mark in MARKS):
            digest.update(content)
    return digest.hexdigest()


class LoopCache(FunctionCache):
    """Numba's cache of a function; a file that cannot be written or read is no error."""

    def __init__(self, function: Callable[..., Any]):
        numbas: Any = super()
        numbas.__init__(function)
        index: Any = LoopIndex
        self._cache_file = index(self._cache_path, self._impl.filename_base, code_digest())

    def save_overload(self, sig: object, data: object) -> None:
        """Write the machine code that was compiled for a signature."""
        numbas: Any = super()
        with suppress(OSError):  # a full disk: it is compiled again in the next process
            numbas.save_overload(sig, data)


class LoopIndex(IndexDataCacheFile):
    """The file that says which signatures are kept."""

    def _load_index(self) -> dict[Any, str]:
        """Return the file of each signature; none where the index is of another version."""
        numbas: Any = super()
        try:
            return dict(numbas._load_index())
        except Exception:  # of any kind: an old index may name types that are gone
            return {}


# -- parts of loops --------------------------------------------------------------------------------

# Numba optimises every function and makes machine code of it, also where it is only ever inlined,
# which would take a quarter of the time of compiling a loop of dozens of such parts. Parts are kept
# as intermediate code instead, which is optimised with the loop that takes it in.


class _Part(codegen.JITCodeLibrary):
    """The code of a part, for loops to link: not optimised as a whole, and no machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: there is no machine code."""
        self._ensure_finalized()
        return 0


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(typed_passes.NativeLowering):
    """Writes a function's intermediate code into a part."""

    _name = "part_lowering"

    def run_pass(self, state: compiler.StateDict) -> bool:
        """Lower the function; Python has no entry to it."""
        cpu = state.targetctx
        state.library = _Part(cpu.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        of, library = lowered.fndesc, state.library
        entry = _dynfunc.make_function(
            of.lookup_module(), of.unique_name, "", 0, lowered.env, (library,)
        )
        cpu.insert_user_function(entry, of, [library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


class PartCompiler(compiler.CompilerBase):
    """Numba's pipeline for functions that only compiled loops call."""

    def define_pipelines(self) -> list[Any]:
        """Return the pipeline."""
        builder = compiler.DefaultPassBuilder
        passes = builder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_PartLowering if step is typed_passes.NativeLowering else step, text)
            for step, text in passes.passes
        ]
        passes._finalized = False
        passes.finalize()
        return [passes]


Body = Callable[..., Any]
Function = TypeVar("Function", bound=Body)

INLINED: Any = {
    "nogil": True,
    "forceinline": True,  # a call with arrays costs more than most of these functions do
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": PartCompiler,  # no machine code of their own either
    "_nrt": False,  # inlined functions make no arrays; counting references takes 80 ns a step
}
"""How a function is compiled into its callers, without an entry from Python."""
inlined = njit(**INLINED)
"""Compiles a function for loops. Python must not call it, as that would end the process."""
outlined = njit(**{**INLINED, "forceinline": False})
"""The same for what is long, or seldom runs: loops may call it."""


def compiled_as(body: Callable[..., Any]) -> Callable[[Function], Function]:
    """Return a decorator of a Python function that compiled code calls too, as `body`, inlined."""

    def register(function: Function) -> Function:
        overload(function, jit_options=INLINED, strict=False)(lambda *_: body)
        return function

    return register


def overloaded(*, outlined: bool = False, otherwise: Body | None = None) -> Callable[[Any], Any]:
    """Return a decorator of a signature for compiled code, which has bodies by type.

    ``function.body(kind)`` makes a plain function its body for one type of NamedTuple that it takes
    first. Bodies that seldom run are called, not inlined (`outlined`).
    """

    def register(function: Any) -> Any:
        function.bodies = bodies = dict[type, Body]()

        def choose(first: object, *_: object) -> Body | None:
            return bodies.get(getattr(first, "instance_class", type(None)), otherwise)

        def body(kind: type) -> Callable[[Body], Body]:
            def add(plain: Body) -> Body:
                bodies[kind] = plain
                return plain

            return add

        options: Any = {**INLINED, "forceinline": not outlined}
        overload(function, jit_options=options, strict=False)(choose)
        function.body = body
        return function

    return register


# -- machine code that loops call at its address ---------------------------------------------------
#
# The code for a checkpoint takes longer to compile than the code for a step. It is compiled once,
# and all loops call it by its address: Numba would compile a function that is called by name into
# each loop anew.


CALLABLE = set[tuple[types.Type, ...]]()  # the types of arguments for which there is machine code
_ADDRESSES = dict[Any, int]()


def address_of(loop: Any, *arguments: Any) -> int:
    """Return where the machine code of a compiled function for such arguments begins."""
    key = None
    with suppress(NotImplementedError):  # of a user's compiled functions
        key = loop, compute_fingerprint(arguments)  # thirty times faster than Numba's types
    if key not in _ADDRESSES:
        kinds = tuple(loop.typeof_pyval(argument) for argument in arguments)
        loop.compile(kinds)  # or read from the disk, or nothing, where it is there
        CALLABLE.add(kinds)
        machine = loop.overloads[kinds]
        name = machine.fndesc.llvm_func_name
        _ADDRESSES[key] = int(machine.library.get_pointer_to_function(name))
    return _ADDRESSES[key] if key else _ADDRESSES.pop(key)


@intrinsic
def called(_, address, arguments):
    """Return the float64 that the machine code at an address returns for a tuple of arguments."""
    # Nothing at run time knows what the machine code takes: `address_of` must have been given an
    # example of these arguments.
    kinds = tuple(types.unliteral(kind) for kind in arguments)
    if kinds not in CALLABLE:
        raise TypeError(f"no machine code takes arguments of types {kinds}")

    def build(
        context: CPUContext, builder: ir.IRBuilder, signature: Signature, args: Sequence[ir.Value]
    ) -> ir.Value:
        convention = context.call_conv
        kind = convention.get_function_type(types.float64, kinds).as_pointer()
        parts = [
            context.cast(builder, builder.extract_value(args[1], place), kind_there, kind_taken)
            for place, (kind_there, kind_taken) in enumerate(zip(arguments, kinds, strict=True))
        ]
        code = builder.inttoptr(args[0], kind)
        status, value = convention.call_function(builder, code, types.float64, kinds, parts)
        with builder.if_then(status.is_error):
            convention.return_status_propagate(builder, status)
        return value

    return types.float64(address, arguments), build


# -- random draws ----------------------------------------------------------------------------------

STRIDE = np.uint64(0x9E3779B97F4A7C15)  # what a draw adds to the counter
LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
ALL = 2**64 - 1


def _mixed(number):
    z = number
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@compiled_as(_mixed)
def splitmix64(number: int) -> int:
    """Return a 64-bit number whose bits all depend on all bits of `number`, one to one.

    Compiled code may call it as Python does; also uniform, integers and bernoulli.

    Examples
    --------
    >>> splitmix64(1)
    6238072747940578789
    """
    z = _bits("number", number)
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & ALL
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & ALL
    return z ^ (z >> 31)


def stream_start(seed: int, stream: str) -> int:
    """Return where the random stream of this seed and name starts, a 64-bit number."""
    return int.from_bytes(hashlib.blake2b(f"{seed}/{stream}".encode(), digest_size=8).digest())


@inlined
def draw(stream):
    """Return 64 random bits and advance `stream`."""
    stream[0] += STRIDE
    return splitmix64(stream[0])


@compiled_as(lambda bits: np.float64(bits >> np.uint64(11)) * (1.0 / 9007199254740992.0))
def uniform(bits: int) -> float:
    """Return a float in [0, 1) made of the upper 53 bits.

    Examples
    --------
    >>> uniform(2**63)
    0.5
    """
    return (_bits("bits", bits) >> 11) / 2**53


@compiled_as(lambda bits, n: ((bits & LOW) * np.uint64(n)) >> HALF)
def integers(bits: int, n: int) -> int:
    """Return a whole number from 0 to n - 1 made of the lower 32 bits; n is at most 2^32.

    Examples
    --------
    >>> integers(splitmix64(2), 6)
    1
    """
    number("n", whole_number("n", n, 1, TaskError), TaskError, high=2**32)
    return ((_bits("bits", bits) & (2**32 - 1)) * int(n)) >> 32


@compiled_as(lambda bits, probability: np.float64(bits >> HALF) < probability * 4294967296.0)
def bernoulli(bits: int, probability: float) -> bool:
    """Return True with this probability, by the upper 32 bits.

    Examples
    --------
    >>> bernoulli(2**63 - 1, 0.5), bernoulli(2**63, 0.5)
    (True, False)
    """
    chance = number("probability", probability, TaskError, low=0, high=1)
    return (_bits("bits", bits) >> 32) < chance * 2**32


def _bits(name: str, value: Any) -> int:
    """Return 64 bits as an int, or raise TaskError."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or not 0 <= int(value) <= ALL:
        raise TaskError(f"{name} must be a whole number in 0..2^64 - 1: got {value!r}")
    return int(value)


@inlined
def first_above(rising, value):
    """Return the first index of a rising array whose entry exceeds `value`, by bisection."""
    low, high = np.uint64(0), np.uint64(rising.shape[0])
    while low < high:
        middle = (low + high) >> np.uint64(1)
        if rising[middle] > value:
            high = middle
        else:
            low = middle + np.uint64(1)
    return low


# -- vector instructions and prefetching in LLVM, which Numba does not offer -----------------------

LANES = 8
"""Values of a vector in which a row is read; a narrower processor takes several instructions."""
LINE = 64  # bytes of a cache line
WORD, FLAG, LONG, WIDE = (ir.IntType(width) for width in (32, 1, 64, 128))
WORDS = ir.VectorType(WORD, LANES)


def lowered(typed: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator of a builder of LLVM code, which makes it a function for loops.

    `typed` takes the types of the arguments and returns the signature.
    """

    def register(build: Callable[..., Any]) -> Any:
        def definition(_: object, *kinds: Any) -> tuple[Any, Callable[..., Any]]:
            return typed(*kinds), build

        context = inspect.Parameter("_", inspect.Parameter.POSITIONAL_ONLY)
        arguments = inspect.signature(typed).parameters.values()
        definition.__name__, as_seen = build.__name__, inspect.Signature([context, *arguments])
        definition.__signature__ = as_seen  # type: ignore[attr-defined]  # which Numba reads
        return intrinsic(definition)

    return register


@lowered(lambda table, row, changed, first: table.dtype(table, row, changed, first))
def highest_of_lanes(context, builder, signature, args):
    """Return the highest of up to 8 values of a row, from `first` on; no NaN, (n, m) C-ordered.

    The row is read as if it were `changed`, an entry and its value, or None.
    """
    values, inside = _vector(context, builder, signature, args)
    low = ir.Constant(values.type, [float("-inf")] * LANES)
    values, kind = builder.select(inside, values, low), values.type.element
    name = f"llvm.vector.reduce.fmax.v{LANES}{kind.intrinsic_name}"
    reduce = builder.module.declare_intrinsic(name, (), ir.FunctionType(kind, [values.type]))
    return builder.call(reduce, [values], fastmath=("nnan",))


@lowered(
    lambda table, row, changed, first, value: types.uint64(table, row, changed, first, table.dtype)
)
def ties_in_lanes(context, builder, signature, args):
    """Return which of 8 values of a row from entry `first` on equal `value`, one bit each."""
    values, inside = _vector(context, builder, signature, args)
    tied = builder.fcmp_ordered("==", values, _spread(builder, args[4]))
    return builder.zext(builder.bitcast(builder.and_(inside, tied), ir.IntType(LANES)), LONG)


@lowered(lambda bits: types.uint64(types.uint64))
def ones(context, builder, signature, args):
    """Return how many bits of a 64-bit number are set."""
    return builder.ctpop(args[0])


@lowered(lambda bits, n: types.uint64(types.uint64, types.uint64))
def nth_one(context, builder, signature, args):
    """Return the position of the n-th set bit, counted from 0, of a 64-bit number."""
    if "+bmi2" in context.codegen().magic_tuple()[2]:
        kind = ir.FunctionType(LONG, [LONG, LONG])
        deposit = builder.module.declare_intrinsic("llvm.x86.bmi.pdep.64", (), kind)
        bit = builder.call(deposit, [builder.shl(ir.Constant(LONG, 1), args[1]), args[0]])
    else:
        bit = context.compile_internal(builder, _without_lowest, signature, args)
    return builder.cttz(bit, ir.Constant(FLAG, 1))


def _without_lowest(bits: np.uint64, n: np.uint64) -> np.uint64:
    """Return a number with its n lowest set bits cleared."""
    while n > 0:
        bits &= bits - np.uint64(1)
        n -= np.uint64(1)
    return bits


def _vector(
    context: CPUContext, builder: ir.IRBuilder, signature: Signature, args: Sequence[ir.Value]
) -> tuple[ir.Value, ir.Value]:
    """Return 8 values of a row from an entry on, and which lie in the row; no others are read."""
    table, _, changed, *_ = signature.args
    array = context.make_array(table)(context, builder, args[0])
    width, first = builder.extract_value(array.shape, 1), args[3]
    start = builder.gep(array.data, [builder.add(builder.mul(args[1], width), first)])
    lanes = ir.Constant(WORDS, list(range(LANES)))
    numbers = builder.add(lanes, _spread(builder, builder.trunc(first, WORD)))
    inside = builder.icmp_unsigned("<", numbers, _spread(builder, builder.trunc(width, WORD)))
    kind = ir.VectorType(context.get_data_type(table.dtype), LANES)
    name = f"llvm.masked.load.v{LANES}{kind.element.intrinsic_name}.p0"
    parts = [kind.as_pointer(), WORD, inside.type, kind]
    load = builder.module.declare_intrinsic(name, (), ir.FunctionType(kind, parts))
    size = ir.Constant(WORD, context.get_abi_sizeof(kind.element))
    start = builder.bitcast(start, kind.as_pointer())
    values = builder.call(load, [start, size, inside, ir.Constant(kind, None)])
    if isinstance(changed, types.BaseTuple):
        entry, value = (_spread(builder, builder.extract_value(args[2], k)) for k in (0, 1))
        entry = builder.trunc(entry, WORDS)
        values = builder.select(builder.icmp_unsigned("==", numbers, entry), value, values)
    return values, inside


def _spread(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """Return a vector of one value."""
    kind = ir.VectorType(value.type, LANES)
    first = builder.insert_element(ir.Constant(kind, None), value, ir.Constant(WORD, 0))
    return builder.shuffle_vector(first, first, ir.Constant(WORDS, [0] * LANES))


@lowered(lambda array, width: array(array, width))
def of_width(context, builder, signature, args):
    """Return a C-ordered (n, m) array with m known to the compiler: len(width), if not 0."""
    array, width = signature.args
    table = context.make_array(array)(context, builder, args[0])
    if width.count > 0:
        m = ir.Constant(context.get_value_type(types.intp), width.count)
        size = context.get_abi_sizeof(context.get_data_type(array.dtype))
        table.shape = builder.insert_value(table.shape, m, 1)
        stride = ir.Constant(m.type, width.count * size)
        table.strides = builder.insert_value(table.strides, stride, 0)
    return imputils.impl_ret_borrowed(context, builder, array, table._getvalue())


@lowered(lambda array, row: types.void(array, row))
def prefetch(context, builder, signature, args):
    """Prefetch all cache lines of a row of a C-ordered (n, m) or (n,) array, to be read soon."""
    array = signature.args[0]
    table = context.make_array(array)(context, builder, args[0])
    count = context.get_value_type(types.intp)
    width = builder.extract_value(table.shape, 1) if array.ndim > 1 else ir.Constant(count, 1)
    size = context.get_abi_sizeof(context.get_data_type(array.dtype))
    byte = ir.IntType(8).as_pointer()
    start = builder.ptrtoint(builder.gep(table.data, [builder.mul(args[1], width)]), count)
    last = builder.mul(builder.sub(width, ir.Constant(count, 1)), ir.Constant(count, size))
    kind = ir.FunctionType(ir.VoidType(), [byte, WORD, WORD, WORD])
    fetch = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
    how = [ir.Constant(WORD, n) for n in (0, 3, 1)]  # to read, keep, data
    steps = ir.Constant(count, 0), last, ir.Constant(count, LINE), count
    with cgutils.for_range_slice(builder, *steps) as (offset, _):
        builder.call(fetch, [builder.inttoptr(builder.add(start, offset), byte), *how])
    builder.call(fetch, [builder.inttoptr(builder.add(start, last), byte), *how])
    return context.get_dummy_value()


def inverse_of(divisor: int, numbers: int) -> np.uint64:
    """Return the multiplier with which :func:`quotient` divides numbers below `numbers`, or 0."""
    # It exceeds 2^64 / divisor by at most 1, so that the product exceeds 2^64 number / divisor by
    # less than 2^64 / divisor, which is too little to reach the next whole number.
    exact = divisor >= 2 and numbers * divisor <= 2**64
    return np.uint64(2**64 // divisor + 1 if exact else 0)


@lowered(lambda number, inverse: types.uint64(types.uint64, types.uint64))
def quotient(context, builder, signature, args):
    """Return number // divisor as the upper 64 bits of number * inverse."""
    product = builder.mul(*(builder.zext(factor, WIDE) for factor in args))
    return builder.trunc(builder.lshr(product, ir.Constant(WIDE, 64)), LONG)
