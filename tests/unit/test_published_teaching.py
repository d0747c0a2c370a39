"""Teachers of published claims against their formulas; the depths of curricula and their totals."""

from fractions import Fraction

import numpy as np
import pytest

import curricle as cr
from benchmarks.published import __main__ as tables, depth, teachers
from benchmarks.published.teaching import (
    Episode,
    Learnability,
    PrioritizedLevelReplay,
    ReverseCurriculum,
    Uniform,
    teach,
)
from curricle.study import audit, read_study
from curricle.tasks import GoalDistance, goal_distance, with_start

MAZE = cr.GridWorld(["S...PT", ".PP...", "......"], time_limit=50)
NEAR = with_start(MAZE, GoalDistance(1, 3))
EXACT = cr.GreedyEvaluation(method="exact")


class InTurn(Uniform):
    """Draws tasks in turn, and remembers the episodes."""

    def __init__(self):
        self.seen = []

    def start(self, n_tasks):
        return np.eye(n_tasks)[0]

    def update(self, memory, episode):
        self.seen.append(episode)
        return np.roll(memory, 1)


def taught(tasks, teacher, budget, *, learner=None, target=MAZE, seeds=(0,), eval_freq=None):
    named = {str(i): task for i, task in enumerate(tasks)}
    how = {"seeds": seeds, "eval_freq": eval_freq or budget // 10, "evaluation": EXACT}
    return teach(named, target, teacher, learner or cr.QLearning(), budget, **how)


@pytest.mark.parametrize("evaluation", [EXACT, cr.GreedyEvaluation(method="rollouts", episodes=7)])
def test_starts_of_the_target_are_plain_learning_bit_for_bit(evaluation):
    how = {"seeds": [2, 7], "eval_freq": 30, "evaluation": evaluation}
    alone = cr.learn(MAZE, cr.QLearning(), 1500, **how)
    result = teach({"all": MAZE}, MAZE, Uniform(), cr.QLearning(), 1500, **how)
    np.testing.assert_array_equal(result.greedy_return, alone.greedy_return)
    for k in range(2):
        np.testing.assert_array_equal(result.results[k].values[0], alone.values[k])


def test_td_errors_are_those_of_the_values_at_the_time():
    rows = [[[(1.0, 1, 1.0)]], [[(1.0, 2, 2.0)]], [[(1.0, 2, 0.0)]]]  # s0 -> s1 -> s2, the end
    chain = cr.FiniteMDP.from_outcomes(
        rows, terminal=[False, False, True], start=0, discount=0.5, time_limit=10
    )
    teacher, v = InTurn(), [0.0, 0.0]
    taught([chain], teacher, 12, learner=cr.QLearning(learning_rate=0.25), target=chain)
    assert len(teacher.seen) == 6
    for episode in teacher.seen:
        first = 1 + 0.5 * v[1] - v[0]
        v[0] += 0.25 * first
        second = 2 - v[1]
        v[1] += 0.25 * second
        np.testing.assert_array_equal(episode.td_errors, [first, second])


N_TASKS = 4
CASES = [(seed, n) for seed in range(4) for n in (0, 1, 2, 3, 8, 60)]


def episodes(seed, n):
    """Return n random episodes; some tasks may never be among them."""
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(n):
        task, length = int(rng.integers(N_TASKS)), int(rng.integers(1, 6))
        rewards, errors = rng.normal(size=length), rng.normal(size=length)
        drawn.append(Episode(task, rewards, errors, bool(rng.random() < (task + 1) / 5), 0.9))
    return drawn


def probabilities(teacher, seen):
    memory = teacher.start(N_TASKS)
    for episode in seen:
        memory = teacher.update(memory, episode)
    return teacher.probabilities(memory)


def uniform_over(tasks):
    return np.array([1 / len(tasks) if i in tasks else 0.0 for i in range(N_TASKS)])


def rates(seen, window):
    """Return the share of successes among the last `window` episodes of each task."""
    outcomes = [[e.success for e in seen if e.task == i][-window:] for i in range(N_TASKS)]
    return [np.mean(successes) if successes else 0.0 for successes in outcomes]


@pytest.mark.parametrize(("seed", "n"), CASES)
@pytest.mark.parametrize("top", [1, 2, 9])
def test_learnability_prefers_successes_by_halves(seed, n, top):
    seen = episodes(seed, n)
    rate = [Fraction(p).limit_denominator(6) for p in rates(seen, 6)]
    learnability = [p * (1 - p) for p in rate]  # exact: 1/3 and 2/3 are tied
    last = sorted(learnability, reverse=True)[:top][-1]
    best = [i for i in range(N_TASKS) if learnability[i] >= last]
    expected = 0.7 * uniform_over(best) + 0.3 / N_TASKS
    result = probabilities(Learnability(rho=0.7, top=top, window=6), seen)
    np.testing.assert_allclose(result, expected)


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


def test_the_mazes_of_rutherford():
    task, starts = teachers.drawn_levels()
    assert len(starts) == 100
    place = task.states.decode()
    for maze in range(teachers.MAZES):
        goals = task.terminal & (place["maze"] == maze)
        assert goals.sum() == 4  # a cell, four headings
        # the cells that a move from elsewhere enters are those without a wall
        inside = (place["maze"] == maze) & ~task.terminal
        entered = task.next_state[task.outcome_row[inside, 2], 0]
        moved = entered[entered != np.flatnonzero(inside)]
        assert 13**2 - 60 <= len({*(moved // 4)}) + 10 <= 13**2 - 30
    assert task.reward.max() == 1.0
    assert not task.terminal[[*starts]].any()


def test_the_nearest_levels_come_first():
    every, nearest = teachers.levels(), teachers.levels(nearest=25)
    far = goal_distance(every)
    chosen = far[nearest.mdp.start > 0]
    assert chosen.min() > 0
    assert chosen.max() <= np.sort(far[every.mdp.start > 0][far[every.mdp.start > 0] >= 0])[25]
    assert every.mdp.start.sum() == pytest.approx(1.0)


def test_the_rings_hold_every_start_of_the_spiral():
    study = read_study(tables.CLAIMS["starts"])
    target = study.curricula["rings of starts"].tasks["target"]
    assert int(goal_distance(target).max()) == 59
    covered = np.sum([task.mdp.start > 0 for task in teachers.rings(target).values()], axis=0)
    np.testing.assert_array_equal(covered, target.mdp.start > 0)
    # a corridor four cells wide: no way is shorter than its length in cells of the published maze
    assert cr.solve(target).start_value == pytest.approx(0.864, abs=0.001)


@pytest.mark.slow
def test_the_tables_and_the_figure_of_depths(tmp_path, monkeypatch):
    monkeypatch.setattr(depth, "FAMILIES", {"depth_keys": "key, lock, pits", "depth_maze": "maze"})
    for name in depth.FAMILIES:
        study = read_study(tables.CLAIMS[name], set=["seeds=8", "tasks.target.budget=1_000"])
        made = audit(study, tmp_path / name, trials=1, progress=False)
        rows = [*depth.beside(name, made.fair)]
        assert [len(row) for row in rows] == [1 + len(depth.DEPTHS)] * len(depth.DEPTHS)
    assert [row[0] for row in depth.rows(tables.played(tmp_path))] == [
        d for d in depth.DEPTHS for _ in range(2)
    ]
    depth.figure(tmp_path, tmp_path / "deep.png")
    assert (tmp_path / "deep.png").stat().st_size > 1_000


@pytest.mark.parametrize("name", depth.FAMILIES)
def test_all_depths_have_one_total_and_each_size_is_an_arm(name, tmp_path):
    study = read_study(tables.CLAIMS[name])
    assert tuple(study.arms) == depth.DEPTHS
    for number, plan in enumerate(study.curricula.values(), 1):
        sources = plan.ancestors("target")
        assert len(sources) == number
        steps = sum(plan.setting("budget", source).max_steps for source in sources)
        assert steps == pytest.approx(plan.setting("budget", "target") / 10, abs=5)
    file = tmp_path / "singles.toml"
    file.write_text(depth.single(name))
    arms = read_study(file).curricula
    alone = {tuple(plan.ancestors("target")) for plan in arms.values() if len(plan.tasks) == 2}
    assert len(alone) == len(arms) - 4
