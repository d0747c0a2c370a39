"""Sweeps and tunings in a study file, and the arms that they make."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from math import prod
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from curricle.checks import unfit_name
from curricle.curriculum.node import OF_TARGETS
from curricle.learning.seeds import MOST_SEEDS
from curricle.statistics.curves import SCRATCH
from curricle.study.config.merging import (
    SETTINGS,
    Raw,
    complete_curriculum,
    complete_learners,
    dotted,
    merged,
    path_text,
)
from curricle.study.config.tables import (
    Count,
    Flag,
    KeyPath,
    NameGraph,
    Table,
    Whole,
    seeds_of,
    shown,
    table,
    unknown,
    whole_number,
    wrong,
    wrong_at,
)
from curricle.text import counted

# -- Settings of a study that vary: which they are, and where in the curriculum of an arm they stand
#
# A sweep lists their values, a tuning says between which they are searched. Both name a setting by
# its key in the file, such as ``learner.learning_rate``.

FREE = ("learner", "storage", *OF_TARGETS)
"""Settings of the target in which arms may differ."""
RANGE = {"low", "high"}
"""Keys that tell a range from a table with further keys."""


class Varied(NamedTuple):
    """A setting that varies."""

    key: tuple[str, ...]
    """Its key in a study file."""
    home: KeyPath
    """Where the file says how it varies."""
    given: Any
    """What it says there."""

    @property
    def name(self) -> str:
        """The key as text."""
        return path_text(self.key)


def varied_in(tables: Any, home: KeyPath) -> Iterator[Varied]:
    """Yield the settings a table at `home` names, by tables in it or by dotted keys in quotes."""
    for name, value in table(tables).items():
        first = dotted(name) if "." in name else ()
        yield from _inside(first or (name,), (*home, name), value)


def _inside(key: tuple[str, ...], home: KeyPath, value: Any) -> Iterator[Varied]:
    if isinstance(value, dict) and not RANGE & value.keys():
        for name, inner in value.items():
            yield from _inside((*key, name), (*home, name), inner)
    else:
        yield Varied(key, home, value)


def short_names(keys: Sequence[Varied]) -> dict[str, str]:
    """Return the name of each setting as names of arms have it.

    It is the last word of the key where no other setting has that, with the task's name before it.
    """
    shorter = {
        one.name: (*one.key[1:2], one.key[-1]) if one.key[0] == "tasks" else one.key[-1:]
        for one in keys
        if one.key[0] != "transfers"
    }
    taken = [*shorter.values()]
    return {
        one.name: path_text(shorter[one.name])
        if one.name in shorter and taken.count(shorter[one.name]) == 1
        else one.name
        for one in keys
    }


def value_text(value: Any) -> str:
    """Return a value as names of arms and tables have it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}={value_text(one)}' for key, one in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    return str(value)


def places_of(study: Raw, patch: Raw, key: Sequence[str]) -> tuple[KeyPath, ...]:
    """Return where a setting stands in the complete curriculum of an arm; none if nowhere.

    A task or an arm that sets it itself keeps its own value, as everywhere in a study file.
    """
    mark = object()
    marked: Any = mark
    for part in reversed(key):
        marked = {part: marked}
    return tuple(_paths_to(mark, complete_curriculum(merged(study, marked), patch)))


def _paths_to(mark: object, node: Any, path: KeyPath = ()) -> Iterator[KeyPath]:
    if node is mark:
        yield path
    elif isinstance(node, dict | list):
        for part, inner in node.items() if isinstance(node, dict) else enumerate(node):
            yield from _paths_to(mark, inner, (*path, part))


def with_values(curriculum: Raw, values: Mapping[KeyPath, Any]) -> Raw:
    """Return a complete curriculum with values at some places."""
    for place, value in values.items():
        patch: Any = value
        for part in reversed(place):
            patch = {str(part): patch}
        curriculum = merged(curriculum, patch)
    return curriculum


