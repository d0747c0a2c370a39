"""A study that has been read: its document, and the curricula that it describes."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from curricle.errors import ConfigError
from curricle.study.config.document import Document
from curricle.study.config.positions import Places, Problems
from curricle.study.config.tables import Place, unknown

if TYPE_CHECKING:
    from curricle.curriculum.curriculum import Curriculum


@dataclass(frozen=True, eq=False)
class StudyFile:
    """A study read from a file (:func:`read_study`) or from what :meth:`StudyFile.resolved` gave.

    Parameters
    ----------
    document : Document
        All there is to know, but for the modules of the study's own functions.
    folder : Path
        Where these are.
    places : Places
        Where in the file things are, for messages.

    Examples
    --------
    >>> study = StudyFile.rebuilt(
    ...     {"name": "line", "arms": {"transfer": {
    ...         "tasks": {"line": {"type": "maze", "map": "S..T"}}}}}, Path())
    >>> study.curriculum("transfer").target
    'line'
    """

    document: Document
    folder: Path
    places: Places
    _made: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def rebuilt(cls, resolved: Mapping[str, Any], folder: Path) -> "StudyFile":
        """Return the study that :meth:`resolved` was called on, in another process if need be."""
        document = Document.model_validate(dict(resolved))
        return cls(document, folder, Places(document.name, resolved))

    def resolved(self) -> dict[str, Any]:
        """Return the document as plain data, which JSON can hold.

        Maps are in it, every arm is complete and every setting said, so that equal data mean equal
        results, as long as the study's own functions stay the same.
        """
        return self.document.model_dump(mode="json", exclude_none=True)

    @cached_property
    def arms(self) -> dict[str, "Curriculum"]:
        """The curricula that are compared, by name.

        Raises
        ------
        ConfigError
            Naming all that cannot be built.
        """
        return self._built(*self.document.arms)

    def curriculum(self, arm: str) -> "Curriculum":
        """Return the curriculum of one arm.

        Raises
        ------
        ConfigError
            When there is no such arm, or naming all in it that cannot be built.
        """
        if arm not in self.document.arms:
            raise ConfigError(f"{self.places.file}: arm {arm!r} {unknown(arm, self.document.arms)}")
        return self._built(arm)[arm]

    def check_networks(self) -> None:
        """Check what Stable-Baselines3 says of the learners that are networks.

        Raises
        ------
        ImportError
            When there is such a learner, and Stable-Baselines3 is not installed.
        ConfigError
            Naming each algorithm, setting and way into learning that it does not have.
        """
        from curricle.deep.learner import DeepLearner

        found = Problems()
        for arm, curriculum in self.arms.items():
            for name in curriculum.order:
                learner, shaping = (curriculum.setting(s, name) for s in ("learner", "shaping"))
                if not isinstance(learner, DeepLearner):
                    continue
                place = self.places.written(arm, ("tasks", name, "learner"))
                with found.at(self.places, place):
                    learner.algorithm_class()  # says how to install what is missing
                    from curricle.deep.models import check_learner

                    check_learner(learner, shaping if curriculum.in_edges(name) else None)
        found.tell()

    def _built(self, *arms: str) -> dict[str, "Curriculum"]:
        from curricle.study.config.building import build

        found, curricula = Problems(), {}
        for arm in arms:

            def refuse(place: Place, arm: str = arm) -> AbstractContextManager[None]:
                return found.at(self.places, self.places.written(arm, place))

            built = build(self.document.arms[arm], self.folder, self._made, refuse)
            if built is not None:
                curricula[arm] = built
        found.tell()
        return curricula
