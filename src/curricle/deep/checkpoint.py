"""Checkpoints of a run: all that it needs to resume with the same result.

Checkpoints are pickles: read only those of your own runs. Results are no pickles.
"""

import io
import random
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import cloudpickle
import numpy as np
import torch

from curricle.errors import LostStoreError, StoreError, reason
from curricle.files import Place, RemotePath, opened_regular, write_whole

LEFT_OUT = ("_logger",)
"""Attributes of a model that hold open files, and are created again."""


class Saved(NamedTuple):
    """A checkpoint."""

    run: str
    """What is trained: a checkpoint of something else is refused."""
    model: tuple[type, dict[str, Any]]
    """An algorithm's class and attributes: network, optimizer, replay buffer, environments."""
    progress: Any
    """What has been recorded so far."""
    states: tuple[Any, ...]
    """Of the random number generators."""


class _Packing(cloudpickle.Pickler):
    """Leaves out the zeros that end a large array, and writes small whole numbers as bytes."""

    def reducer_override(self, obj: Any) -> Any:
        if not isinstance(obj, np.ndarray) or obj.nbytes < 2**20 or obj.dtype.kind not in "biuf":
            return super().reducer_override(obj)
        rows = np.ascontiguousarray(obj).reshape(len(obj), -1)
        filled = np.flatnonzero(rows.view(np.uint8).any(axis=1))
        used = rows[: filled[-1] + 1 if filled.size else 0]
        with np.errstate(invalid="ignore"):  # what is no byte is compared below
            small = used.astype(np.uint8)
        if np.array_equal(small, used) and not (used.dtype.kind == "f" and np.signbit(used).any()):
            used = small
        return _unpacked, (obj.shape, obj.dtype, used.dtype, used.tobytes())


def _unpacked(shape: tuple[int, ...], dtype: Any, packed: Any, content: bytes) -> Any:
    array, used = np.zeros(shape, dtype), np.frombuffer(content, packed)
    array.reshape(-1)[: used.size] = used
    return array


def _pickled(saved: Saved) -> bytes:
    file = io.BytesIO()
    _Packing(file).dump(saved)
    return file.getvalue()


def save(path: Place, run: str, model: Any, progress: Any) -> None:
    """Write a checkpoint, whole or not at all.

    An environment that cannot be pickled is left out; the run then resumes with a new episode.
    """
    saved = Saved(run, _held(model), progress, generator_states())
    try:
        content = _pickled(saved)
    except Exception:  # whatever an environment's own code raises
        content = _pickled(saved._replace(model=_held(model, env=None, _last_obs=None)))
    try:
        if isinstance(path, Path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise LostStoreError(
            f"a checkpoint cannot be written to {path} ({reason(error)}): a run with --resume goes "
            "on from the last one"
        ) from error


def _held(model: Any, **changed: Any) -> tuple[type, dict[str, Any]]:
    """Return a model's class and attributes, some of them changed."""
    held = {name: value for name, value in vars(model).items() if name not in LEFT_OUT}
    return type(model), held | changed


def load(path: Place, run: str) -> Saved | None:
    """Return a checkpoint, None if there is none; StoreError when damaged or of another run.

    One at a URL that is not whole counts as none: nothing moves it there when it is.
    """
    try:
        with opened_regular(path) as (file, _):
            content = file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise LostStoreError(f"a checkpoint cannot be read: {path} ({reason(error)})") from error
    saved: Any = None
    with suppress(Exception):
        saved = cloudpickle.loads(content)
    if not isinstance(saved, Saved):
        if isinstance(path, RemotePath):
            return None
        raise StoreError(f"a checkpoint must be one that curricle wrote, here: {path} is not")
    if saved.run != run:
        raise StoreError(
            f"a checkpoint belongs to one run: {path} is of {saved.run}, this is {run}"
        )
    return saved


def restored(saved: Saved) -> Any:
    """Return the model of a checkpoint, and set the random number generators to its states."""
    kind, held = saved.model
    model: Any = object.__new__(kind)
    model.__dict__.update(held)
    set_generators(saved.states)
    return model


def generator_states() -> tuple[Any, ...]:
    """Return the states of the generators that Stable-Baselines3 draws from."""
    state = np.random.get_state()  # noqa: NPY002 - the one it uses
    return random.getstate(), state, torch.get_rng_state()


def set_generators(states: tuple[Any, ...]) -> None:
    """Set the generators that Stable-Baselines3 draws from."""
    random.setstate(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
    torch.set_rng_state(states[2])


@contextmanager
def drawing(seed: int) -> Iterator[None]:
    """Let torch draw from a seed, and restore the generators afterwards."""
    states = generator_states()
    torch.manual_seed(seed % 2**63)
    try:
        yield
    finally:
        set_generators(states)


@contextmanager
def isolated(threads: int) -> Iterator[None]:
    """Use so many of torch's threads, and restore their number and the generators afterwards."""
    before, states = torch.get_num_threads(), generator_states()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        set_generators(states)