def target_alone(curriculum: Raw) -> Raw:
    """Return a complete curriculum without its sources and what applies to targets alone."""
    graph = NameGraph.of(curriculum)
    (target,) = graph.targets
    tasks = {name: dict(curriculum["tasks"][name]) for name in reversed(graph.drawings(target))}
    for which in OF_TARGETS:
        tasks[target].pop(which, None)
    return {"tasks": tasks, "transfers": []}


def wrong_key(study: Raw, complete: Mapping[str, Raw], one: Varied) -> str:
    """Return why a setting cannot vary; empty if it can."""
    first, *others = one.key
    if first not in ("tasks", "transfers", *SETTINGS):
        known = ("tasks", "transfers", *SETTINGS)
        return f"must name a setting of tasks or transfers: {first} {unknown(first, known)}"
    if first in ("tasks", "transfers"):
        there = study.get(first)
        names = list(map(str, range(len(there)))) if isinstance(there, list) else [*table(there)]
        if others and others[0] not in names:
            return f"must name a key of one of the {first}: {others[0]} {unknown(others[0], names)}"
        if len(others) < 2:
            which = others[0] if others else next(iter(names), "NAME")
            key = "budget" if first == "tasks" else "scale"
            return f"must name a key of one of the {first}, such as {first}.{which}.{key}"
    patches = table(study.get("arms"))
    places = [
        (arm, place)
        for arm in complete
        for place in places_of(study, table(patches.get(arm)), one.key)
    ]
    if not places:
        return "changes nothing: each task or arm that it could apply to sets it itself"
    for arm, place in places:
        graph = NameGraph.of(complete[arm])
        drawn = {part for target in graph.targets for part in graph.drawings(target)}
        if place[0] == "tasks" and place[1] in drawn and place[2] not in FREE:
            return (
                f"must leave the target {graph.targets[0]} as it is, since all arms are compared "
                "in it: run the study once for each value, with --set"
            )
    return ""


# -- Sweeps: the arms that lists of settings make --------------------------------------------------

MOST_ARMS = 100
"""Arms that a sweep makes at most: with more no difference that matters would be shown."""
MODE, PAIRED = "mode", "paired"
SWEEP_HOME = ("sweep",)


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
    return [*varied_in(lists, SWEEP_HOME)]


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
        wrong.append((SWEEP_HOME, "must name a setting to sweep: got none"))
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
        yield SWEEP_HOME, f"must make at most {MOST_ARMS} arms: got {words}{each}, {number:,} arms"


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


# -- Tuning: what is searched for every arm, and where that stands in its curriculum ---------------

FIRST_SEED = 1_000_000
"""Of the seeds for tuning, where the file says how many: studies have other ones."""
MOST_TRIALS = 1_000
TUNE_HOME = ("tune", "space")


def _tuning_seeds(value: Any) -> tuple[int, ...]:
    if type(value) is int and 0 < value <= MOST_SEEDS:
        return tuple(range(FIRST_SEED, FIRST_SEED + value))
    return seeds_of(value)


def _bound(value: Any) -> int | float:
    """Return a finite number; whole ones stay whole."""
    if isinstance(value, bool) or not isinstance(value, int | float) or value - value != 0:
        raise wrong(f"must be a finite number: got {shown(value)}")
    return whole_number(value) if isinstance(value, int) else value


Bound = Annotated[int | float, BeforeValidator(_bound)]


