"""Which source changed which choices of the target."""

import numpy as np
import pytest

import curricle as cr
from curricle.paper.maze_runs import LEARNER, SOURCE_BUDGET, corner
from curricle.paper.settings import SUMMED, maze

LINE = cr.GridWorld("S....T", time_limit=50)
WRONG_WAY = cr.GridWorld("T....S", time_limit=50)  # as long, but the treasure is in the west


def same_cells(target, source):
    """Map every cell to the one of the same number; what the source ends in is ENDED."""
    index = np.arange(target.states.size * target.actions.size).reshape(-1, target.actions.size)
    ends = source.mdp.terminal[:, None]
    return cr.transfer.StateActionMapping(target, source, np.where(ends, cr.ENDED, index))


def plan(*sources, **settings):
    tasks = {f"source {i}": source for i, source in enumerate(sources)}
    transfers = [
        cr.Transfer(name, "line", same_cells(LINE, source)) for name, source in tasks.items()
    ]
    return cr.Curriculum(
        tasks={**tasks, "line": LINE},
        transfers=transfers,
        budget=5000,
        shaping=cr.QInitialisation(),
        **settings,
    )


def test_a_source_with_the_treasure_elsewhere_makes_choices_wrong_at_once():
    found = cr.comparison.attribute(plan(WRONG_WAY), steps=1, seeds=5)
    (name,) = found.names
    assert name == "source 0 -> line"
    # Before any learning all four actions tie, so the choice is wrong without the source too.
    assert (found.wrong[0] <= 0).all()
    assert (found.loss[0, 1:5] > 0).any()
    later = cr.comparison.attribute(plan(WRONG_WAY), steps=150, seeds=10)
    assert later.gain[0].estimate < 0
    (region,) = later.regions(name)
    assert set(region.states) <= set(range(5))
    assert region.share >= 0.5
    assert region.loss > 0
    assert later.regions(name, harmed=False) == ()


def test_a_source_that_is_the_target_makes_choices_right():
    found = cr.comparison.attribute(plan(LINE), steps=1, seeds=5)
    assert (found.wrong[0, :5] == -1).all()
    assert (found.error[0] == 0).all()
    (region,) = found.regions("source 0 -> line", harmed=False)
    assert region.states.tolist() == [0, 1, 2, 3, 4]
    assert str(region) == "5 states (row 0, column 0 to 4), in 100% of seeds"
    assert found.gain[0].low > 0


def test_each_source_accounts_for_its_own_changes():
    found = cr.comparison.attribute(plan(LINE, WRONG_WAY, aggregate=cr.total), steps=1, seeds=5)
    good, bad = found.wrong[:, 1:4].mean(axis=1)
    assert good < 0 <= bad
    again = plan(LINE, WRONG_WAY, aggregate=cr.total)
    trained = again.train(5, only=["source 0", "source 1"]).nodes
    reused = cr.comparison.attribute(again, steps=1, seeds=5, trained=trained)
    np.testing.assert_array_equal(reused.wrong, found.wrong)


def test_the_differences_are_those_of_runs_with_and_without():
    both = plan(LINE, WRONG_WAY, aggregate=cr.mean)
    found = cr.comparison.attribute(both, steps=60, seeds=4)
    sources = both.train(4, only=["source 0", "source 1"]).nodes
    solution = cr.solve(LINE)

    def runs(transfers):
        potentials = both.potentials("line", sources, transfers=transfers)
        shaping = [cr.QInitialisation(phi) for phi in potentials]
        return cr.learn(LINE, budget=60, seeds=4, shaping=shaping, stream="line", eval_freq=60)

    def wrong(result):
        q = result.values
        greedy = q == q.max(axis=2, keepdims=True)
        return np.array(
            [[(g & ~o).any() for g, o in zip(table, solution.optimal, strict=True)]
             for table in greedy]
        ).astype(float)  # fmt: skip

    with_both = runs(both.transfers)
    for n, other in enumerate((both.transfers[1], both.transfers[0])):
        without = runs([other])
        difference = wrong(with_both) - wrong(without)
        np.testing.assert_allclose(found.wrong[n], difference.mean(axis=0))
        np.testing.assert_allclose(found.error[n], difference.std(axis=0, ddof=1) / 2)
        gain = with_both.greedy_return[:, -1] - without.greedy_return[:, -1]
        assert found.gain[n].estimate == pytest.approx(gain.mean())


def test_the_corner_of_the_maze_is_found_to_mislead():
    """The 3x3 source underestimates its lower row, which the optimal path crosses."""
    arena = maze(-5)
    block = corner(arena, 3)
    curriculum = cr.Curriculum(
        tasks={"corner": block, "maze": arena},
        transfers=[cr.Transfer("corner", "maze", cr.same_position(arena, block))],
        learner=LEARNER,
        shaping=cr.QInitialisation(),
        budget={"corner": SOURCE_BUDGET, "maze": 50_000},
        evaluation=SUMMED,
    )
    found = cr.comparison.attribute(curriculum, steps=20_000, seeds=20)
    worst = found.regions("corner -> maze")[0]
    cells = {tuple(int(x) for x in arena.cells[s]) for s in worst.states}
    assert {(2, 8), (2, 9)} <= cells
    assert "worse in" in str(found)


def test_regions_are_connected_by_transitions():
    rooms = cr.GridWorld(["S.#.", "..#T"], time_limit=50)
    found = cr.comparison.Attribution(
        task=rooms,
        steps=1,
        names=("a",),
        wrong=np.array([[1.0, 1.0, 1.0, 0.0, 0.9, 0.0]]),
        error=np.zeros((1, 6)),
        loss=np.ones((1, 6)),
        gain=(cr.statistics.Interval(0.0, 0.0, 0.0, 0.95, 2),),
    )
    together, apart = found.regions("a")
    assert together.states.tolist() == [0, 1, 4]
    assert apart.states.tolist() == [2]
    assert apart.where == "row 0, column 3"


def test_numbers_and_names_are_checked():
    with pytest.raises(
        cr.errors.CurriculumError,
        match="the curriculum of an attribution must be a Curriculum: got",
    ):
        cr.comparison.attribute(LINE, steps=10)
    with pytest.raises(
        cr.errors.CurriculumError, match="needs a task with transfers into it: 'line' has none"
    ):
        cr.comparison.attribute(cr.Curriculum(tasks={"line": LINE}), steps=10)
    with pytest.raises(cr.errors.SettingError, match="at least 2 seeds: got 1"):
        cr.comparison.attribute(plan(LINE), steps=10, seeds=1)
    with pytest.raises(
        cr.errors.SettingError, match="steps of an attribution must be a whole number"
    ):
        cr.comparison.attribute(plan(LINE), steps=0)
    with pytest.raises(
        cr.errors.CurriculumError, match="a transfer must be one of source 0 -> line"
    ):
        cr.comparison.attribute(plan(LINE), steps=1, seeds=2).regions("line")
