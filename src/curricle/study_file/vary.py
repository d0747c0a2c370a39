"""Settings of a study that vary: a sweep lists values, a tuning tries points of ranges.

Both name a setting by its key in the file, such as ``learner.learning_rate``. A value is put at
this key before arms and settings are merged, so that it acts as if the file contained it. Each
point of a sweep makes an arm of every arm, and so does each trial of a tuning. To find the places
of a setting in an arm's complete curriculum, a mark is merged in place of a value.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from itertools import compress, product
from math import floor, prod
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from curricle.curriculum.curriculum import OF_TARGETS
from curricle.learning.seeds import MOST_SEEDS
from curricle.statistics.curves import SCRATCH
from curricle.study_file.file import (
    SETTINGS,
    complete_curriculum,
    complete_learners,
    dotted,
    merged,
    names_in,
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
Messages = Iterator[tuple[KeyPath, str]]  # key path and text of each mistake

# -- The tables of a file --------------------------------------------------------------------------

MODE, PAIRED = "mode", "paired"
FIRST_SEED = 1_000_000  # of tunings whose file states a number of seeds; studies' seeds are lower


class SweepTable(Table):
    """Lists of settings, by their keys in the file: each value makes an arm of every arm."""

    model_config = ConfigDict(extra="allow")

    mode: Literal["grid", "paired"] = "grid"
    """Every combination of the values; or the first values of all lists, the second ones, ..."""


def _tuning_seeds(value: object) -> tuple[int, ...]:
    if type(value) is int and 0 < value <= MOST_SEEDS:
        return tuple(range(FIRST_SEED, FIRST_SEED + value))
    return seeds_of(value)


def _bound(value: object) -> int | float:  # whole numbers stay whole
    if isinstance(value, bool) or not isinstance(value, int | float) or value - value != 0:
        raise wrong(f"must be a finite number: got {shown(value)}")
    return whole_number(value) if isinstance(value, int) else value


Bound = Annotated[int | float, BeforeValidator(_bound)]


class RangeTable(Table):
    """Numbers from `low` to `high`; whole numbers if both bounds are whole."""

    low: Bound
    """The smallest value."""
    high: Bound
    """The largest value."""
    log: Flag = False
    """Whether equal ratios are equally likely."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.low < self.high:
            raise wrong_at((("high",), f"must be above low, {self.low}: got {self.high}"))
        if self.log and self.low <= 0:
            raise wrong_at((("low",), f"must be above 0 in a logarithmic range: got {self.low}"))
        return self

    def at(self, share: float) -> int | float:
        """Return the number at this share, in [0, 1), of the way from low to high."""
        whole = isinstance(self.low, int) and isinstance(self.high, int)
        low, high = (self.low - 0.5, self.high + 0.5) if whole else (self.low, self.high)
        value = low * (high / low) ** share if self.log else low + share * (high - low)
        return min(floor(value + 0.5), self.high) if whole else value


class TuneTable(Table):
    """The trials of settings that are made for every arm before it is run."""

    trials: Annotated[Count, Field(le=100)] = 20
    """Number of trials of each arm, learning from scratch included."""
    seeds: Annotated[
        tuple[int, ...],
        BeforeValidator(_tuning_seeds, json_schema_input_type=int | str | list[int]),
    ] = tuple(range(FIRST_SEED, FIRST_SEED + 3))
    """Seeds of each trial, none of them the study's: a number, a list, or ranges."""
    seed: Whole = Field(default=0, ge=0)
    """Seed of the points that are tried; equal seeds give equal points."""
    space: dict[str, Any]
    """The values to try, by the keys of settings in the file: lists of values, or tables with low,
    high and perhaps log = true."""


# -- Settings that vary, and where they stand in the curriculum of an arm --------------------------

FREE = ("learner", "storage", *OF_TARGETS)  # target settings in which arms may differ
RANGE = {"low", "high"}  # a table with these keys is a range; others hold further keys
SWEEP_HOME, TUNE_HOME = ("sweep",), ("tune", "space")


class Varied(NamedTuple):
    """A setting that varies."""

    key: tuple[str, ...]  # its key in a study file
    home: KeyPath  # the key path of its values in the file
    values: Any  # the list, or the table of a range, at that path

    @property
    def name(self) -> str:
        """The key as text."""
        return path_text(self.key)


def varied_in(tables: object, home: KeyPath, key: tuple[str, ...] = ()) -> Iterator[Varied]:
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


