"""The family of taxis: towns of any size, 2 to 4 stands, with and without walls and rain."""

from curricle.tasks.families.components_by_name import ComponentsByName
from curricle.tasks.families.family import TaskFamily
from curricle.tasks.families.parameters import Parameter
from curricle.tasks.taxi import LARGEST_TOWN, STANDS, Taxi

taxi_family = TaskFamily(
    "taxi",
    Taxi,
    (
        Parameter("size", low=3, high=LARGEST_TOWN, harder="larger"),
        Parameter("stands", low=2, high=len(STANDS), harder="larger"),
        Parameter("walls", harder="larger"),
        Parameter("rainy", harder="larger"),
        Parameter("success_rate", low=0, high=1, harder="smaller"),
        Parameter("time_limit", low=1),
        Parameter("discount", low=0, high=1),
    ),
    mapping=ComponentsByName("scale"),
)
"""Taxis (:class:`Taxi`); members map by name, rows and columns in proportion."""
