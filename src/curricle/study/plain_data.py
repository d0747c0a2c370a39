"""Parts of records in plain data: their types are fixed, and arrays are lists of numbers."""

from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, PlainValidator

from curricle.array_types import FloatArray, IntArray


def _array(dtype: type, kinds: str) -> Any:
    def read(value: Any) -> Any:
        try:
            found = np.asarray(value)
        except ValueError:
            raise ValueError("must be an array: its rows have different lengths") from None
        if found.size and found.dtype.kind not in kinds:
            raise ValueError(f"must be an array of {dtype.__name__}: got {found.dtype}")
        return found.astype(dtype)

    return PlainValidator(read)


Ints = Annotated[IntArray, _array(np.int64, "i"), PlainSerializer(np.ndarray.tolist)]
Floats = Annotated[FloatArray, _array(np.float64, "if"), PlainSerializer(np.ndarray.tolist)]
Count = Annotated[int, Field(ge=0)]


class Plain(BaseModel):
    """A part of a record: its keys and their types are fixed."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
