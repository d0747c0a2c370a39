"""Units of random studies: each is sent once, the first of those whose sources are stored first."""

from concurrent.futures import Future

import pytest
from hypothesis import given, strategies as st

from curricle.comparison import plan
from curricle.comparison.plan import Failures, Unit, trained_units

SEEDS = range(5)


class Checked:
    """Workers that check what they are sent (`first` says it naively), ending in a drawn order."""

    def __init__(self, data, units, keys, done, most, failing):
        self.data, self.units, self.keys, self.done = data, units, keys, done
        self.most, self.failing = most, failing
        self.sent, self.stored, self.failed, self.held = [], [], [], {}

    def keep(self, unit, result):
        assert unit is result
        self.done.setdefault(unit.key, {}).update(dict.fromkeys(unit.seeds))

    def needed(self, unit):
        failed = {other.key for other in self.failed}
        lost = {arm for (arm, _), key in self.keys.items() if key in failed}
        arms = {arm for (arm, _), key in self.keys.items() if key == unit.key}
        return "scratch" not in lost and bool(arms - lost)

    def first(self):
        for unit in self.units:
            pairs = [(key, seed) for key in unit.sources.values() for seed in unit.seeds]
            ready = all(seed in self.done.get(key, ()) for key, seed in pairs)
            if unit not in self.sent and ready and self.needed(unit):
                return unit
        return None

    def train(self, unit):
        assert unit == self.first()
        future = Future()
        if self.data.draw(st.booleans(), "begins at once, so that it cannot be cancelled"):
            future.set_running_or_notify_cancel()
        self.sent.append(unit)
        self.held[future] = unit
        return future

    def wait(self, futures, timeout, return_when):
        assert len(futures) <= self.most
        assert len(futures) == self.most or self.first() is None
        assert not [other for other in futures if other.cancelled()]
        waiting = [other for other in futures if not other.done()]
        some = st.lists(st.sampled_from(waiting), min_size=1, unique=True)
        ended = self.data.draw(some) if waiting else []  # all were cancelled
        for future in ended:
            unit = self.held[future]
            if unit in self.failing:
                future.set_exception(MemoryError(unit.label))
            else:
                future.set_result(unit)
        return set(ended), set(futures) - set(ended)

    def lost(self):
        raise AssertionError("nothing cancels units but the scheduler")


class Noting(Failures):
    """Failures that tell the workers of each."""

    def __init__(self, workers):
        super().__init__(workers.keys)
        self.workers = workers

    def add(self, unit, error):
        super().add(unit, error)
        self.workers.failed.append(unit)


@st.composite
def studies(draw):
    """Draw keys of arms, units in any order, and seeds that are trained already."""
    sources: dict[str, set[str]] = {}
    for n in range(draw(st.integers(1, 6))):
        direct = draw(st.sets(st.sampled_from(sorted(sources)))) if sources else set()
        sources[f"k{n}"] = direct.union(*(sources[other] for other in direct))
    targets = [next(iter(sources)), *draw(st.lists(st.sampled_from(sorted(sources)), max_size=4))]
    arms = {f"arm {n}" if n else "scratch": target for n, target in enumerate(targets)}
    keys = {(arm, key): key for arm, target in arms.items() for key in {target} | sources[target]}
    done, units = {}, []
    for key in sorted(set(keys.values())):
        trained = draw(st.sets(st.sampled_from(SEEDS))) if draw(st.booleans()) else set()
        done[key] = dict.fromkeys(trained)
        groups = {}
        for seed in set(SEEDS) - trained:
            groups.setdefault(draw(st.integers(0, 2)), []).append(seed)
        arm = next(arm for arm, other in keys if other == key)
        named = {other: other for other in sources[key]}
        units += [
            Unit(key, arm, key, tuple(sorted(members)), named, {}, 0) for members in groups.values()
        ]
    return keys, draw(st.permutations(units)), done


def sent_to_the_end(data, study, failing):
    keys, units, done = study
    workers = Checked(data, units, keys, done, data.draw(st.integers(1, 6), "at once"), failing)
    places = {"at_once": lambda: workers.most, "lost": workers.lost}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "wait", workers.wait)
        running = trained_units(units, workers.train, workers.keep, Noting(workers), **places)
        workers.stored += [unit for unit, _ in running]
    assert len(set(workers.sent)) == len(workers.sent)
    return workers


@given(data=st.data(), study=studies())
def test_every_unit_is_sent_once_and_after_its_sources(data, study):
    workers = sent_to_the_end(data, study, failing=())
    assert set(workers.stored) == set(workers.sent) == set(study[1])


@given(data=st.data(), study=studies())
def test_after_failures_what_other_arms_need_is_trained(data, study):
    failing = data.draw(st.sets(st.sampled_from(study[1]))) if study[1] else set()
    workers = sent_to_the_end(data, study, failing)
    assert set(workers.failed) <= failing
    assert set(workers.stored) >= {unit for unit in study[1] if workers.needed(unit)}
    assert workers.failed or set(workers.stored) == set(study[1])
