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


def test_what_is_nearly_right_is_allowed():
    assert cr.QLearning(inverse_temperature=np.float32(0.5)).inverse_temperature == 0.5
    assert run(None, 1e3).steps_used.tolist() == [1000]
    assert cr.GridWorld("S.T", ends="treasure").ends == ("treasure",)
    assert cr.GridWorld("S.T", start=[(0, 0), (0, 0)]).mdp.start.tolist() == [1, 0, 0]