class RangeTable(Table):
    """Numbers from `low` to `high`: whole ones if both are."""

    low: Bound = Field(description="The smallest value.")
    high: Bound = Field(description="The largest value.")
    log: Flag = Field(default=False, description="Whether equal ratios are equally likely.")

    @property
    def whole(self) -> bool:
        """Whether its numbers are whole."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.low < self.high:
            raise wrong_at((("high",), f"must be above low, {self.low}: got {self.high}"))
        if self.log and self.low <= 0:
            raise wrong_at((("low",), f"must be above 0 in a logarithmic range: got {self.low}"))
        return self


class TuneTable(Table):
    """How settings are searched for every arm before it is run."""

    trials: Annotated[Count, Field(le=MOST_TRIALS)] = Field(
        default=20, description="Settings that are tried for each arm, learning from scratch too."
    )
    seeds: Annotated[
        tuple[int, ...],
        BeforeValidator(_tuning_seeds, json_schema_input_type=int | str | list[int]),
    ] = Field(
        default=tuple(range(FIRST_SEED, FIRST_SEED + 3)),
        description="Seeds of each trial: how many, a list, or ranges; none of the study's.",
    )
    seed: Whole = Field(default=0, ge=0, description="Of the search: the same seed, one outcome.")
    space: dict[str, Any] = Field(
        description="What is searched, by its keys in the file: lists of values, or tables with "
        "low, high and perhaps log = true."
    )


class Tuning(TuneTable):
    """A tuning of which nothing is left to fill in."""

    space: dict[str, RangeTable | tuple[Any, ...]]
    places: dict[str, dict[str, tuple[KeyPath, ...]]]
    """Arm -> name of a setting -> where it stands in the arm's curriculum; none if nowhere."""

    def placed(self, arm: str, values: Mapping[str, Any]) -> dict[KeyPath, Any]:
        """Return the values of an arm's settings by their places in its curriculum."""
        places = self.places[arm]
        return {place: value for name, value in values.items() for place in places[name]}

    def keys(self, arm: str) -> tuple[str, ...]:
        """Return the names of the settings that an arm has."""
        return tuple(name for name, places in self.places[arm].items() if places)


def tuned_in(study: Raw) -> list[Varied]:
    """Return the settings that a study tunes."""
    return [*varied_in(table(study.get("tune")).get("space"), TUNE_HOME)]


