"""The mappings f_1 and f_2 of the published hunt (paper E7), without states of a shared cell."""

import numpy as np

from curricle import Pursuit, project
from curricle.transfer import UNMAPPED, StateActionMapping


def first(hunt: Pursuit, chase: Pursuit) -> StateActionMapping:
    """Return f_1, which maps the first predator to that of the chase."""
    return _apart(hunt, chase, "predator_1")


def second(hunt: Pursuit, chase: Pursuit) -> StateActionMapping:
    """Return f_2, which maps the second predator to that of the chase."""
    return _apart(hunt, chase, "predator_2")


def _apart(hunt: Pursuit, chase: Pursuit, predator: str) -> StateActionMapping:
    where = hunt.states.decode()
    shared = (where["predator_1"] == where["predator_2"])[:, None]
    index = np.where(shared, UNMAPPED, project(hunt, chase, predator=predator).index)
    return StateActionMapping(hunt, chase, index)
