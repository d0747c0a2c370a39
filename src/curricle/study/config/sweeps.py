"""Sweeps: the arms that lists of settings make."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from math import prod
from typing import Any, Literal, NamedTuple

from pydantic import ConfigDict, Field

from curricle.statistics.curves import SCRATCH
from curricle.study.config.merging import Raw, complete_learners
from curricle.study.config.positions import path_text
from curricle.study.config.tables import KeyPath, Table, shown
from curricle.study.config.task_names import table
from curricle.study.config.varied_settings import (
    Varied,
    places_of,
    short_names,
    target_alone,
    value_text,
    varied_in,
    with_values,
    wrong_key,
)
from curricle.text_tables import counted

MOST_ARMS = 100
"""Arms that a sweep makes at most: with more no difference that matters would be shown."""
MODE, PAIRED = "mode", "paired"
HOME = ("sweep",)


class SweepTable(Table):
    """Lists of settings, by their keys in the file: each value makes an arm of every arm."""

    model_config = ConfigDict(extra="allow")

    mode: Literal["grid", "paired"] = Field(
        default="grid",
        description="Every combination of the values; or the first of each list, the second of "
        "each, and so on.",
    )


class Variant(NamedTuple):
    """An arm with values for the settings that vary."""

    arm: str
    """As the file calls it."""
    values: dict[str, Any]
    """By name of the setting."""
    curriculum: Raw
    homes: dict[KeyPath, KeyPath]
    """Place in the curriculum -> where the file says how that varies."""


def swept_in(study: Raw) -> list[Varied]:
    """Return the settings that a study sweeps."""
    lists = {key: one for key, one in table(study.get("sweep")).items() if key != MODE}
    return [*varied_in(lists, HOME)]


def wrong_sweep(study: Raw, complete: Mapping[str, Raw]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with a study's sweep, each with its key path.

    The tables are taken to be tables; `complete` are the curricula of the arms without a sweep.
    """
    keys = swept_in(study)
    paired = table(study.get("sweep")).get(MODE) == PAIRED
    wrong = [(one.home, why) for one in keys if (why := _wrong_list(study, complete, one))]
    names = [one.name for one in keys]
    wrong += [(one.home, "is given twice") for n, one in enumerate(keys) if one.name in names[:n]]
    if not keys and isinstance(study.get("sweep"), dict):
        wrong.append((HOME, "must name a setting to sweep: got none"))
    yield from wrong
    if wrong or not keys:
        return
    lengths = [len(one.given) for one in keys]
    for one, length in zip(keys, lengths, strict=True):
        if paired and length != lengths[0]:
            yield (
                one.home,
                f"must have as many values as {path_text(keys[0].home)}, with which it is paired: "
                f"got {length} and {lengths[0]}",
            )
    number = len(complete) * (lengths[0] if paired else prod(lengths))
    if number > MOST_ARMS:
        words = (
            counted(lengths[0], "value") if paired else f"{' x '.join(map(str, lengths))} values"
        )
        each = f" of each of {len(complete)} arms" if len(complete) > 1 else ""
        yield HOME, f"must make at most {MOST_ARMS} arms: got {words}{each}, {number:,} arms"


def _wrong_list(study: Raw, complete: Mapping[str, Raw], one: Varied) -> str:
    if not isinstance(one.given, list) or not one.given:
        return f"must be a list of one or more values: got {shown(one.given)}"
    texts = [value_text(value) for value in one.given]
    if twice := next((text for n, text in enumerate(texts) if text in texts[:n]), None):
        return f"must be a list of different values: {twice} is there twice"
    return wrong_key(study, complete, one)


