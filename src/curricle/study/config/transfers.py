"""Transfers as tables: which mapping, how much of the source's values, calibrated or not."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from curricle.study.config.references import load, users_code
from curricle.study.config.settings import Setting
from curricle.study.config.tables import Flag, Name, Number, Table, Whole, either, flag, wrong
from curricle.study.config.tasks import Reference

MAPPINGS = ("project", "mapping", "function", "factory")
"""Ways to say which source pair a target pair reads; a transfer has one of them."""


class CalibrateTable(Setting):
    """How a potential is fitted to what its own policy earns in the target."""

    episodes: Whole = Field(default=200, description="Greedy episodes, charged to the target.")
    shift: Flag = Field(default=False, description="Whether to fit a shift besides the scale.")
    quantile: Number | None = Field(
        default=None, description="Fit this quantile of the returns instead of their mean."
    )

    def build(self) -> Any:
        """Return the settings of a calibration."""
        from curricle.transfer.edge import Calibrate

        return Calibrate(**dict(self))


class TransferTable(Table):
    """What a source hands to a target: phi = scale Q_source(f(s, a)) + shift."""

    source: Name = Field(description="The task learnt from, by its name in [tasks].")
    target: Name = Field(description="The task taught.")
    project: dict[str, str] | None = Field(
        default=None,
        description="f by name: source component = target component where the names differ; may be "
        "empty.",
    )
    mapping: Literal["identity", "same_position", "relative_objects"] | None = Field(
        default=None, description="f, one of Curricle's other mappings."
    )
    function: Reference | None = Field(
        default=None,
        description="f as a function from the target's decoded states and actions to the source's, "
        "module:function.",
    )
    factory: Reference | None = Field(
        default=None,
        description="A function that makes f from the tasks, (target, source) -> mapping.",
    )
    scale: Number = Field(default=1.0, description="Factor of the source's values.")
    shift: Number = Field(default=0.0, description="Added to them.")
    unmapped_value: Number = Field(
        default=0.0, description="What pairs without a source pair are worth."
    )
    calibrate: Annotated[bool | CalibrateTable, either(lambda _: CalibrateTable, flag)] = Field(
        default=False, description="Whether to fit the potential's size before learning, and how."
    )

    @model_validator(mode="after")
    def _one_mapping(self) -> Self:
        given = [name for name in MAPPINGS if getattr(self, name) is not None]
        if len(given) != 1:
            found = ", ".join(given) or "none"
            raise wrong(f"must have one of {', '.join(MAPPINGS)}: got {found}")
        if self.unmapped_value and (self.factory is not None or self.mapping == "identity"):
            raise wrong(
                "has an unmapped_value that nobody reads: a factory sets its own, and identity "
                "leaves nothing unmapped"
            )
        return self

    def build(self, tasks: Mapping[str, Any], folder: Path) -> Any:
        """Return the transfer.

        Parameters
        ----------
        tasks : dict of str to Task
        folder : Path
            The study file's, with the modules of a user's own functions.
        """
        from curricle.transfer.edge import Transfer

        calibrate = self.calibrate if isinstance(self.calibrate, bool) else self.calibrate.build()
        f = self._mapping(tasks[self.target], tasks[self.source], folder)
        return Transfer(self.source, self.target, f, self.scale, self.shift, calibrate)

    def _mapping(self, target: Any, source: Any, folder: Path) -> Any:
        from curricle.transfer import by_name, mapping

        value = self.unmapped_value
        if self.project is not None:
            return by_name.project(target, source, unmapped_value=value, **self.project)
        if self.mapping == "identity":
            return mapping.identity(target)
        if self.mapping is not None:
            return getattr(mapping, self.mapping)(target, source, unmapped_value=value)
        if self.factory is not None:
            make = load(self.factory, folder)
            with users_code(self.factory):
                return make(target, source)
        own = str(self.function)
        function = load(own, folder)
        with users_code(own):
            return mapping.from_function(target, source, function, unmapped_value=value)