def value_text(value: object) -> str:
    """Return a value as text for names of arms and tables."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}={value_text(inner)}' for key, inner in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    return str(value)


Make = Callable[[Raw], dict[str, Any]]  # a study's tables -> complete curriculum


def places_of(study: Raw, make: Make, setting: Varied) -> list[KeyPath]:
    """Return a setting's paths in the curriculum of an arm that does not set it itself."""
    mark = object()

    def paths_to(node: object, path: KeyPath = ()) -> Iterator[KeyPath]:
        if node is mark:
            yield path
        elif isinstance(node, dict | list):
            for part, inner in node.items() if isinstance(node, dict) else enumerate(node):
                yield from paths_to(inner, (*path, part))

    return [*paths_to(make(merged(study, nested(setting.key, mark))))]


def target_alone(curriculum: Raw) -> dict[str, Any]:
    """Return a complete curriculum without its sources and the settings for targets alone."""
    tasks, graph = curriculum["tasks"], NameGraph.of(dict(curriculum))
    (target,) = graph.targets
    kept = {name: tasks[name] for name in reversed(graph.drawings(target))}
    kept[target] = {key: value for key, value in tasks[target].items() if key not in OF_TARGETS}
    return {"tasks": kept, "transfers": []}


def with_settings(plan: Raw, task: str, **settings: Any) -> dict[str, Any]:
    """Return a complete curriculum with other settings of a task."""
    return {**plan, "tasks": {**plan["tasks"], task: {**plan["tasks"][task], **settings}}}


# -- The arms that sweeps and tunings make ---------------------------------------------------------

MOST_ARMS = 100  # of a sweep: the correction for more arms would hide every relevant difference
MOST_TRIALS = 1_000  # of all arms


class Variant(NamedTuple):
    """An arm with values for the settings that vary."""

    arm: str  # the arm of which it is made
    make: Make
    study: Raw  # the study's tables with these values
    values: Mapping[str, Any]  # setting's key in the file -> value
    settings: tuple[Varied, ...] = ()  # settings of a sweep and of a tuning

    def stating(self, settings: Sequence[Varied], values: Sequence[Any]) -> "Variant":
        """Return the variant with these values added to the study's tables."""
        study = self.study
        for setting, value in zip(settings, values, strict=True):
            study = merged(study, nested(setting.key, value))
        said = dict(zip((setting.name for setting in settings), values, strict=True))
        return self._replace(study=study, values=said, settings=(*self.settings, *settings))


def varied_arms(
    study: Raw, complete: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[tuple[bool, str], tuple[str, tuple[Varied, ...]]]]:
    """Return a configuration's fields after a sweep and a tuning, and what varies in each arm.

    The second maps (whether it is a trial, name of an arm) to the file's arm and the settings.
    """
    patches, first, scratches = table(study.get("arms")), next(iter(complete)), dict[str, Make]()
    arms: dict[str, Make] = {
        arm: partial(complete_curriculum, patch=patches.get(arm)) for arm in complete
    }
    if study.get("scratch") is not False:
        scratches[SCRATCH] = lambda raw: target_alone(arms[first](raw))
        for learner in table(study.get("scratch_learners")):
            scratches[f"{SCRATCH}, {learner}"] = partial(_learnt_by, learner, scratches[SCRATCH])
    swept = dict[str, Variant]()
    for name, make in (*scratches.items(), *arms.items()):
        made = _swept(Variant(name, make, study, {}))
        if name in scratches:  # the first arm from scratch keeps the name scratch
            made = {name: made.pop(next(iter(made))), **made}
        if name in scratches and name != SCRATCH:
            plans = [variant.make(variant.study) for variant in swept.values()]
            made = {label: of for label, of in made.items() if of.make(of.study) not in plans}
        swept |= made

    alone = [label for label, variant in swept.items() if variant.arm in scratches]
    configuration, trials = fields_of(swept, alone), dict[str, Variant]()
    if "tune" in study:
        tuning = TuneTable.model_validate(study["tune"])
        for label, variant in swept.items():
            trials |= _tried(variant._replace(arm=label), tuning)
        of_scratch = [label for label, trial in trials.items() if trial.arm in alone]
        configuration["tune"] = {"seeds": tuning.seeds, **fields_of(trials, of_scratch)}
    varied = {
        (is_trial, label): (variant.arm if variant.arm in complete else first, variant.settings)
        for is_trial, variants in ((False, swept), (True, trials))
        for label, variant in variants.items()
    }
    return configuration, varied


