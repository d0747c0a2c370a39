"""Tuning: trials of settings for every arm, the best of each, their record, and what it shows."""

import json
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import pairwise, product
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, JsonValue, model_validator

from curricle.arrays import FloatArray
from curricle.comparison.comparison import Arm, Comparison
from curricle.comparison.plan import most_source_steps
from curricle.errors import SettingError
from curricle.learning.result import LearningResult, joined_results
from curricle.statistics.curves import SCRATCH, mean_return
from curricle.statistics.intervals import mean_interval
from curricle.study.arms import Arms
from curricle.study.config import StudyConfig
from curricle.study.dependencies import Dependencies, key_of, settings_key_of
from curricle.study.record import Count, CurriculaRecord, Plain
from curricle.study.store import RUN, StoredUnit, StudyStore, of_seeds
from curricle.study_file.vary import RangeTable, Tuning, value_text, with_values
from curricle.text import counted

# -- What a results folder says about a tuning: every trial, and the best of each arm --------------

TUNING = "tuning.json"
BEGUN = "begun.json"  # the trials of a tuning that has not ended, in their folder
TRIALS = "tuning"  # the folder of the trials' units, in that of the results


class SpaceRecord(Plain):
    """The values of a setting that were searched."""

    low: float | None = None
    high: float | None = None
    log: bool = False
    values: tuple[JsonValue, ...] = ()  # where they were listed; a range has none

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.low is None or self.high is None) is not bool(self.values):
            raise ValueError("it must have either low and high, or values")
        return self


class TrialRecord(Plain):
    """Settings that were tried for an arm."""

    values: dict[str, JsonValue]
    score: float | None
    """Mean return over all steps, sources charged, mean over the tuning's seeds; None if it is no
    number."""


class TunedArm(Plain):
    """The trials of an arm."""

    arm: str  # as the file calls it; "scratch" of learning from scratch
    trials: tuple[TrialRecord, ...] = Field(min_length=1)

    @property
    def best(self) -> TrialRecord:
        """The trial with the highest score; the first of several."""
        scored = [trial for trial in self.trials if trial.score is not None]
        return max(scored or self.trials, key=lambda trial: trial.score or 0.0)


class TuningRecord(Plain):
    """A tuning that is complete."""

    of: str
    """A digest of all that it depends on, but Optuna's version; empty where stale trials were
    kept."""
    of_settings: str  # a digest of that but for code and Curricle's version
    optuna: str  # the version of Optuna that searched
    seeds: tuple[Count, ...] = Field(min_length=1)
    total: Annotated[int, Field(ge=1)]  # steps of each trial and seed, sources included
    space: dict[str, SpaceRecord]
    arms: dict[str, TunedArm]

    def steps(self, arm: str) -> int:
        """Return the steps that the trials of an arm are charged with, all seeds together."""
        return len(self.arms[arm].trials) * len(self.seeds) * self.total

    @model_validator(mode="after")
    def _known(self) -> Self:
        for name, arm in self.arms.items():
            for trial in arm.trials:
                if not trial.values.keys() <= self.space.keys():
                    raise ValueError(f"arms.{name}.trials must set what is in the space")
        return self


class BegunTrials(Plain):
    """The trials that a tuning has begun so far."""

    number: Count  # of all its trials
    seeds: tuple[Count, ...]
    keys: tuple[str, ...]  # the key of each trial's target


def read_tuning(store: StudyStore) -> TuningRecord | None:
    """Return the tuning of a study's folder; None if there is none, or it has not ended."""
    return store.record(TUNING, TuningRecord) if store.has(TUNING) else None


def tuning_words(store: StudyStore) -> str:
    """Return how far the tuning of a study's folder is, in a sentence; empty if none goes on."""
    configuration = store.description.get("configuration")
    if not isinstance(configuration, dict) or "tune" not in configuration:
        return ""
    words = "the tuning has changed" if store.has(TUNING) else "it is tuned first"
    if not store.has(f"{TRIALS}/{BEGUN}"):
        return f"{words}: no trial has begun"
    trials = StudyStore(store.path / TRIALS)
    begun = trials.record(BEGUN, BegunTrials)
    stored = trials.finished()
    done = sum({*begun.seeds} <= stored.get(key, {}).keys() for key in begun.keys)
    number = counted(begun.number, "trial")
    return f"{words}: {done} of {number} are stored; its seeds come after them"


