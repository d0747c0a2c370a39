"""Tuning: trials of settings for every arm, the best settings, their record and its effects."""

import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import pairwise, product
from typing import Annotated, Any, NamedTuple, Self

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
THIRDS = 3  # in which a range is shown


class SpaceRecord(Plain):
    """The values of a setting that were searched."""

    low: float | None = None
    high: float | None = None
    log: bool = False
    values: tuple[JsonValue, ...] = ()  # where they were listed; a range has none

    @property
    def levels(self) -> tuple[str, ...]:
        """The listed values as text, or the thirds of the range."""
        if self.values:
            return tuple(dict.fromkeys(map(value_text, self.values)))
        space: Any = np.geomspace if self.log else np.linspace
        bounds = space(self.low, self.high, THIRDS + 1).tolist()
        return tuple(f"{short(low)} to {short(high)}" for low, high in pairwise(bounds))

    def level(self, value: Any) -> str:
        """Return the level that a value belongs to."""
        if self.values:
            return value_text(value)
        ends: Any = self.low, self.high, value
        low, high, here = map(math.log, ends) if self.log else ends
        third = int((here - low) / (high - low) * THIRDS)
        return self.levels[min(max(third, 0), THIRDS - 1)]

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
    """A digest of its dependencies except Optuna's version; empty if stale trials were kept."""
    of_settings: str  # a digest of that but for code and Curricle's version
    optuna: str  # the version of Optuna that searched
    seeds: tuple[Count, ...] = Field(min_length=1)
    total: Annotated[int, Field(ge=1)]  # steps of each trial and seed, sources included
    space: dict[str, SpaceRecord]
    arms: dict[str, TunedArm]

    def steps(self, arm: str) -> int:
        """Return the steps of an arm's trials, all seeds together."""
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
    """Return the tuning of a study's folder; None if there is none or it has not ended."""
    return store.record(TUNING, TuningRecord) if store.has(TUNING) else None


def tuning_words(store: StudyStore) -> str:
    """Return a sentence on how far a folder's tuning is; empty if no tuning is under way."""
    configuration = store.description.get("configuration")
    if not isinstance(configuration, dict) or not {"tune", "choose"} & configuration.keys():
        return ""
    before = "the tuning has changed" if store.has(TUNING) else "it is tuned first"
    if "choose" in configuration:
        before = "its arm is chosen first"
    if not store.has(f"{TRIALS}/{BEGUN}"):
        return f"{before}: no trial has begun"
    trials = StudyStore(store.path / TRIALS)
    begun, stored = trials.record(BEGUN, BegunTrials), trials.finished()
    done = sum({*begun.seeds} <= stored.get(key, {}).keys() for key in begun.keys)
    number = counted(begun.number, "trial")
    return f"{before}: {done} of {number} are stored; its seeds come after them"


# -- Tuning: settings are searched for every arm, by Optuna, before a study is run -----------------
#
# Every arm, learning from scratch too, gets as many trials on the same seeds, none of the study's.
# Their score is what arms are compared by: the mean return over all steps, sources charged.

AT_RANDOM = 10  # trials of an arm, at once, before those which learn from others
AT_ONCE = 4  # further trials of an arm, at once; fixed, so that the number of workers is no matter
MOST_BUDGETS = 200  # combinations of listed budgets whose steps are counted beforehand
DIGEST_BYTES = 8

Settings = Mapping[str, Any]  # values of settings by their keys
Chosen = Mapping[str, tuple[str, Settings]]  # name of a trial -> its arm and settings
Train = Callable[[StudyConfig, Arms, str], StudyStore]  # trains what is missing; where it is stored
Choose = Callable[[Dependencies], str]  # gives what depends on something its key


def tuning_of(study: StudyConfig) -> Tuning:
    """Return the tuning of a study that has one."""
    assert study.tune is not None, f"{study.name} has nothing to tune"
    return study.tune


