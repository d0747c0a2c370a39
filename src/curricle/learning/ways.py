"""The ways a potential enters learning."""

from typing import Literal, get_args

How = Literal[
    "initialise", "look_ahead", "look_back", "state", "bonus", "advice", "weights", "policy"
]
"""The ways a potential enters learning; :func:`learn` says what each does, the last two are
:func:`learn_deep`'s."""
OF_NETWORKS = ("weights", "policy")
"""Ways into learning by a network that no table has: they carry over a network or what it does."""
OF_TABLES = tuple(way for way in get_args(How) if way not in OF_NETWORKS)
RESIDUAL = ("initialise", "look_ahead")
"""Ways that are one for a network: it computes phi with what it learns."""
BY_NETWORKS = (*RESIDUAL, "state", *OF_NETWORKS)
