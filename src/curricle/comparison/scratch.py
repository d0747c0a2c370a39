"""Learning the target from scratch: by the curricula's own learner, and by stronger ones."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any

from curricle.checks import fit_name, instance
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.defaults import OF_TARGETS, SETTINGS
from curricle.errors import CurriculumError, SettingError
from curricle.statistics.curves import SCRATCH

GivenScratch = Sequence[Any] | Mapping[str, Any]


def from_scratch(curriculum: Curriculum, learner: Any = None) -> Curriculum:
    """Return a curriculum's target without its sources, with another learner if one is given.

    What applies to targets alone, such as the shaping, is left out.

    Examples
    --------
    >>> from curricle import GridWorld, SARSA
    >>> plan = from_scratch(Curriculum({"maze": GridWorld("S.T")}, budget=70), SARSA())
    >>> plan.setting("budget", "maze"), type(plan.setting("learner", "maze")).__name__
    (70, 'SARSA')
    """
    target = curriculum.target
    settings: dict[str, Any] = {
        which: {target: curriculum.setting(which, target)}
        for which in SETTINGS
        if which not in OF_TARGETS
    }
    if learner is not None:
        settings["learner"] = {target: learner}
    return Curriculum({target: curriculum.tasks[target]}, **settings)


def scratch_curricula(given: GivenScratch, first: Curriculum) -> dict[str, Curriculum]:
    """Return the arms of further learners from scratch by name, ``scratch, NAME``.

    Parameters
    ----------
    given : sequence of learners, or dict of str to learner
        In a sequence each is named after its settings.
    first : Curriculum
        Whose target they learn.

    Raises
    ------
    SettingError
        If two have one name, a name is not fit for an arm, or a learner does not fit the target or
        is its own.

    Examples
    --------
    >>> from curricle import GridWorld, QLearning
    >>> first = Curriculum({"maze": GridWorld("S.T")})
    >>> list(scratch_curricula([QLearning(initial_value=50.0)], first))
    ['scratch, QLearning(initial_value=50.0)']
    """
    if not isinstance(given, Mapping):
        instance("scratch, unless it names learners in a dict,", given, Sequence, SettingError)
    named = given.items() if isinstance(given, Mapping) else [(_name(one), one) for one in given]
    own, found = first.setting("learner", first.target), dict[str, Curriculum]()
    for name, learner in named:
        fit_name("a learner from scratch", name, SettingError)
        label = f"{SCRATCH}, {name}"
        if label in found:
            raise SettingError(f"learners from scratch must differ: {name} is there twice")
        if learner == own:
            raise SettingError(
                f"a further learner from scratch must differ from the target's own: {name} is "
                f"{own}, which learns from scratch anyway"
            )
        try:
            found[label] = from_scratch(first, learner)
        except (CurriculumError, SettingError) as error:
            raise SettingError(f"learner {name} from scratch: {error}") from None
    return found


def _name(learner: Any) -> str:
    """Return a learner as text, with the settings that are not the defaults of its class."""
    parts = []
    for one in fields(learner) if hasattr(learner, "__dataclass_fields__") else ():
        default = one.default_factory() if one.default_factory is not MISSING else one.default
        value = getattr(learner, one.name)
        if value != default:
            parts.append(f"{one.name}={value}")
    return type(learner).__name__ + f"({', '.join(parts)})" * bool(parts)