def check_tuning(study: StudyConfig) -> int:
    """Return the steps of a trial and seed, with sources at their largest budgets."""
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
    """Return the study of trials at the ends, or at the listed values, of each setting."""
    tune = tuning_of(study)
    ends = dict[str, tuple[str, Settings]]()
    for name in tune.space:
        arm = next(arm for arm in tune.places if tune.places[arm][name])
        space = tune.space[name]
        for value in (space.low, space.high) if isinstance(space, RangeTable) else space:
            ends[f"{name} = {value_text(value)}"] = arm, {name: value}
    return trial_study(study, ends)


def with_trials(study: StudyConfig, arms: Arms) -> tuple[Arms, ...]:
    """Return a study's arms and, if it is tuned first, the arms of trials at extreme settings."""
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
    best_of: Any = {"arms": arms, "scratches": scratches, "variants": variants}
    return study.varied(own_learners=True, tune=None, **best_of)


def number_of_trials(study: StudyConfig) -> int:
    """Return the trials of all arms together; an arm with nothing to tune has a single trial."""
    tune = tuning_of(study)
    arms = (*(study.scratches or {}), *study.arms)
    return sum(tune.trials if tune.keys(arm) else 1 for arm in arms)


def digest_of(study: StudyConfig, choose: Choose = key_of) -> str:
    """Return a digest of all but Optuna's version on which a study's tuning or choice depends."""
    keys = Arms.of(study, choose).keys
    depends = (
        sorted(keys.items()),
        "choose" if study.choose else tuning_of(study).model_dump_json(),
    )
    return blake2b(repr(depends).encode(), digest_size=DIGEST_BYTES).hexdigest()


def tune(study: StudyConfig, train: Train, choose: Choose = key_of) -> TuningRecord:
    """Tune a study and return the record, which depends on the study and Optuna's version."""
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
        curves = dict[str, Arm]()
        for trial in chosen:
            curves[trial] = trained_arm(arms, trial, store, stored, config.seeds)
        scratch = (trial for trial in chosen if chosen[trial][0] == SCRATCH)
        reference = reference or curves[next(scratch)]
        for trial, (name, _) in chosen.items():
            searches[name].tell(float(mean_return(curves[trial].charged(reference)).mean()))
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


def trained_arm(
    arms: Arms,
    name: str,
    store: StudyStore,
    stored: Mapping[str, Mapping[int, StoredUnit]],
    seeds: Sequence[int],
) -> Arm:
    """Return an arm of trials from the stored units of some ascending seeds."""
    of_seed, arm = stored[arms.keys[name, arms.target]], arms.arms[name]
    units = dict.fromkeys(of_seed[seed] for seed in seeds)
    runs = [of_seeds(store.arrays(unit, RUN), seeds) for unit in units]
    spent = np.concatenate([run["source_steps"] for run in runs])
    order = np.argsort(np.concatenate([run["seeds"] for run in runs]))
    initial = [run["initial_values"] for run in runs if "initial_values" in run]
    return Arm.of(
        joined_results([LearningResult.of_arrays(run) for run in runs]),
        spent[order],
        arms.steps[1],
        arms.eval_freq,
        scratch=arm.scratch,
        curriculum=arm.of,
        initial_values=np.concatenate(initial)[order] if initial else None,
    )


class Search:
    """The search of an arm by Optuna's TPE; all arms begin alike, from the same seed."""

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
        """Yield numbers and settings of the next trials; a single trial if nothing varies."""
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
        """Record the score of the earliest trial without a score."""
        trial, values = self._asked.pop(0)
        known = math.isfinite(score)
        failed = _optuna().trial.TrialState.FAIL
        self._study.tell(trial, score if known else None, state=None if known else failed)
        self.trials.append(TrialRecord(values=values, score=score if known else None))


