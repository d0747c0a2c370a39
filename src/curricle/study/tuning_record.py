"""What a results folder says about a tuning: every trial, and the best of each arm."""

from typing import Annotated, Self

from pydantic import Field, JsonValue, model_validator

from curricle.archives import sealed
from curricle.files import Place
from curricle.study.folders import holds_study
from curricle.study.plain_data import Count, Plain
from curricle.study.record import plain, read_record
from curricle.study.store import StudyStore
from curricle.text_tables import counted

TUNING = "tuning.json"
BEGUN = "begun.json"
"""The trials of a tuning that has not ended, in their folder."""
TRIALS = "tuning"
"""The folder of the trials' units, in that of the results."""


class SpaceRecord(Plain):
    """The values of a setting that were searched."""

    low: float | None = None
    high: float | None = None
    log: bool = False
    values: tuple[JsonValue, ...] = ()
    """Where they were listed; a range has none."""

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

    arm: str
    """As the file calls it; "scratch" of learning from scratch."""
    trials: tuple[TrialRecord, ...] = Field(min_length=1)

    @property
    def best(self) -> TrialRecord:
        """The trial with the highest score; the first of several."""
        scored = [one for one in self.trials if one.score is not None]
        return max(scored or self.trials, key=lambda one: one.score or 0.0)


class TuningRecord(Plain):
    """A tuning that is complete."""

    of: str
    """A digest of all that it depends on, but Optuna's version; empty where stale trials were
    kept."""
    of_settings: str
    """A digest of that but for code and Curricle's version."""
    optuna: str
    """The version of Optuna that searched."""
    seeds: tuple[Count, ...] = Field(min_length=1)
    total: Annotated[int, Field(ge=1)]
    """Steps of each trial and seed, sources included."""
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

    number: Count
    """Of all its trials."""
    seeds: tuple[Count, ...]
    keys: tuple[str, ...]
    """The key of each trial's target."""


def read_tuning(store: StudyStore) -> TuningRecord | None:
    """Return the tuning of a study's folder; None if there is none, or it has not ended."""
    if not store.has(TUNING):
        return None
    found = store.read_sealed(TUNING)
    return store.checked(TUNING, lambda: read_record(TuningRecord, found))


def tuning_at(path: Place) -> TuningRecord | None:
    """Return the tuning in a folder that may not be there."""
    return read_tuning(StudyStore(path)) if holds_study(path) else None


def write_tuning(store: StudyStore, record: TuningRecord) -> None:
    """Write ``tuning.json``."""
    store.write(TUNING, sealed(plain(record)))


def write_begun(trials: StudyStore, begun: BegunTrials) -> None:
    """Write ``begun.json`` into the folder of the trials."""
    trials.write(BEGUN, sealed(plain(begun)))


def tuning_words(store: StudyStore) -> str:
    """Return how far the tuning of a study's folder is, in a sentence; empty if none goes on."""
    configuration = store.description.get("configuration")
    if not isinstance(configuration, dict) or "tune" not in configuration:
        return ""
    words = "the tuning has changed" if store.has(TUNING) else "it is tuned first"
    if not store.has(f"{TRIALS}/{BEGUN}"):
        return f"{words}: no trial has begun"
    trials = StudyStore(store.path / TRIALS)
    found = trials.read_sealed(BEGUN)
    begun = trials.checked(BEGUN, lambda: read_record(BegunTrials, found))
    stored = trials.finished()
    done = sum({*begun.seeds} <= stored.get(key, {}).keys() for key in begun.keys)
    number = counted(begun.number, "trial")
    return f"{words}: {done} of {number} are stored; its seeds come after them"
