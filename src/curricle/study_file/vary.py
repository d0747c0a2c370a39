"""Settings of a study that vary: a sweep lists their values, a tuning searches them.

Both name a setting by its key in the file, such as ``learner.learning_rate``. Its values are put at
this key before arms and settings are merged, so that a value acts as if the file had it. To find
its places in an arm's complete curriculum, a mark is merged in place of a value.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from math import prod
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from curricle.curriculum.node import OF_TARGETS
from curricle.learning.seeds import MOST_SEEDS
from curricle.statistics.curves import SCRATCH
from curricle.study_file.file import (
    SETTINGS,
    Located,
    complete_curriculum,
    complete_learners,
    dotted,
    merged,
    nested,
    path_text,
)
from curricle.study_file.schema import (
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

Raw = Mapping[str, Any]
Messages = Iterator[tuple[KeyPath, str]]  # what is wrong, each with its key path

# -- The tables of a file --------------------------------------------------------------------------

MODE, PAIRED = "mode", "paired"
FIRST_SEED = 1_000_000  # for tuning, where the file says how many; studies have other seeds
MOST_TRIALS = 1_000


class SweepTable(Table):
    """Lists of settings, by their keys in the file: each value makes an arm of every arm."""

    model_config = ConfigDict(extra="allow")

    mode: Literal["grid", "paired"] = "grid"
    """Every combination of the values; or the first of each list, the second of each, and so on."""


def _tuning_seeds(value: Any) -> tuple[int, ...]:
    few = type(value) is int and 0 < value <= MOST_SEEDS
    return tuple(range(FIRST_SEED, FIRST_SEED + value)) if few else seeds_of(value)


def _bound(value: Any) -> int | float:  # whole ones stay whole
    if isinstance(value, bool) or not isinstance(value, int | float) or value - value != 0:
        raise wrong(f"must be a finite number: got {shown(value)}")
    return whole_number(value) if isinstance(value, int) else value


Bound = Annotated[int | float, BeforeValidator(_bound)]


class RangeTable(Table):
    """Numbers from `low` to `high`: whole ones if both are."""

    low: Bound
    """The smallest value."""
    high: Bound
    """The largest value."""
    log: Flag = False
    """Whether equal ratios are equally likely."""

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

    trials: Annotated[Count, Field(le=MOST_TRIALS)] = 20
    """Settings that are tried for each arm, learning from scratch too."""
    seeds: Annotated[
        tuple[int, ...],
        BeforeValidator(_tuning_seeds, json_schema_input_type=int | str | list[int]),
    ] = tuple(range(FIRST_SEED, FIRST_SEED + 3))
    """Seeds of each trial: how many, a list, or ranges; none of the study's."""
    seed: Whole = Field(default=0, ge=0)
    """Seed of the search; equal seeds give equal searches."""
    space: dict[str, Any]
    """What is searched, by its keys in the file: lists of values, or tables with low, high and
    perhaps log = true."""


class Tuning(TuneTable):
    """A complete tuning."""

    space: dict[str, RangeTable | tuple[Any, ...]]
    places: dict[str, dict[str, tuple[KeyPath, ...]]]
    """Arm -> name of a setting -> where it stands in the arm's curriculum; none if nowhere."""

    def placed(self, arm: str, values: Raw) -> dict[KeyPath, Any]:
        """Return the values of an arm's settings by their places in its curriculum."""
        places = self.places[arm]
        return {place: value for name, value in values.items() for place in places[name]}

    def keys(self, arm: str) -> tuple[str, ...]:
        """Return the names of the settings that an arm has."""
        return tuple(name for name, places in self.places[arm].items() if places)


# -- Settings that vary, and where they stand in the curriculum of an arm --------------------------

FREE = ("learner", "storage", *OF_TARGETS)  # settings of the target in which arms may differ
RANGE = {"low", "high"}  # keys that tell a range from a table with further keys
SWEEP_HOME, TUNE_HOME = ("sweep",), ("tune", "space")


class Varied(NamedTuple):
    """A setting that varies."""

    key: tuple[str, ...]  # its key in a study file
    home: KeyPath  # where the file says how it varies
    values: Any  # what it says there

    @property
    def name(self) -> str:
        """The key as text."""
        return path_text(self.key)


def varied_in(tables: Any, home: KeyPath, key: tuple[str, ...] = ()) -> Iterator[Varied]:
    """Yield the settings that a table at `home` names, by nested tables or quoted dotted keys."""
    for name, value in table(tables).items():
        inner = (*key, *((dotted(name) if "." in name and not key else ()) or (name,)))
        if isinstance(value, dict) and not RANGE & value.keys():
            yield from varied_in(value, (*home, name), inner)
        else:
            yield Varied(inner, (*home, name), value)


