"""Each teacher's probabilities, against the formula of its docstring computed from all episodes."""

from itertools import pairwise

import numpy as np
import pytest

from curricle.teaching import (
    TSCL,
    Episode,
    Learnability,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    Uniform,
)

N_TASKS = 4
CASES = [(seed, n) for seed in range(4) for n in (0, 1, 2, 3, 8, 60)]


def episodes(seed, n):
    """Return n random episodes; some tasks may never be among them."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(n):
        task, length = int(rng.integers(N_TASKS)), int(rng.integers(1, 6))
        found.append(
            Episode(
                task,
                rng.normal(size=length),
                rng.normal(size=length),
                bool(rng.random() < (task + 1) / 5),
                0.9,
            )
        )
    return found


def probabilities(teacher, seen):
    memory = teacher.start(N_TASKS)
    for episode in seen:
        memory = teacher.update(memory, episode)
    return teacher.probabilities(memory)


def uniform_over(tasks):
    return np.array([1 / len(tasks) if i in tasks else 0.0 for i in range(N_TASKS)])


def rates(seen, window):
    """Return the share of successes among the last `window` episodes of each task."""
    each = [[e.success for e in seen if e.task == i][-window:] for i in range(N_TASKS)]
    return [np.mean(one) if one else 0.0 for one in each]


@pytest.mark.parametrize(("seed", "n"), CASES)
def test_tscl_follows_the_largest_change_of_return(seed, n):
    seen, progress = episodes(seed, n), [0.0] * N_TASKS
    for i in range(N_TASKS):
        returns = [sum(r * 0.9**t for t, r in enumerate(e.rewards)) for e in seen if e.task == i]
        for before, now in pairwise(returns):
            progress[i] = 0.7 * progress[i] + 0.3 * (now - before)
    size = np.abs(progress)
    best = [i for i in range(N_TASKS) if np.isclose(size[i], max(size), rtol=1e-12, atol=0)]
    expected = 0.8 * uniform_over(best) + 0.2 / N_TASKS
    np.testing.assert_allclose(probabilities(TSCL(0.3, 0.2), seen), expected)


@pytest.mark.parametrize(("seed", "n"), CASES)
@pytest.mark.parametrize("top", [1, 2, 9])
def test_learnability_prefers_successes_by_halves(seed, n, top):
    seen = episodes(seed, n)
    learnability = [p * (1 - p) for p in rates(seen, 6)]
    last = sorted(learnability, reverse=True)[:top][-1]
    best = [i for i in range(N_TASKS) if learnability[i] >= last]
    expected = 0.7 * uniform_over(best) + 0.3 / N_TASKS
    found = probabilities(Learnability(rho=0.7, top=top, window=6), seen)
    np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize(("seed", "n"), CASES)
def test_replay_ranks_value_losses_and_adds_staleness(seed, n):
    seen = episodes(seed, n)
    latest = {e.task: (number, e) for number, e in enumerate(seen, 1)}
    score = {}
    for task, (_, e) in latest.items():
        length = len(e.td_errors)
        advantages = [
            sum((0.9 * 0.8) ** (k - t) * e.td_errors[k] for k in range(t, length))
            for t in range(length)
        ]
        score[task] = np.mean(np.abs(advantages))
    ranked = sorted(score, key=score.get, reverse=True)
    by_score = np.array([1 / (ranked.index(i) + 1) ** 2 if i in score else 0 for i in range(4)])
    by_age = np.array([float(n - latest[i][0]) if i in score else 0 for i in range(4)])
    unseen = [i for i in range(N_TASKS) if i not in score]
    expected = np.zeros(N_TASKS)
    if score:
        by_score = by_score / by_score.sum()
        by_age = by_age / by_age.sum() if by_age.any() else by_score
        expected = (0.7 * by_score + 0.3 * by_age) * len(score) / N_TASKS
    if unseen:
        expected = expected + uniform_over(unseen) * len(unseen) / N_TASKS
    teacher = PrioritizedLevelReplay(temperature=0.5, staleness=0.3, gae_lambda=0.8)
    np.testing.assert_allclose(probabilities(teacher, seen), expected)


@pytest.mark.parametrize(("seed", "n"), CASES)
def test_the_reverse_curriculum_expands_from_the_goal(seed, n):
    seen = episodes(seed, n)
    p, known = rates(seen, 5), {e.task for e in seen}
    old = [i for i in range(N_TASKS) if i in known and p[i] >= 0.2]
    new = [i for i in range(N_TASKS) if p[i] <= 0.7 and (i == 0 or i - 1 in old)]
    if old and new:
        expected = 0.25 * uniform_over(old) + 0.75 * uniform_over(new)
    else:
        expected = uniform_over(old or new)
    teacher = ReverseCurriculum(r_min=0.2, r_max=0.7, replay=0.25, window=5)
    np.testing.assert_allclose(probabilities(teacher, seen), expected)


@pytest.mark.parametrize(
    "teacher",
    [Uniform(), TSCL(), Learnability(), PrioritizedLevelReplay(), ReverseCurriculum()],
    ids=lambda teacher: type(teacher).__name__,
)
def test_no_teacher_changes_what_it_remembers(teacher):
    memory = teacher.start(N_TASKS)
    for episode in episodes(0, 20):
        before = teacher.probabilities(memory).copy()
        after = teacher.update(memory, episode)
        np.testing.assert_array_equal(teacher.probabilities(memory), before)
        memory = after