# -- Tuning: settings are searched for every arm, by Optuna, before a study is run -----------------
#
# Every arm, learning from scratch too, gets as many trials on the same seeds, none of which is one
# of the study's. What is searched for is what arms are compared by: the mean return over all steps,
# sources charged.

AT_RANDOM = 10  # trials of an arm, at once, before those which learn from others
AT_ONCE = 4
"""Further trials of an arm that are trained at once. It is fixed, so that what is found does not
depend on the number of workers."""
MOST_BUDGETS = 200  # combinations of listed budgets whose steps are counted beforehand
DIGEST_BYTES = 8

Settings = Mapping[str, Any]  # values of settings by their keys
Chosen = Mapping[str, tuple[str, Settings]]  # name of a trial -> its arm and settings
Train = Callable[[StudyConfig, Arms, str], StudyStore]
"""Trains the units of a study that are missing, called by some words; returns where they are."""
Choose = Callable[[Dependencies], str]  # gives what depends on something its key


def tuning_of(study: StudyConfig) -> Tuning:
    """Return the tuning of a study that has one."""
    assert study.tune is not None, f"{study.name} has nothing to tune"
    return study.tune


def check_tuning(study: StudyConfig) -> int:
    """Return the steps of each trial and seed, sources at their largest budgets included."""
    _optuna()
    tune = tuning_of(study)
    extreme_trials(study).check_networks()
    arms = Arms.of(study)
    if arms.total is None or arms.budget is None:
        raise SettingError(
            "arms are tuned at one total of steps: give the budget of the target in steps"
        )
    # The largest budgets: every combination of listed ones, with the top of each range.
    of_steps = {
        name: (space.high,) if isinstance(space, RangeTable) else space
        for name, space in tune.space.items()
        if any("budget" in place for places in tune.places.values() for place in places[name])
    }
    if (number := math.prod(map(len, of_steps.values()))) > MOST_BUDGETS:
        raise SettingError(
            f"a space must have at most {MOST_BUDGETS} combinations of listed budgets: got {number}"
        )
    most = {
        f"{n} {arm}": (arm, dict(zip(of_steps, values, strict=True)))
        for n, values in enumerate(product(*of_steps.values()))
        for arm in study.arms
    }
    curricula = trial_study(study, most).curricula.values()
    steps = arms.budget + max(map(most_source_steps, curricula))
    return max(arms.total, math.ceil(steps / arms.eval_freq) * arms.eval_freq)


def extreme_trials(study: StudyConfig) -> StudyConfig:
    """Return the study of trials with the ends, or listed values, of each setting."""
    tune = tuning_of(study)
    ends = dict[str, tuple[str, Settings]]()
    for name in tune.space:
        arm = next(arm for arm in tune.places if tune.places[arm][name])
        space = tune.space[name]
        for value in (space.low, space.high) if isinstance(space, RangeTable) else space:
            ends[f"{name} = {value_text(value)}"] = arm, {name: value}
    return trial_study(study, ends)


def with_trials(study: StudyConfig, arms: Arms) -> tuple[Arms, ...]:
    """Return a study's arms and, where it is tuned first, those of trials of all that is tried."""
    return (arms,) if study.tune is None else (arms, Arms.of(extreme_trials(study)))


def trial_study(study: StudyConfig, chosen: Chosen, total: int | None = None) -> StudyConfig:
    """Return the study of some trials: each is an arm, on the tuning's seeds."""
    plain, tune = study.to_data(), tuning_of(study)
    tables = {**plain["arms"], **plain["scratches"]}
    arms = {
        name: with_values(tables[arm], tune.placed(arm, values))
        for name, (arm, values) in chosen.items()
    }
    fields: dict[str, Any] = dict.fromkeys(("scratches", "variants", "tune", "controls"))
    fields |= {"scratch": False, "scratch_learners": {}, "snapshots": 0, "own_learners": True}
    return study.varied(arms=arms, seeds=list(tune.seeds), total=total, **fields)