def swept_in(study: Raw) -> list[Varied]:
    """Return the settings that a study sweeps."""
    lists = {key: values for key, values in table(study.get("sweep")).items() if key != MODE}
    return [*varied_in(lists, SWEEP_HOME)]


def tuned_in(study: Raw) -> list[Varied]:
    """Return the settings that a study tunes."""
    return [*varied_in(table(study.get("tune")).get("space"), TUNE_HOME)]


def short_names(settings: Sequence[Varied]) -> dict[str, str]:
    """Return the name of each setting in names of arms: its last word if that is unique."""
    shorter = {
        setting.name: (*setting.key[1:2], setting.key[-1])
        if setting.key[0] == "tasks"
        else setting.key[-1:]
        for setting in settings
        if setting.key[0] != "transfers"
    }
    taken = [*shorter.values()]
    alone = {name: short for name, short in shorter.items() if taken.count(short) == 1}
    return {s.name: path_text(alone[s.name]) if s.name in alone else s.name for s in settings}


def value_text(value: Any) -> str:
    """Return a value as text for names of arms and tables."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}={value_text(inner)}' for key, inner in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    return str(value)


def places_of(study: Raw, patch: Any, setting: Varied) -> tuple[KeyPath, ...]:
    """Return a setting's paths in the curriculum of an arm that does not set it itself."""
    mark = object()

    def paths_to(node: Any, path: KeyPath = ()) -> Iterator[KeyPath]:
        if node is mark:
            yield path
        elif isinstance(node, dict | list):
            for part, inner in node.items() if isinstance(node, dict) else enumerate(node):
                yield from paths_to(inner, (*path, part))

    return tuple(paths_to(complete_curriculum(merged(study, nested(setting.key, mark)), patch)))


def stating(study: Raw, setting: Varied, value: Any) -> Located:
    """Return a study with a value of a setting, located where the setting varies."""
    # So do tables that have it in them, but for tasks and transfers as a whole.
    whole = 0 if setting.key[0] in SETTINGS else 2 if setting.key[2] in SETTINGS else 1
    patch = value
    for n, part in reversed([*enumerate(setting.key)]):
        patch = Located({part: patch})
        patch.home = setting.home if n > whole else ()
        patch.homes = {part: setting.home} if n >= whole else {}
    return merged(study, patch)


def with_values(curriculum: Raw, values: Mapping[KeyPath, Any]) -> dict[str, Any]:
    """Return a complete curriculum with values at some places."""
    result: dict[str, Any] = Located(curriculum, curriculum)
    for place, value in values.items():
        result = merged(result, nested(map(str, place), value))
    return result


def target_alone(curriculum: Raw) -> dict[str, Any]:
    """Return a complete curriculum without its sources and the settings for targets alone."""
    tasks, graph = curriculum["tasks"], NameGraph.of(dict(curriculum))
    (target,) = graph.targets
    kept = {name: tasks[name] for name in reversed(graph.drawings(target))}
    lasting = {key: value for key, value in tasks[target].items() if key not in OF_TARGETS}
    kept[target] = Located(lasting, tasks[target])
    return Located({"tasks": Located(kept, tasks), "transfers": []}, curriculum)


# -- The arms that they make -----------------------------------------------------------------------

MOST_ARMS = 100  # that a sweep makes: with more no difference that matters would show


class Variant(NamedTuple):
    """An arm with values for the settings that vary."""

    arm: str  # as the file calls it
    values: dict[str, Any]  # by name of the setting
    study: Raw  # which says these values
    curriculum: dict[str, Any]


