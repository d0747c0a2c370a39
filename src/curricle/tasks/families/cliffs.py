"""The family of walks along a cliff, of any size."""

from curricle.tasks.cliff_walking import LARGEST_SIDE, CliffWalking
from curricle.tasks.families.components_by_name import ComponentsByName
from curricle.tasks.families.family import TaskFamily
from curricle.tasks.families.parameters import Parameter

cliff_walking_family = TaskFamily(
    "cliff_walking",
    CliffWalking,
    (
        Parameter("rows", low=2, high=LARGEST_SIDE, harder="larger"),
        Parameter("columns", low=3, high=LARGEST_SIDE, harder="larger"),
        Parameter("slippery", harder="larger"),
        Parameter("start", values=("map", "uniform")),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=ComponentsByName("clip"),
)
"""Walks along a cliff (:class:`CliffWalking`).

Members map cell by cell, counted from the goal; cells farther off than the source has are read at
its edge.
"""