def _optuna() -> Any:
    """Return Optuna with its messages about trials off."""
    try:
        import optuna
    except ImportError:
        raise SettingError(
            'tuning needs Optuna, which is not installed: pip install "curricle[tune]"'
        ) from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


# -- What a sweep or a tuning shows: the mean return with each value of a setting ------------------

BY_SWEEP, BY_TUNING = "sweep", "tuning"


class Level(NamedTuple):
    """The mean return of an arm with a value of a setting, over all other settings."""

    arm: str
    key: str  # of the setting, as in the study's file
    text: str  # the value in words, or a part of its range
    number: int  # of arms or trials
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Effects:
    """The main effects of a sweep or a tuning."""

    kind: str  # BY_SWEEP or BY_TUNING
    settings: Mapping[str, SpaceRecord]  # what was varied
    levels: tuple[Level, ...]  # the main effects, by setting, arm and value

    @classmethod
    def of(
        cls,
        kind: str,
        settings: Mapping[str, SpaceRecord],
        tried: Sequence[tuple[str, Mapping[str, Any], Any]],
        sum_up: Callable[[Any], tuple[float, float, float]],
    ) -> Self:
        """Return the main effects of `tried`: arms, values of settings, and returns."""
        levels = list[Level]()
        for key, arm in product(settings, dict.fromkeys(arm for arm, _, _ in tried)):
            results: dict[str, list[Any]] = {text: [] for text in settings[key].levels}
            for tried_arm, values, result in tried:
                if tried_arm == arm and key in values:
                    results[settings[key].level(values[key])].append(result)
            of_text = ((text, returns) for text, returns in results.items() if returns)
            levels += [Level(arm, key, text, len(r), *sum_up(r)) for text, r in of_text]
        return cls(kind, settings, tuple(levels))


def effects_of(
    comparison: Comparison, record: CurriculaRecord, tuning: TuningRecord | None
) -> tuple[Effects, ...]:
    """Return the main effects of a study's sweep and tuning, if it has any."""
    swept = sweep_effects(comparison, record, tuning)
    tuned = None if tuning is None else tuning_effects(tuning)
    return tuple(effects for effects in (swept, tuned) if effects is not None)


def sweep_effects(
    comparison: Comparison, record: CurriculaRecord, tuning: TuningRecord | None
) -> Effects | None:
    """Return the mean over all arms with each value, intervals over seeds; None without a sweep."""
    tuned = set() if tuning is None else {*tuning.space}
    tried, listed = [], dict[str, list[Any]]()
    for name, arm in record.arms.items():
        if arm.variant is not None and name in comparison.arms:
            values = {key: arm.variant.values[key] for key in arm.variant.values.keys() - tuned}
            tried.append((arm.variant.arm, values, comparison.returns[name]))
            for key, value in arm.variant.values.items():
                if key not in tuned:
                    listed.setdefault(key, []).append(value)

    def over_seeds(returns: Sequence[FloatArray]) -> tuple[float, float, float]:
        mean = mean_interval(np.mean(returns, axis=0))
        return float(mean.estimate), float(mean.low), float(mean.high)

    settings = {key: SpaceRecord(values=tuple(values)) for key, values in listed.items()}
    return Effects.of(BY_SWEEP, settings, tried, over_seeds) if settings else None


def tuning_effects(tuning: TuningRecord) -> Effects:
    """Return each level's mean, lowest and highest trial; most trials are near the best level."""
    tried = [
        (arm.arm, trial.values, trial.score)
        for arm in tuning.arms.values()
        for trial in arm.trials
        if trial.score is not None
    ]

    def over_trials(scores: Sequence[float]) -> tuple[float, float, float]:
        return float(np.mean(scores)), min(scores), max(scores)

    return Effects.of(BY_TUNING, tuning.space, tried, over_trials)


def short(number: float) -> str:
    """Return a number in three significant digits, or as a whole number."""
    return f"{number:,.0f}" if abs(number) >= 1000 else f"{number:.3g}"
