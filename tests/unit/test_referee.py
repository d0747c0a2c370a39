"""The referee of designers: its statistics, its files, and the published claim that it checks."""

from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from benchmarks.referee import claim, playing
from benchmarks.referee.domains import MAKERS, Domain, domain
from benchmarks.referee.players import FIXED, PLAYERS, RACING, SCRATCH, Player
from benchmarks.referee.playing import QUICK, path_of, play
from benchmarks.referee.problem import Problem, SearchBudget
from benchmarks.referee.recipes import STANDING, Recipe, Trend
from benchmarks.referee.tables import on_racing, read
from benchmarks.referee.verdicts import Match, Unit, against, paid_after
from curricle.tasks import random_maze


def unit(steps, search=0.0):
    steps = np.array(steps, float)
    return Unit(0.5, steps, np.ones(steps.shape, bool), np.full(len(steps), float(search)), 0)


# -- statistics ----------------------------------------------------------------------------------


def test_savings_are_shares_of_each_targets_own_steps():
    # 50 of 100 and 100 of 1000: a half and a tenth, whatever the targets' sizes.
    found = against(unit([[50, 50], [900, 900]]), unit([[100, 100], [1000, 1000]]))
    assert found.share.estimate == pytest.approx(0.3)


def test_seeds_are_paired_and_the_interval_is_over_seeds_where_targets_are_few():
    base = unit([[100, 200, 300, 400]])
    found = against(unit([[90, 190, 290, 390]]), base)
    # Each seed saves 10 of a mean of 250: no spread at all, so no interval, but a saving.
    assert found.share.estimate == pytest.approx(0.04)
    assert found.share.n == 4
    assert found.beats


def test_the_interval_is_over_targets_where_they_are_many():
    base = unit(np.full((12, 3), 100.0))
    own = unit(np.repeat(np.linspace(40, 130, 12)[:, None], 3, axis=1))
    found = against(own, base)
    assert found.share.n == 12
    assert found.share.low < 0.15 < found.share.high
    assert not against(base, base).beats


def test_a_search_is_charged_to_one_training_and_may_pay_later():
    base, own = unit([[100, 100, 100]]), unit([[60, 70, 80]], search=90)
    assert against(own, base).beats
    assert not against(own, base, search=True).beats
    assert paid_after(own, base) == 3  # 30 saved by each
    assert paid_after(unit([[60, 70, 80]], search=91), base) == 4
    assert paid_after(unit([[110, 120, 100]], search=90), base) is None


def test_racing_needs_six_domains_and_three_of_them():
    fast, slow = unit([[50, 51, 52]]), unit([[100, 101, 99]])

    def sentence(wins, domains):
        units = {
            f"domain {k}": {SCRATCH: slow, FIXED[0]: slow, RACING: fast if k < wins else slow}
            for k in range(domains)
        }
        return on_racing(Match(units))

    assert "a verdict needs 6" in sentence(5, 5)
    assert sentence(2, 6).endswith("the fixed recipe is the default")
    assert "default" not in sentence(3, 6)


# -- domains -------------------------------------------------------------------------------------


def test_no_target_is_both_developed_on_and_judged():
    assert len(MAKERS) >= 6
    for name in ("paper maze", "pursuit", "key-lock-pit", "Block Dude", "four rooms"):
        found = domain(name)
        assert not {repr(one.target) for one in found.development} & {
            repr(one.target) for one in found.held_out
        }


# -- designers -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def maze():
    target = random_maze(size=6, pits=0.2, seed=2)
    return Problem(target, steps=20_000, eval_freq=100), cr.design.source_candidates(target, most=4)


@pytest.mark.parametrize("name", PLAYERS)
def test_a_designer_keeps_to_its_budget_and_makes_the_same_again(maze, name):
    player, (problem, candidates) = PLAYERS[name], maze
    plans = []
    for budget in (SearchBudget(1_500_000), SearchBudget(1_500_000)):
        if player.on_target:
            plans.append(player.design(problem, candidates, budget, seed=1))
        else:
            plans.append(player.design([problem], budget, seed=1).curriculum(problem))
        assert budget.spent <= 1_500_000
    assert len({(plan.order, str(plan)) for plan in plans}) == 1
    assert plans[0].target == "target"


def test_a_search_without_a_budget_learns_the_target_alone(maze):
    for name in ("greedy_forward", "beam", "hts_cr"):
        assert PLAYERS[name].design(*maze, SearchBudget(0)).order == ("target",)


def test_a_curriculum_whose_sources_may_take_everything_is_not_trained(maze):
    problem, _ = maze
    stage = replace(STANDING[0].stages[0], steps=Trend(10_000.0))
    training, taken = problem.train(Recipe((stage,)).curriculum(problem), [0, 1])
    assert (training.steps == problem.steps).all()
    assert not training.learnt.any()
    assert taken == 0


# -- playing and resuming ------------------------------------------------------------------------


@pytest.fixture
def corridor(monkeypatch):
    """Return a domain of two corridors, in place of all others."""
    cases = [playing.Case(f"{n} cells", cr.GridWorld("S" + "." * n + "T"), 400) for n in (2, 3)]
    found = Domain("corridor", (cases[0],), (cases[1],), checkpoints=40)
    monkeypatch.setattr(playing, "domain", lambda name: found)
    return found


def test_a_killed_unit_goes_on_where_it_was(corridor, monkeypatch, tmp_path):
    designed = []

    def counting(problem, candidates, budget, *, seed):
        designed.append(problem.name)
        budget.train(problem, problem.scratch, [seed])
        return problem.scratch

    monkeypatch.setitem(PLAYERS, "counting", Player("counting", counting))
    assert play("counting", "corridor", QUICK, tmp_path)
    path = path_of(tmp_path, "counting", "corridor")
    whole = path.read_bytes()
    assert designed == ["2 cells"] * 4 + ["3 cells"]

    # A kill in the middle of the last line, and one between lines.
    for end in (len(whole) - 20, whole[:-1].rfind(b"\n") + 1):
        designed.clear()
        path.write_bytes(whole[:end])
        assert read(tmp_path, "counting", "corridor", QUICK) is None
        assert play("counting", "corridor", QUICK, tmp_path)
        assert designed == ["3 cells"]
        assert path.read_bytes() == whole

    found = read(tmp_path, "counting", "corridor", QUICK)
    assert found.steps.shape == (1, QUICK.seeds)
    assert (found.search > 0).all()
    assert not found.refused


# -- the published claim -------------------------------------------------------------------------


def test_their_maze_is_theirs():
    # Their trials end at 18.367886, the return of the best policy.
    assert cr.solve(claim.target()).start_value == pytest.approx(18.367886071, abs=1e-8)
