"""Values of a type that is nearly right: told apart, refused in one sentence, or allowed."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError

LINE = cr.GridWorld("S.T")


def run(*arguments, **settings):
    return cr.learn(LINE, *(arguments or (None, 10)), **settings)


@pytest.mark.parametrize("huge", [2**63, -(10**400), 10**5000, float("inf")], ids=lambda _: "")
def test_a_number_beyond_64_bits_is_refused_in_one_sentence(huge):
    with pytest.raises(SettingError, match=r"^[^\n]{1,90}$"):
        cr.learn(cr.GridWorld("S.T"), budget=huge)
    if abs(huge) > 2**63:
        with pytest.raises(SettingError, match=r"must be finite: got [^\n]{1,40}$"):
            cr.QLearning(learning_rate=huge)


def test_a_shaping_as_text_is_told_from_a_list_of_shapings():
    with pytest.raises(SettingError, match=r"^shaping must be a Shaping, .*: got str$"):
        run(shaping="state")


def test_numbers_of_single_precision_are_compared_without_a_warning():
    assert cr.QLearning(inverse_temperature=np.float32(0.5)).inverse_temperature == 0.5


def test_whole_numbers_may_be_written_as_floats():
    assert run(None, 1e3).steps_used.tolist() == [1000]


def test_one_kind_of_end_may_be_given_bare():
    assert cr.GridWorld("S.T", ends="treasure").ends == ("treasure",)


def test_a_start_cell_given_twice_counts_once():
    assert cr.GridWorld("S.T", start=[(0, 0), (0, 0)]).mdp.start.tolist() == [1, 0, 0]
