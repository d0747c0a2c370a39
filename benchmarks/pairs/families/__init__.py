"""The families; constants of the library are fitted on the development ones alone."""

from collections.abc import Callable

from benchmarks.pairs.families.cliffs import cliffs
from benchmarks.pairs.families.garnets import garnets
from benchmarks.pairs.families.hunts import hunts
from benchmarks.pairs.families.keys import keys
from benchmarks.pairs.families.lines import chains, rivers, seas
from benchmarks.pairs.families.locks import locks
from benchmarks.pairs.families.mazes import mazes
from benchmarks.pairs.families.queues import queues
from benchmarks.pairs.families.rooms import four_rooms, lakes
from benchmarks.pairs.families.stocks import stocks
from benchmarks.pairs.families.taxis import taxis
from benchmarks.pairs.pair import Family

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
FAMILIES = {**DEVELOPMENT, **VERIFICATION}
