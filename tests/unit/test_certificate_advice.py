"""Certificates of look-back and decaying advice and of potentials that change."""

import numpy as np
import pytest

import curricle as cr
from curricle.certificate import certify
from curricle.certificate.shaped_task import check_shaping
from tests.certificates import MAZE, PHI, RNG
from tests.tasks import meeting_paths, tree


def test_look_back_advice_is_safe_where_each_state_has_one_past():
    task = tree()
    found = certify(task, cr.LookBackAdvice(np.random.default_rng(2).normal(size=(15, 2)) * 9))
    assert found.holds
    assert found.residual < 1e-6


def test_look_back_advice_is_safe_where_only_an_end_has_two_pasts():
    fork = [[[(1.0, 1, 1.0)], [(1.0, 2, 0.0)]], [[(1.0, 3, 0.0)]] * 2, [[(1.0, 3, 2.0)]] * 2]
    task = cr.FiniteMDP.from_outcomes(
        [*fork, [[], []]], terminal=[False, False, False, True], start=0, discount=0.9
    )
    phi = np.array([[1.0, 5.0], [2.0, 7.0], [3.0, -4.0], [0.0, 0.0]])
    assert certify(task, cr.LookBackAdvice(phi))
    sample = certify(task, cr.LookBackAdvice(phi), method="sampled", steps=8_000)
    assert sample.contradictions == ()


def test_look_back_advice_is_not_safe_where_ways_into_a_state_nearly_agree():
    fork = [[[(1.0, 1, 0.0)], [(1.0, 2, 0.0)]], [[(1.0, 3, 0.0)]] * 2, [[(1.0, 3, 0.0)]] * 2]
    task = cr.FiniteMDP.from_outcomes(
        [*fork, [[(1.0, 4, 1.0)]] * 2, [[], []]], terminal=[0, 0, 0, 0, 1], start=0, discount=0.9
    )
    phi = np.array([[1.0, 5.0], [7.0, 7.0], [7.0, 7.0], [2.0, 3.0], [0.0, 0.0]])
    assert certify(task, cr.LookBackAdvice(phi))
    phi[1] = np.nextafter(7.0, 8.0)
    assert certify(task, cr.LookBackAdvice(phi)).holds is None


def test_look_back_advice_is_not_proven_where_paths_meet():
    task, phi = meeting_paths()
    found = certify(task, cr.LookBackAdvice(cr.StateActionPotential(task, phi)))
    assert found.holds is None
    assert not found
    assert np.isnan(found.loss)
    assert found.findings == (
        "look-back advice keeps the optimum for certain only where all ways into a state have one "
        "phi: state 2 is entered with phi = 5 from state 0 by action 1 and with phi = 0 from state "
        "4 by action 0",
    )
    assert str(found).startswith(
        "Not proven (tolerance 0, largest possible loss unknown). Look-back advice keeps"
    )


def test_the_start_of_an_episode_is_a_past_of_its_own():
    loop = cr.GridWorld("ST")
    phi = np.full((2, 4), 2.0)
    found = certify(loop, cr.LookBackAdvice(phi))
    assert found.holds is None
    assert "with phi = 0 where an episode starts" in str(found)
    assert "is entered with phi = 2 from state 0" in str(found)


@pytest.mark.parametrize(
    ("weight", "holds", "acted_on"),
    [
        (1.0, False, "Q + phi"),
        (0.5, False, "Q + 0.5 phi"),
        (cr.learning.linear(1.0, 0.0, steps=10), True, "Q alone"),
        (cr.learning.exponential(1.0, half_life=1e9), True, "Q alone"),
        (cr.learning.harmonic(1.0, 0.25), False, "Q + 0.25 phi"),
    ],
)
def test_advice_is_compared_at_its_last_weight(weight, holds, acted_on):
    q = cr.solve(MAZE).action_values
    found = certify(MAZE, cr.DecayingAdvice(-9.0 * q, weight=weight))
    assert found.holds is holds
    assert found.findings == (f"in the long run the policy acts on {acted_on}",)


def test_advice_that_agrees_is_safe_with_any_weight():
    agreeing = cr.StateActionPotential(MAZE, cr.solve(MAZE).action_values)
    assert certify(MAZE, cr.DecayingAdvice(agreeing)).holds is None  # two ways are as good
    assert certify(MAZE, cr.DecayingAdvice(agreeing), tolerance=1e-9)


def test_advice_that_is_the_same_for_all_actions_is_safe():
    level = np.repeat(PHI[:, None], 4, axis=1)
    found = certify(MAZE, cr.DecayingAdvice(level))
    assert found.holds
    assert found.loss == 0


FRAMES = RNG.normal(size=(3, MAZE.states.size))


def test_a_changing_potential_is_compared_as_it_ends():
    weight = cr.learning.linear(1.0, 0.5, steps=40)
    phi = cr.StatePotential(MAZE, FRAMES, weight=weight, frame_steps=(0, 15, 300))
    found = certify(MAZE, cr.StateShaping(phi))
    assert found.holds
    assert found.findings == (
        "the potential changes while learning; its last values were compared",
    )
    ends_as = check_shaping(MAZE, cr.StateShaping(phi)).phi
    np.testing.assert_array_equal(ends_as, 0.5 * np.where(MAZE.mdp.terminal, 0, FRAMES[2]))
