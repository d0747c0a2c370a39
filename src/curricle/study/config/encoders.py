"""Encoders of observations in study files: by name, as a table, or a function of the user's."""

from pathlib import Path
from typing import Annotated, Any

from curricle.interop.encoders import FlatDict, MiniGridFullView, MiniGridView, StackedFrames
from curricle.study.config.derived_tables import ObjectTable, built, table_of
from curricle.study.config.references import load
from curricle.study.config.tables import not_one_of, tagged, wrong

_SIMPLE = (
    table_of(MiniGridView, tag="MiniGridView"),
    table_of(MiniGridFullView, tag="MiniGridFullView"),
    table_of(FlatDict, tag="FlatDict", leave_out=tuple[str, ...]),
)


def _by_name(*tables: Any) -> Any:
    """Return the choice among tables by their names, or a reference to a function."""
    known = {str(table.model_fields["type"].default): table for table in tables}

    def simple(value: Any) -> Any:
        if isinstance(value, str) and ":" in value:
            return value
        if not isinstance(value, str) or value not in known:
            raise wrong(f"{not_one_of(value, known)} (or module:function)")
        needed = [key for key, one in known[value].model_fields.items() if one.is_required()]
        if needed:
            raise wrong(f"must be a table, as {value} needs {' and '.join(needed)}: got {value!r}")
        return known[value]()

    return Annotated[Any, tagged(*tables, simple=simple, simple_type=str)]


class _StackedFramesTable(ObjectTable):
    def arguments_in(self, folder: Path) -> dict[str, Any]:
        """Return the arguments, the encoder of each frame made."""
        given = super().arguments_in(folder)
        return {**given, "of": encoder(given["of"], folder)}


AnyEncoder = _by_name(
    *_SIMPLE,
    table_of(StackedFrames, _StackedFramesTable, tag="StackedFrames", of=_by_name(*_SIMPLE) | None),
)
"""An encoder: ``"MiniGridView"``, ``{ type = "FlatDict", ... }`` or ``"module:function"``."""


def encoder(value: Any, folder: Path) -> Any:
    """Return the encoder that a value of a study file stands for; None where there is none."""
    return load(value, folder) if isinstance(value, str) else built(value, folder)