def tuned_study(study: StudyConfig, record: TuningRecord) -> StudyConfig:
    """Return a study with the best settings of each arm."""
    plain, tune = study.to_data(), tuning_of(study)
    best = {name: arm.best.values for name, arm in record.arms.items()}
    variants = {
        name: {**variant, "values": {**variant["values"], **best[name]}}
        for name, variant in plain["variants"].items()
    }
    arms, scratches = (
        {name: with_values(c, tune.placed(name, best[name])) for name, c in plain[which].items()}
        for which in ("arms", "scratches")
    )
    fields: dict[str, Any] = {"arms": arms, "scratches": scratches, "variants": variants}
    return study.varied(own_learners=True, tune=None, **fields)


def number_of_trials(study: StudyConfig) -> int:
    """Return how many trials all arms have together: one where an arm has nothing to tune."""
    tune = tuning_of(study)
    arms = (*(study.scratches or {}), *study.arms)
    return sum(tune.trials if tune.keys(arm) else 1 for arm in arms)


def digest_of(study: StudyConfig, choose: Choose = key_of) -> str:
    """Return a digest of all that a study's tuning depends on, but Optuna's version."""
    keys = Arms.of(study, choose).keys
    depends = (sorted(keys.items()), tuning_of(study).model_dump_json())
    return blake2b(repr(depends).encode(), digest_size=DIGEST_BYTES).hexdigest()


def tune(study: StudyConfig, train: Train, choose: Choose = key_of) -> TuningRecord:
    """Return the tuning of a study, which depends on it and on Optuna's version alone."""
    total, tuning = check_tuning(study), tuning_of(study)
    searches = {name: Search(tuning, name) for name in (*(study.scratches or {}), *study.arms)}
    reference: Arm | None = None
    done, stale = 0, False
    while done < tuning.trials:
        number = min(AT_RANDOM if not done else AT_ONCE, tuning.trials - done)
        chosen = {
            f"{name}, trial {n}": (name, values)
            for name, search in searches.items()
            for n, values in search.ask(number)
        }
        config = trial_study(study, chosen, total)
        arms = Arms.of(config, choose)
        stale |= any(key != key_of(arms.dependencies[place]) for place, key in arms.keys.items())
        now = f"tuning: trials {done + 1} to {done + number} of {tuning.trials}, of each arm"
        store = train(config, arms, now)
        stored = store.finished()
        curves = {
            trial: _arm(store, stored[arms.keys[trial, arms.target]], config.seeds, arms, total)
            for trial in chosen
        }
        scratch = (trial for trial in chosen if chosen[trial][0] == SCRATCH)
        reference = reference or curves[next(scratch)]
        for trial, (name, _) in chosen.items():
            score = float(mean_return(curves[trial].charged(reference)).mean())
            searches[name].tell(score)
        done += number
    return TuningRecord(
        of="" if stale else digest_of(study),
        of_settings=digest_of(study, settings_key_of),
        optuna=_optuna().__version__,
        seeds=tuning.seeds,
        total=total,
        space={
            name: SpaceRecord(low=space.low, high=space.high, log=space.log)
            if isinstance(space, RangeTable)
            else SpaceRecord(values=space)
            for name, space in tuning.space.items()
        },
        arms={
            name: TunedArm(arm=(study.variants or {})[name].arm, trials=tuple(search.trials))
            for name, search in searches.items()
        },
    )


