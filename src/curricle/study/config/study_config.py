"""What a study file says, complete and checked, and the curricula that it describes."""

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr, ValidationError, model_validator

from curricle.comparison.comparing import from_scratch, scratch_curricula
from curricle.curriculum.curriculum import Curriculum
from curricle.deep.learner import DeepLearner
from curricle.errors import ConfigError, CurricleError, SettingError
from curricle.statistics.curves import SCRATCH
from curricle.study.config.building import CurriculumBuilder
from curricle.study.config.derived_tables import built
from curricle.study.config.positions import Positions, Problems, path_text
from curricle.study.config.study_tables import ArmTables, RunTable
from curricle.study.config.tables import Count, Flag, Table, unknown, wrong_at
from curricle.study.config.task_names import table
from curricle.study.config.tuning_tables import Tuning
from curricle.study.study_table import config_html, config_in_brief


class VariantTable(Table):
    """The settings of an arm that a sweep or a tuning made."""

    arm: str
    """The arm as the file calls it; "scratch" of learning from scratch."""
    values: dict[str, Any]
    """By their keys in the file."""


class StudyConfig(RunTable):
    """A study of which nothing is left to fill in: every arm is complete, every map is there.

    :func:`read_study` makes it from a file, :meth:`from_data` from :meth:`to_data`. Two files with
    one meaning give equal configurations, and a study's results depend on nothing else but the
    modules of its own functions.

    Parameters
    ----------
    name, seeds, seeds_per_unit, threshold, window, snapshots, scratch, scratch_learners
        The keys of a study file.
    arms : dict of str to ArmTables
        The tasks and transfers of each arm.
    scratches : dict of str to ArmTables, optional
        The arms that learn the target from scratch, where a sweep or a tuning gives them settings;
        else they follow from the first arm.
    variants : dict of str to VariantTable, optional
        The settings of each arm that a sweep or a tuning gave it, scratch included.
    tune : Tuning, optional
        What is to be searched for every arm before the study is run.
    own_learners : bool, optional
        Whether each arm may learn the target in its own way, as it was tuned.
    total : int, optional
        Steps that every arm spends at least, sources included.

    Examples
    --------
    >>> study = StudyConfig.from_data(
    ...     {"name": "line", "arms": {"transfer": {
    ...         "tasks": {"line": {"type": "maze", "map": "S..T"}}}}}, Path())
    >>> study.curriculum("transfer").target
    'line'
    """

    arms: dict[str, ArmTables]
    scratches: dict[str, ArmTables] | None = None
    variants: dict[str, VariantTable] | None = None
    tune: Tuning | None = None
    own_learners: Flag | None = None
    total: Count | None = None

    @model_validator(mode="after")
    def _tuned_apart(self) -> Self:
        if self.tune and (both := sorted({*self.tune.seeds} & {*self.seeds})):
            text = f"must be none of the study's seeds: {both[0]} is one"
            raise wrong_at((("tune", "seeds"), text))
        return self

    _folder: Path = PrivateAttr(default=Path())
    _positions: Positions = PrivateAttr(default=Positions("", {}))
    _made: dict[str, Any] = PrivateAttr(default_factory=dict)
    _say: Callable[[str], Any] = PrivateAttr(default=print)

    @classmethod
    def from_data(
        cls,
        data: Mapping[str, Any],
        folder: Path,
        positions: Positions | None = None,
        *,
        say: Callable[[str], Any] = print,
    ) -> Self:
        """Return the configuration that plain data describe, as :meth:`to_data` returns them.

        Parameters
        ----------
        data : dict
        folder : Path
            Of the modules with the study's own functions.
        positions : Positions, optional
            Where in a file things are, for messages.
        say : callable
            Takes each line about a mapping that is found.

        Raises
        ------
        pydantic.ValidationError
        """
        families = table(positions.study.get("families")) if positions else {}
        context = {"folder": folder, "families": tuple(families)}
        config = cls.model_validate(dict(data), context=context)
        config._folder, config._say = folder, say
        config._positions = positions or Positions(config.name, data)
        return config

    def to_data(self) -> dict[str, Any]:
        """Return the configuration as plain data, which JSON can hold.

        Maps are in it, every arm is complete and every setting is given, so that equal data mean
        equal results as long as the study's own functions stay the same.
        """
        return self.model_dump(mode="json", exclude_none=True)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StudyConfig) and self.to_data() == other.to_data()

    def __repr__(self) -> str:
        return config_in_brief(self)

    def _repr_html_(self) -> str:
        return config_html(self)

    __hash__ = None  # type: ignore[assignment]

    @property
    def folder(self) -> Path:
        """The folder of the modules with the study's own functions."""
        return self._folder

    @property
    def file(self) -> str:
        """The name of the file that it was read from, without its folder; else the study's name."""
        return Path(self._positions.file).name

    @property
    def results_folder(self) -> str:
        """The name of the folder that results go to by default, FILE-results."""
        return f"{Path(self.file).stem}-results"

    @cached_property
    def curricula(self) -> dict[str, Curriculum]:
        """The curricula of all arms, by name.

        Raises
        ------
        ConfigError
            Naming all that cannot be built.
        """
        return self._built(self.arms)

    def scratch_curricula(self) -> dict[str, Curriculum]:
        """Return the arms that learn the target from scratch, ``scratch`` first.

        Raises
        ------
        ConfigError
            Naming each learner that does not fit the target, or is its own.
        """
        if self.scratches is not None:
            return self._built(self.scratches)
        first, found = next(iter(self.curricula.values())), Problems(self._positions)
        made = {SCRATCH: from_scratch(first)}
        for name, learner in self.scratch_learners.items():
            try:
                made |= scratch_curricula({name: built(learner, self.folder)}, first)
            except CurricleError as error:
                found.add([(("scratch_learners", name), f"cannot be compared: {error}")])
        found.raise_any()
        return made

    def curriculum(self, arm: str) -> Curriculum:
        """Return the curriculum of one arm; ConfigError as in :attr:`curricula`."""
        if arm not in self.arms:
            raise ConfigError(f"{self._positions.file}: arm {arm!r} {unknown(arm, self.arms)}")
        return self._built({arm: self.arms[arm]})[arm]

    def check_networks(self) -> None:
        """Check the learners that are networks with Stable-Baselines3.

        Raises
        ------
        SettingError
            When there is such a learner, and Stable-Baselines3 is not installed.
        ConfigError
            Naming each algorithm, setting and kind of shaping that it does not support.
        """
        found = Problems(self._positions)
        for arm, curriculum in self.curricula.items():
            for name in curriculum.order:
                learner, shaping = (curriculum.setting(s, name) for s in ("learner", "shaping"))
                if not isinstance(learner, DeepLearner):
                    continue
                try:
                    with found.at(arm, ("tasks", name, "learner")):
                        learner.algorithm_class()
                        from curricle.deep.models import check_learner

                        edges = curriculum.in_edges(name)
                        sources = dict.fromkeys(edge.source for edge in edges)
                        tables = [one for one in sources if not curriculum.node(one).deep]
                        check_learner(learner, shaping if edges else None, tables)
                except ImportError as error:  # it names what to install
                    raise SettingError(f"a task is learnt by a network: {error}") from None
        found.raise_any()

    def varied(self, **fields: Any) -> Self:
        """Return the study with some fields in plain data in the place of its own.

        Raises
        ------
        ConfigError
            Naming the first field that does not fit.
        """
        data = {**self.to_data(), **fields}
        try:
            made = self.from_data(data, self._folder, self._positions, say=self._say)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = path_text(first["loc"])
            raise ConfigError(f"{self._positions.file}: {place} {first['msg']}") from None
        made._made = self._made
        return made

    def _built(self, arms: Mapping[str, ArmTables]) -> dict[str, Curriculum]:
        found, curricula = Problems(self._positions), {}
        for arm, tables in arms.items():
            refuse = partial(found.at, arm)
            builder = CurriculumBuilder(tables, self.folder, self._made, refuse, self._say)
            curricula[arm] = builder.curriculum()
        found.raise_any()
        return {arm: made for arm, made in curricula.items() if made is not None}
