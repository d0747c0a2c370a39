"""The families; constants of the library are fitted on the development ones alone."""

from collections.abc import Callable

from ..pair import Family
from .cliffs import cliffs
from .garnets import garnets
from .hills import hills
from .hunts import hunts
from .keys import keys
from .lifts import lifts
from .lines import chains, rivers, seas
from .locks import locks
from .machines import machines
from .mazes import mazes
from .queues import queues
from .races import races
from .rooms import four_rooms, lakes
from .stocks import stocks
from .taxis import taxis

DEVELOPMENT: dict[str, Callable[[], Family]] = {
    "mazes": mazes,
    "cliffs": cliffs,
    "garnets": garnets,
    "hunts": hunts,
    "keys": keys,
    "queues": queues,
    "locks": locks,
}
VERIFICATION: dict[str, Callable[[], Family]] = {
    "river-swim": rivers,
    "chain": chains,
    "deep-sea": seas,
    "taxi": taxis,
    "frozen-lake": lakes,
    "four-rooms": four_rooms,
    "stocks": stocks,
}
FRESH: dict[str, Callable[[], Family]] = {
    "races": races,
    "lifts": lifts,
    "machines": machines,
    "hills": hills,
}
"""Written before they were played, and not changed since."""
FAMILIES = {**DEVELOPMENT, **VERIFICATION}