def _arm(
    store: StudyStore,
    stored: Mapping[int, StoredUnit],
    seeds: Sequence[int],
    arms: Arms,
    total: int,
) -> Arm:
    """Return the curves of some seeds of a trial, ascending, by the unit that holds each seed."""
    units = dict.fromkeys(stored[seed] for seed in seeds)
    runs = [of_seeds(store.arrays(unit, RUN), seeds) for unit in units]
    spent = np.concatenate([run["source_steps"] for run in runs])
    order = np.argsort(np.concatenate([run["seeds"] for run in runs]))
    result = joined_results([LearningResult.of_arrays(run) for run in runs])
    return Arm.of(result, spent[order], total, arms.eval_freq)


class Search:
    """The search of one arm: Optuna's TPE, with one seed for all arms, which so begin alike."""

    def __init__(self, tuning: Tuning, arm: str):
        optuna = _optuna()
        self.space = {name: tuning.space[name] for name in tuning.keys(arm)}
        kinds, self.distributions = optuna.distributions, dict[str, Any]()
        for name, space in self.space.items():
            if isinstance(space, RangeTable):
                kind = kinds.IntDistribution if space.whole else kinds.FloatDistribution
                self.distributions[name] = kind(space.low, space.high, log=space.log)
            else:  # Optuna takes the numbers of listed values
                values = tuple(range(len(space)))
                self.distributions[name] = kinds.CategoricalDistribution(values)
        self.trials = list[TrialRecord]()
        self._asked = list[tuple[Any, dict[str, Any]]]()
        with warnings.catch_warnings():
            # "constant_liar" is experimental in some versions: it keeps trials at once apart.
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(
                seed=tuning.seed, n_startup_trials=AT_RANDOM, constant_liar=True
            )
        self._study = optuna.create_study(direction="maximize", sampler=sampler)

    def ask(self, number: int) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield number and settings of the next trials; one trial where nothing varies."""
        for _ in range(number if self.space else not self.trials):
            trial = self._study.ask(self.distributions)
            values = {
                name: value
                if isinstance(space := self.space[name], RangeTable)
                else json.loads(json.dumps(space[value]))
                for name, value in trial.params.items()
            }
            self._asked.append((trial, values))
            yield len(self.trials) + len(self._asked) - 1, values

    def tell(self, score: float) -> None:
        """Take the score of the trial that was asked for first."""
        trial, values = self._asked.pop(0)
        known = math.isfinite(score)
        failed = _optuna().trial.TrialState.FAIL
        self._study.tell(trial, score if known else None, state=None if known else failed)
        self.trials.append(TrialRecord(values=values, score=score if known else None))


def _optuna() -> Any:
    """Return Optuna, without a line about each trial."""
    try:
        import optuna
    except ImportError:
        raise SettingError(
            'tuning needs Optuna, which is not installed: pip install "curricle[tune]"'
        ) from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


# -- What a sweep or a tuning shows: the mean return with each value of a setting ------------------

THIRDS = 3
BY_SWEEP, BY_TUNING = "sweep", "tuning"
Tried = tuple[str, Mapping[str, Any], Any]  # an arm, values of settings, what came of them


@dataclass(frozen=True)
class Setting:
    """A setting that was varied, and the values that it had."""

    key: str  # as in the study's file
    levels: tuple[str, ...]  # the values in words, or parts of its range
    range: SpaceRecord | None = None

    @classmethod
    def listed(cls, key: str, values: Iterable[Any]) -> "Setting":
        """Return a setting of which every value is a level."""
        return cls(key, tuple(dict.fromkeys(map(value_text, values))))

    @classmethod
    def searched(cls, key: str, space: SpaceRecord) -> "Setting":
        """Return a setting that was searched; the levels of a range are its thirds."""
        if space.values:
            return cls.listed(key, space.values)
        low, high = float(space.low or 0.0), float(space.high or 0.0)
        bounds = (np.geomspace if space.log else np.linspace)(low, high, THIRDS + 1)
        texts = tuple(f"{short(a)} to {short(b)}" for a, b in pairwise(bounds.tolist()))
        return cls(key, texts, space)

    def level(self, value: Any) -> str:
        """Return the level that a value belongs to."""
        if self.range is None:
            return value_text(value)
        ends: tuple[Any, ...] = self.range.low, self.range.high, value
        low, high, here = (math.log(x) if self.range.log else x for x in ends)
        number = int((here - low) / (high - low) * len(self.levels))
        return self.levels[min(max(number, 0), len(self.levels) - 1)]


@dataclass(frozen=True)
class Level:
    """The mean return with one value of a setting, whatever the others are."""

    text: str
    number: int  # of arms or trials
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Effects:
    """What a sweep or a tuning shows."""

    kind: str  # BY_SWEEP or BY_TUNING
    settings: tuple[Setting, ...]
    levels: Mapping[tuple[str, str], tuple[Level, ...]]
    """(arm, key) -> the main effect of a setting: its levels, in order."""

    @property
    def rows(self) -> Iterator[tuple[str, str, Level]]:
        """The levels of each setting for each arm: arm, key and level."""
        arms = dict.fromkeys(arm for arm, _ in self.levels)
        for setting in self.settings:
            for arm in arms:
                for level in self.levels.get((arm, setting.key), ()):
                    yield arm, setting.key, level


def effects_of(
    comparison: Comparison, record: CurriculaRecord, tuning: TuningRecord | None
) -> tuple[Effects, ...]:
    """Return what the sweep and the tuning of a study show, those that there are."""
    swept = sweep_effects(comparison, record, tuning)
    tuned = None if tuning is None else tuning_effects(tuning)
    return tuple(effects for effects in (swept, tuned) if effects is not None)


def sweep_effects(
    comparison: Comparison, record: CurriculaRecord, tuning: TuningRecord | None
) -> Effects | None:
    """Return the mean over all arms with each value, intervals over seeds; None without a sweep."""
    tuned = set() if tuning is None else {*tuning.space}
    tried = [
        (
            arm.variant.arm,
            {key: value for key, value in arm.variant.values.items() if key not in tuned},
            comparison.returns[name],
        )
        for name, arm in record.arms.items()
        if arm.variant is not None and name in comparison.arms
    ]
    keys = dict.fromkeys(key for _, values, _ in tried for key in values)
    settings = tuple(
        Setting.listed(key, [values[key] for _, values, _ in tried if key in values])
        for key in keys
    )

    def over_seeds(text: str, returns: Sequence[FloatArray]) -> Level:
        mean = mean_interval(np.mean(returns, axis=0))
        return Level(text, len(returns), float(mean.estimate), float(mean.low), float(mean.high))

    return Effects(BY_SWEEP, settings, _levels(tried, settings, over_seeds)) if settings else None


def tuning_effects(tuning: TuningRecord) -> Effects:
    """Return the mean of the trials of each level, lowest and highest; trials crowd at the best."""
    tried = [
        (arm.arm, trial.values, trial.score)
        for arm in tuning.arms.values()
        for trial in arm.trials
        if trial.score is not None
    ]
    settings = tuple(Setting.searched(key, space) for key, space in tuning.space.items())

    def over_trials(text: str, scores: Sequence[float]) -> Level:
        return Level(text, len(scores), float(np.mean(scores)), min(scores), max(scores))

    return Effects(BY_TUNING, settings, _levels(tried, settings, over_trials))


def _levels(
    tried: Sequence[Tried], settings: Sequence[Setting], level_of: Callable[[str, Any], Level]
) -> dict[tuple[str, str], tuple[Level, ...]]:
    """Return the main effect of each setting on each arm; `level_of` sums up what came of it."""
    levels = {}
    for arm in dict.fromkeys(arm for arm, _, _ in tried):
        for setting in settings:
            results: dict[str, list[Any]] = {text: [] for text in setting.levels}
            for tried_arm, values, result in tried:
                if tried_arm == arm and setting.key in values:
                    results[setting.level(values[setting.key])].append(result)
            if any(results.values()):
                levels[arm, setting.key] = tuple(
                    level_of(text, some) for text, some in results.items() if some
                )
    return levels


def short(number: float) -> str:
    """Return a number in three significant digits, or as a whole number."""
    return f"{number:,.0f}" if abs(number) >= 1000 else f"{number:.3g}"