def variants_of(study: Raw, complete: Mapping[str, Raw]) -> dict[str, Variant]:
    """Return the arms that the sweep of a study makes; the arms themselves without a sweep.

    An arm that a setting does not apply to is there once for all its values.

    Examples
    --------
    >>> study = {"sweep": {"learner": {"epsilon": [0.1, 0.2]}}}
    >>> list(variants_of(study, {"long": {"tasks": {"maze": {}}}}))
    ['long']
    >>> study["tasks"] = {"maze": {}}
    >>> list(variants_of(study, {"long": {"tasks": {"maze": {}}}}))
    ['long, epsilon=0.1', 'long, epsilon=0.2']
    """
    keys, points = swept_in(study), points_of(study)
    short, found = short_names(keys), dict[str, Variant]()
    for arm, curriculum in complete.items():
        patch = table(table(study.get("arms")).get(arm))
        places = {one.name: places_of(study, patch, one.key) for one in keys}
        for point in points:
            name, made = _variant(arm, curriculum, keys, places, point, short)
            found.setdefault(name, made)
    return found


def points_of(study: Raw) -> list[tuple[Any, ...]]:
    """Return the combinations of values that a sweep tries, in the order of its keys."""
    lists = [one.given for one in swept_in(study)]
    if lists and study["sweep"].get(MODE) == PAIRED:
        return [*zip(*lists, strict=True)]
    return [*product(*lists)]


def _variant(
    arm: str,
    curriculum: Raw,
    keys: Sequence[Varied],
    places: Mapping[str, Sequence[KeyPath]],
    point: Sequence[Any],
    short: Mapping[str, str],
) -> tuple[str, Variant]:
    """Return an arm with the values of one point that apply to it, and its name."""
    own = [(one, value) for one, value in zip(keys, point, strict=True) if places[one.name]]
    values = {one.name: value for one, value in own}
    words = [f"{short[one.name]}={value_text(value)}" for one, value in own]
    given = {place: value for one, value in own for place in places[one.name]}
    homes = {place: one.home for one, _ in own for place in places[one.name]}
    made = Variant(arm, values, with_values(curriculum, given), homes)
    return ", ".join([arm, *words]), made


def scratch_variants(study: Raw, complete: Mapping[str, Raw]) -> dict[str, Variant]:
    """Return the arms that learn the target from scratch, for each value that applies to them.

    The first is called "scratch", whatever its values.
    """
    if study.get("scratch") is False:
        return {}
    arm, curriculum = next(iter(complete.items()))
    patch, keys = table(table(study.get("arms")).get(arm)), swept_in(study)
    alone, short = target_alone(curriculum), short_names(keys)
    places = {one.name: places_from_scratch(study, patch, one, alone) for one in keys}
    found = dict[str, Variant]()
    for point in points_of(study):
        name, own = _variant(SCRATCH, alone, keys, places, point, short)
        found.setdefault(name, own)
    first, *others = found
    found = {SCRATCH: found[first], **{name: found[name] for name in others}}
    for learner in table(study.get("scratch_learners")):
        for name, own in [*found.items()]:
            if own.arm == SCRATCH:
                label, made = _by_another(study, learner, name, own)
                if all(other.curriculum != made.curriculum for other in found.values()):
                    found[label] = made
    return found


def places_from_scratch(study: Raw, patch: Raw, one: Varied, alone: Raw) -> tuple[KeyPath, ...]:
    """Return where a setting stands in a curriculum of the target alone."""
    *_, target = alone["tasks"]
    return tuple(
        place
        for place in places_of(study, patch, one.key)
        if place[:2] == ("tasks", target) and place[2] in ("learner", "storage")
    )


def _by_another(study: Raw, learner: str, name: str, own: Variant) -> tuple[str, Variant]:
    """Return what another learner from scratch makes of an arm from scratch, and its name."""
    *_, target = own.curriculum["tasks"]
    given = complete_learners(study, own.curriculum)[learner]
    tasks = own.curriculum["tasks"]
    tasks = {**tasks, target: {**tasks[target], "learner": given}}
    label = f"{SCRATCH}, {learner}"
    made = own._replace(arm=label, curriculum={**own.curriculum, "tasks": tasks})
    return label + name.removeprefix(SCRATCH), made
