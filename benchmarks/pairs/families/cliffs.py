"""Development: walks along a cliff and through wind, -1 a step."""

from ..pair import Family
from ..worlds import by_cell, cropped, grid, redrawn

CLIFF = [
    "............",
    "............",
    "............",
    "SCCCCCCCCCCG",
]
WINDY = [
    "..........",
    "..........",
    "..........",
    "S......G..",
    "..........",
    "..........",
    "..........",
]
BLOWS = {3: 0.3, 4: 0.3, 5: 0.3, 6: 0.5, 7: 0.5, 8: 0.3}


def cliffs() -> Family:
    """Return the family; a cliff and a windy field, 12,000 and 50,000 steps."""
    family = Family("cliffs", "development")
    rules = {"rewards": {"C": -19.0}, "step": -1.0, "back_to_start": "C"}
    family.target("cliff", grid(CLIFF, **rules), 12_000)
    # Away from the start a fall ends the episode, as there is no start to go back to.
    part = {**rules, "back_to_start": "", "ends": "GC", "starts": "."}
    half = cropped(CLIFF, (0, 4), (6, 12), **part)
    last = cropped(CLIFF, (2, 4), (9, 12), **part)
    swapped = redrawn(CLIFF, {(3, 0): "G", (3, 11): "S"})
    back = grid(swapped, **rules)
    no_cliff = grid([line.replace("C", ".") for line in CLIFF], **rules)
    mirrored = by_cell(lambda row, column: (row, 17 - column))
    family.add("near", "half the cliff", half, budget=5_000)
    family.add("near", "no cliff", no_cliff, budget=6_000)
    family.add("far", "the last cells", last, budget=800)
    family.add("wrong goal", "the way back", back, budget=4_000)
    family.add("mirrored", "half the cliff mirrored", half, mirrored, budget=5_000)
    family.spoil("half the cliff")

    windy = {"rewards": {}, "step": -1.0, "wind": BLOWS}
    family.target("field", grid(WINDY, **windy), 50_000)
    calm = grid(WINDY, rewards={}, step=-1.0)
    right = cropped(WINDY, (0, 7), (4, 10), **{**windy, "starts": "."})
    corner = redrawn(WINDY, {(3, 7): ".", (6, 0): "G"})
    wrong = grid(corner, **windy)
    family.add("near", "no wind", calm, budget=12_000)
    family.add("far", "the right side", right, budget=12_000)
    family.add("wrong goal", "another corner", wrong, budget=12_000)
    family.add("useless", "moves reversed", calm, budget=12_000, turned=True)
    return family
