"""Levels and teachers of published claims; the depths of curricula and their totals."""

import numpy as np
import pytest

import curricle as cr
from benchmarks.published import __main__ as tables, depth, teachers
from curricle.study import audit, read_study
from curricle.study.auditing import as_fair
from curricle.tasks import goal_distance


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


def test_the_rings_hold_every_start_of_the_spiral():
    study = read_study(tables.CLAIMS["starts"])
    target = study.curricula["rings of starts"].tasks["target"]
    assert int(goal_distance(target).max()) == 59
    covered = np.sum([task.mdp.start > 0 for task in teachers.rings(target).values()], axis=0)
    np.testing.assert_array_equal(covered, target.mdp.start > 0)
    # a corridor four cells wide: no way is shorter than its length in cells of the published maze
    assert cr.solve(target).start_value == pytest.approx(0.864, abs=0.001)


@pytest.mark.parametrize("of", teachers.LEARNERS.values())
def test_a_teacher_draws_for_the_learners_of_the_trials(of):
    fair = as_fair(read_study(tables.CLAIMS["starts"]), 1)
    own, *others = teachers.learners(fair, of).values()
    assert (type(own).__name__, len(others)) == (
        of.removeprefix("scratch, ") if "," in of else "QLearning",
        5,
    )
    target = fair.curricula["rings of starts"].tasks["target"]
    result = teachers.teach(
        teachers.rings(target), target, teachers.ReverseCurriculum(), own, 40_000,
        seeds=[0, 1], eval_freq=4_000, evaluation=cr.GreedyEvaluation(),
    )  # fmt: skip
    assert len(result.drawn[0]) > 20
    # the optimistic learner is at the optimum, .864, where the other is not
    assert (result.greedy_return[:, -1] > 0.8).all() == ("Optimistic" in of)


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