def fields_of(variants: Mapping[str, Variant], alone: Collection[str]) -> dict[str, Any]:
    """Return a configuration's fields for variants, of which those in `alone` have no sources."""
    plans = {label: variant.make(variant.study) for label, variant in variants.items()}
    return {
        "arms": {label: plan for label, plan in plans.items() if label not in alone},
        "scratches": {label: plan for label, plan in plans.items() if label in alone},
        "variants": {
            label: {"arm": variant.arm, "values": variant.values}
            for label, variant in variants.items()
        },
    }


def _learnt_by(learner: str, alone: Make, study: Raw) -> dict[str, Any]:
    """Return the target alone with a further learner from scratch."""
    plan = alone(study)
    *_, target = plan["tasks"]
    return with_settings(plan, target, learner=table(complete_learners(study, plan))[learner])


def _swept(arm: Variant) -> dict[str, Variant]:
    """Return an arm for each point of a sweep that differs for it, by name."""
    settings, variants = swept_in(arm.study), dict[str, Variant]()
    short, lists = short_names(settings), [setting.values for setting in settings]
    paired = lists and arm.study["sweep"].get(MODE) == PAIRED
    applies = [bool(places_of(arm.study, arm.make, setting)) for setting in settings]
    used = [*compress(settings, applies)]
    for point in zip(*lists, strict=True) if paired else product(*lists):
        values = [*compress(point, applies)]
        pairs = zip(used, values, strict=True)
        label = ", ".join([arm.arm, *(f"{short[s.name]}={value_text(v)}" for s, v in pairs)])
        variants.setdefault(label, arm.stating(used, values))
    return variants


def _tried(arm: Variant, tuning: TuneTable) -> dict[str, Variant]:
    """Return the trials of an arm by name; a single trial if no setting applies to the arm."""
    from scipy.stats.qmc import Halton  # it takes half a second to import

    settings = tuned_in(arm.study)
    applies = [bool(places_of(arm.study, arm.make, setting)) for setting in settings]
    used, trials = [*compress(settings, applies)], dict[str, Variant]()
    # Evenly spread points, equal for all arms; more trials add points to them.
    points = Halton(len(settings), rng=tuning.seed).random(tuning.trials if used else 1)
    for number, point in enumerate(points.tolist(), 1):
        shares = zip(used, compress(point, applies), strict=True)
        values = [
            RangeTable.model_validate(tried).at(share)
            if isinstance(tried := setting.values, dict)
            else tried[int(share * len(tried))]
            for setting, share in shares
        ]
        label = arm.arm if number == 1 else f"{arm.arm}, trial {number}"
        trials[label] = arm.stating(used, values)
    return trials


# -- Mistakes in sweeps and tunings ----------------------------------------------------------------


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
    for flag in ("scratch", "compared"):
        if "tune" in study and study.get(flag) is False:
            text = f"needs the comparison with scratch, at one total: leave out {flag} = false"
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
    trials: Any = table(study.get("tune")).get("trials", 20)
    lists = [s.values for s in swept_in(study) if isinstance(s.values, list)]
    arms = len(complete) * prod(map(len, lists))
    if settings and type(trials) is int and trials * arms > MOST_TRIALS:
        made = f"{trials} of each of {arms} arms, {trials * arms:,}"
        yield ("tune", "trials"), f"must be at most {MOST_TRIALS:,} of all arms: got {made}"


def _wrong_key(study: Raw, complete: Mapping[str, Any], setting: Varied) -> str:
    """Return why a setting cannot vary; empty if it can."""
    first, *parts = setting.key
    if first not in (keys := ("tasks", "transfers", *SETTINGS)):
        return f"must name a setting of tasks or transfers: {first} {unknown(first, keys)}"
    if first in ("tasks", "transfers"):
        names = names_in(study, first)
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
        make = partial(complete_curriculum, patch=patches.get(arm))
        for place in places_of(study, make, setting):
            nowhere = False
            if place[0] == "tasks" and place[1] in drawn and place[2] not in FREE:
                return (
                    f"must leave the target {graph.targets[0]} as it is, since all arms are "
                    "compared in it: run the study once for each value, with --set"
                )
    text = "changes nothing: each task or arm that it could apply to sets it itself"
    return text if nowhere else ""
