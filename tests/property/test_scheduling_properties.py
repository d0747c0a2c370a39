"""Units of random studies: each is sent once, the first of those whose sources are stored first."""

from concurrent.futures import Future

import pytest
from hypothesis import given, strategies as st

from curricle.comparison import plan
from curricle.comparison.plan import Failures, Unit, trained_units

SEEDS = range(5)


class Checked:
    """Workers that check what they are sent (`first` says it naively), ending in a drawn order."""

    def __init__(self, data, units, done, most):
        self.data, self.units, self.done, self.most = data, units, done, most
        self.sent, self.held = [], {}

    def keep(self, unit, result):
        assert unit is result
        self.done.setdefault(unit.key, {}).update(dict.fromkeys(unit.seeds))

    def first(self):
        for unit in self.units:
            pairs = [(key, seed) for key in unit.sources.values() for seed in unit.seeds]
            ready = all(seed in self.done.get(key, ()) for key, seed in pairs)
            if unit not in self.sent and ready:
                return unit
        return None

    def train(self, unit):
        assert unit == self.first()
        future = Future()
        self.sent.append(unit)
        self.held[future] = unit
        return future

    def wait(self, futures, timeout, return_when):
        assert len(futures) <= self.most
        assert len(futures) == self.most or self.first() is None
        waiting = [other for other in futures if not other.done()]
        some = st.lists(st.sampled_from(waiting), min_size=1, unique=True)
        ended = self.data.draw(some)
        for future in ended:
            future.set_result(self.held[future])
        return set(ended), set(futures) - set(ended)


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


@given(data=st.data(), study=studies())
def test_every_unit_is_sent_once_and_after_its_sources(data, study):
    keys, units, done = study
    workers = Checked(data, units, done, data.draw(st.integers(1, 6), "at once"))
    at_once = {"at_once": lambda: workers.most}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "wait", workers.wait)
        running = trained_units(units, workers.train, workers.keep, Failures(keys), **at_once)
        stored = [unit for unit, _ in running]
    assert len(workers.sent) == len(stored) == len(set(stored))
    assert set(stored) == set(workers.sent) == set(units)