def wrong_tuning(study: Raw, complete: Mapping[str, Raw]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the space of a study's tuning, each with its key path."""
    keys = tuned_in(study)
    if not keys and isinstance(table(study.get("tune")).get("space"), dict):
        yield TUNE_HOME, "must name a setting to tune: got none"
    if "tune" in study and study.get("scratch") is False:
        yield (
            ("tune",),
            "needs learning from scratch, which is tuned as every arm: leave out scratch = false",
        )
    names, swept = [one.name for one in keys], {one.name for one in swept_in(study)}
    for number, one in enumerate(keys):
        if one.name in names[:number]:
            yield one.home, "is given twice"
        elif one.name in swept:
            yield one.home, "is swept already: leave out one of the two"
        elif wrong := [*_wrong_space(one)]:
            yield from wrong
        elif why := wrong_key(study, complete, one):
            yield one.home, why


def _wrong_space(one: Varied) -> Iterator[tuple[KeyPath, str]]:
    if isinstance(one.given, dict):
        try:
            RangeTable.model_validate(one.given)
        except ValidationError as error:
            yield from (((*one.home, *e["loc"]), e["msg"]) for e in error.errors(include_url=False))
        return
    texts = list(map(value_text, one.given)) if isinstance(one.given, list) else []
    if len(texts) < 2 or len(set(texts)) < len(texts):
        text = "must be a list of two or more different values, or { low, high }: got "
        yield one.home, text + shown(one.given)


def ends_of(space: Any) -> tuple[Any, ...]:
    """Return the values of a setting that tell whether all of them are allowed."""
    return (space.low, space.high) if isinstance(space, RangeTable) else tuple(space)


def places_of_tuning(
    study: Raw, variants: Mapping[str, Variant], scratches: Mapping[str, Variant]
) -> dict[str, dict[str, tuple[KeyPath, ...]]]:
    """Return where each tuned setting stands in the curriculum of each arm, from scratch too."""
    patches, keys = table(study.get("arms")), tuned_in(study)
    found = {
        name: {one.name: places_of(study, table(patches.get(own.arm)), one.key) for one in keys}
        for name, own in variants.items()
    }
    first = table(patches.get(next(iter(variants.values())).arm))
    learners = table(study.get("scratch_learners"))
    for name, own in scratches.items():
        given = learners.get(own.arm.removeprefix(f"{SCRATCH}, ")) if own.arm != SCRATCH else {}
        found[name] = {
            one.name: tuple(
                place
                for place in places_from_scratch(study, first, one, own.curriculum)
                if not _sets(given, place[3:])
            )
            for one in keys
        }
    return found


def _sets(learner: Any, path: KeyPath) -> bool:
    """Return whether a further learner from scratch sets a key itself."""
    for part in path:
        if not isinstance(learner, dict) or part not in learner:
            return False
        learner = learner[part]
    return bool(path)


# -- The arms of a study whose settings vary, by a sweep or a tuning, in plain data ----------------

Homes = dict[str, tuple[str, Mapping[KeyPath, KeyPath]]]
"""As :attr:`Positions.varied`."""


class VariedArms(NamedTuple):
    """What a sweep and a tuning make of a study."""

    fields: dict[str, Any]
    """Of the configuration."""
    probes: dict[str, Raw]
    """Arms with the ends of each range that is tuned, to be checked beforehand."""
    homes: Homes


def varied_arms(study: Raw, complete: Mapping[str, Raw]) -> VariedArms:
    """Return the arms of a study that sweeps or tunes settings.

    Nothing is wrong with its sweep and its tuning; `complete` are the curricula of its arms without
    them.
    """
    variants, scratches = variants_of(study, complete), scratch_variants(study, complete)
    each, first = {**scratches, **variants}, next(iter(complete))
    fields: dict[str, Any] = {
        "arms": {name: one.curriculum for name, one in variants.items()},
        "scratches": {name: one.curriculum for name, one in scratches.items()},
        "variants": {name: {"arm": one.arm, "values": one.values} for name, one in each.items()},
    }
    homes: Homes = {
        name: (first if name in scratches else one.arm, one.homes) for name, one in each.items()
    }
    probes = dict[str, Raw]()
    if "tune" in study:
        tune = TuneTable.model_validate(study["tune"])
        places = places_of_tuning(study, variants, scratches)
        space = {one.name: one.given for one in tuned_in(study)}
        fields["tune"] = {**tune.model_dump(), "space": space, "places": places}
        for name, curriculum, where in _probes(study, each, places):
            probes[name], homes[name] = curriculum, (first, where)
    return VariedArms(fields, probes, homes)


def _probes(
    study: Raw,
    variants: Mapping[str, Variant],
    places: Mapping[str, Mapping[str, tuple[KeyPath, ...]]],
) -> Iterator[tuple[str, Raw, dict[KeyPath, KeyPath]]]:
    """Yield an arm for each end of each tuned setting, and where the file has that."""
    for one in tuned_in(study):
        arm = next(arm for arm in places if places[arm][one.name])
        here = places[arm][one.name]
        for value in _some(one.given):
            given = with_values(variants[arm].curriculum, dict.fromkeys(here, value))
            yield f"{one.name} = {value_text(value)}", given, dict.fromkeys(here, one.home)


def _some(space: Any) -> Sequence[Any]:
    """Return the values of a setting that are checked: those listed, or ends and one between.

    That one is no whole number unless all are, which some settings refuse.
    """
    if not isinstance(space, dict):
        return tuple(space)
    low, high = space["low"], space["high"]
    whole = isinstance(low, int) and isinstance(high, int)
    return (low, high) if whole else (low, high, low + (high - low) / 3**0.5)


def wrong_made(variants: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Yield what is wrong with the names of the arms that a sweep makes."""
    for name in variants:
        if why := unfit_name(name):
            yield SWEEP_HOME, f"makes an arm with a name that {why}"