def varied_arms(study: Raw, complete: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a configuration's fields with sweep and tuning, and arms that probe ends of ranges."""
    variants, patches = dict[str, Variant](), table(study.get("arms"))
    for arm in complete:
        variants |= _variants(study, arm, patches.get(arm))
    scratches = scratch_variants(study, complete)
    every = {**scratches, **variants}
    fields: dict[str, Any] = {
        "arms": {name: variant.curriculum for name, variant in variants.items()},
        "scratches": {name: variant.curriculum for name, variant in scratches.items()},
        "variants": {
            name: {"arm": variant.arm, "values": variant.values} for name, variant in every.items()
        },
    }
    probes = dict[str, Any]()
    if "tune" in study:
        tuned = _places_of_tuning(study, variants, scratches)
        space = {setting.name: setting.values for setting in tuned_in(study)}
        plain = TuneTable.model_validate(study["tune"]).model_dump()
        fields["tune"] = {**plain, "space": space, "places": tuned}
        for setting in tuned_in(study):
            variant = next(of for name, of in variants.items() if tuned[name][setting.name])
            values = setting.values
            if isinstance(values, dict):
                ends = values["low"], values["high"]
                # A number between them is no whole number, which some settings refuse.
                between = ends[0] + (ends[1] - ends[0]) / 3**0.5
                values = ends if all(isinstance(end, int) for end in ends) else (*ends, between)
            for value in values:
                probing = stating(variant.study, setting, value)
                probe = complete_curriculum(probing, patches.get(variant.arm))
                probes[f"{setting.name} = {value_text(value)}"] = probe
    return fields, probes


def _variants(study: Raw, arm: str, patch: Any, *, alone: bool = False) -> dict[str, Variant]:
    """Return an arm for each point of a sweep that differs for it, or its target alone, by name."""
    settings, variants = swept_in(study), dict[str, Variant]()
    short, lists = short_names(settings), [setting.values for setting in settings]
    paired = lists and study["sweep"].get(MODE) == PAIRED
    apply = {s.name: bool(_places(study, patch, s, alone=alone)) for s in settings}
    for point in zip(*lists, strict=True) if paired else product(*lists):
        pairs = [(s, value) for s, value in zip(settings, point, strict=True) if apply[s.name]]
        label = ", ".join([arm, *(f"{short[s.name]}={value_text(value)}" for s, value in pairs)])
        if label in variants:  # the values that differ do not apply to the arm
            continue
        stated = study
        for setting, value in pairs:
            stated = stating(stated, setting, value)
        curriculum = complete_curriculum(stated, patch)
        values = {setting.name: value for setting, value in pairs}
        whole = target_alone(curriculum) if alone else curriculum
        variants[label] = Variant(arm, values, stated, whole)
    return variants


def scratch_variants(study: Raw, complete: Mapping[str, Any]) -> dict[str, Variant]:
    """Return the arms from scratch, for each value that applies; the first is "scratch"."""
    if study.get("scratch") is False:
        return {}
    patch = table(study.get("arms")).get(next(iter(complete)))
    first, *later = _variants(study, SCRATCH, patch, alone=True).items()
    variants = {SCRATCH: first[1], **dict(later)}
    for learner in table(study.get("scratch_learners")):
        label = f"{SCRATCH}, {learner}"
        for name, variant in [*variants.items()]:
            if variant.arm != SCRATCH:
                continue
            plan, tasks = variant.curriculum, variant.curriculum["tasks"]
            *_, target = tasks
            task = {**tasks[target], "learner": complete_learners(study, plan)[learner]}
            changed = Located({**tasks, target: Located(task, tasks[target])}, tasks)
            plan = Located({**plan, "tasks": changed}, plan)
            if all(other.curriculum != plan for other in variants.values()):
                made = variant._replace(arm=label, curriculum=plan)
                variants[label + name.removeprefix(SCRATCH)] = made
    return variants


def _places(
    study: Raw, patch: Any, setting: Varied, *, alone: bool, sets: Any = None
) -> tuple[KeyPath, ...]:
    """Return a setting's paths in an arm; with `alone` in its target's learner and storage.

    `sets` holds the settings that a further learner from scratch sets itself.
    """
    places = places_of(study, patch, setting)
    if not alone:
        return places
    (target,) = NameGraph.of(complete_curriculum(study, patch)).targets

    def is_free(place: KeyPath) -> bool:
        node: Any = sets
        for part in place[3:]:
            node = table(node).get(str(part))
        return (
            place[:2] == ("tasks", target) and place[2] in ("learner", "storage") and node is None
        )

    return tuple(filter(is_free, places))


def _places_of_tuning(
    study: Raw, variants: Mapping[str, Variant], scratches: Mapping[str, Variant]
) -> dict[str, dict[str, tuple[KeyPath, ...]]]:
    """Return each tuned setting's paths in the curriculum of each arm, scratch included."""
    patches, learners = table(study.get("arms")), table(study.get("scratch_learners"))
    first = patches.get(next(iter(variants.values())).arm)
    places = dict[str, dict[str, tuple[KeyPath, ...]]]()
    for name, variant in {**variants, **scratches}.items():
        alone = name in scratches
        patch = first if alone else patches.get(variant.arm)
        sets = learners.get(variant.arm.removeprefix(f"{SCRATCH}, ")) if alone else None
        places[name] = {
            s.name: _places(study, patch, s, alone=alone, sets=sets) for s in tuned_in(study)
        }
    return places


# -- What is wrong with them -----------------------------------------------------------------------


def wrong_sweep(study: Raw, complete: Mapping[str, Any]) -> Messages:
    """Yield the mistakes in a study's sweep; `complete` has the arms' curricula without it."""
    settings = swept_in(study)
    if not settings and isinstance(study.get("sweep"), dict):
        yield SWEEP_HOME, "must name a setting to sweep: got none"
    names, refused = [setting.name for setting in settings], False
    for number, setting in enumerate(settings):
        texts = list(map(value_text, setting.values)) if isinstance(setting.values, list) else []
        if not texts:
            why = f"must be a list of one or more values: got {shown(setting.values)}"
        elif twice := [text for n, text in enumerate(texts) if text in texts[:n]]:
            why = f"must be a list of different values: {twice[0]} is there twice"
        else:
            why = _wrong_key(study, complete, setting)
        if why := why or "is given twice" * (setting.name in names[:number]):
            refused = True
            yield setting.home, why
    if not settings or refused:
        return
    lengths = [len(setting.values) for setting in settings]
    number, values = prod(lengths), f"{' x '.join(map(str, lengths))} values"
    if study["sweep"].get(MODE) == PAIRED:
        number, values = lengths[0], counted(lengths[0], "value")
        text = f"must have as many values as {path_text(settings[0].home)}, with which it is paired"
        for setting, length in zip(settings, lengths, strict=True):
            if length != number:
                yield setting.home, f"{text}: got {length} and {number}"
    if number * len(complete) > MOST_ARMS:
        arms = f" of each of {len(complete)} arms" if len(complete) > 1 else ""
        made = f"{number * len(complete):,} arms"
        yield SWEEP_HOME, f"must make at most {MOST_ARMS} arms: got {values}{arms}, {made}"


def wrong_tuning(study: Raw, complete: Mapping[str, Any]) -> Messages:
    """Yield the mistakes in the space of a study's tuning."""
    settings = tuned_in(study)
    if not settings and isinstance(table(study.get("tune")).get("space"), dict):
        yield TUNE_HOME, "must name a setting to tune: got none"
    if "tune" in study and study.get("scratch") is False:
        text = "needs learning from scratch, which is tuned as every arm: leave out scratch = false"
        yield ("tune",), text
    names, swept = [s.name for s in settings], {s.name for s in swept_in(study)}
    for number, setting in enumerate(settings):
        values, why = setting.values, ""
        if setting.name in names[:number]:
            why = "is given twice"
        elif setting.name in swept:
            why = "is swept already: leave out one of the two"
        elif isinstance(values, dict):
            try:
                RangeTable.model_validate(values)
            except ValidationError as error:
                details = error.errors(include_url=False)
                yield from (((*setting.home, *of["loc"]), of["msg"]) for of in details)
                continue
        else:
            texts = [*map(value_text, values)] if isinstance(values, list) else []
            if len({*texts}) < max(2, len(texts)):
                why = "must be a list of two or more different values, or { low, high }: got "
                why += shown(values)
        if why := why or _wrong_key(study, complete, setting):
            yield setting.home, why


def _wrong_key(study: Raw, complete: Mapping[str, Any], setting: Varied) -> str:
    """Return why a setting cannot vary; empty if it can."""
    first, *parts = setting.key
    if first not in (known := ("tasks", "transfers", *SETTINGS)):
        return f"must name a setting of tasks or transfers: {first} {unknown(first, known)}"
    if first in ("tasks", "transfers"):
        there = study.get(first)
        names = list(map(str, range(len(there)))) if isinstance(there, list) else [*table(there)]
        if parts and parts[0] not in names:
            return f"must name a key of one of the {first}: {parts[0]} {unknown(parts[0], names)}"
        if len(parts) < 2:
            which = parts[0] if parts else next(iter(names), "NAME")
            key = "budget" if first == "tasks" else "scale"
            return f"must name a key of one of the {first}, such as {first}.{which}.{key}"
    patches, nowhere = table(study.get("arms")), True
    for arm, curriculum in complete.items():
        graph = NameGraph.of(curriculum)
        drawn = {part for target in graph.targets for part in graph.drawings(target)}
        for place in places_of(study, patches.get(arm), setting):
            nowhere = False
            if place[0] == "tasks" and place[1] in drawn and place[2] not in FREE:
                return (
                    f"must leave the target {graph.targets[0]} as it is, since all arms are "
                    "compared in it: run the study once for each value, with --set"
                )
    text = "changes nothing: each task or arm that it could apply to sets it itself"
    return text if nowhere else ""
