"""Grid worlds: the rules in plain Python on random maps, and by hand."""

import numpy as np
from hypothesis import assume, given, strategies as st

from curricle import GridWorld, Rewards, solve
from curricle.tasks import FrozenLake

NORTH, EAST, SOUTH, WEST = range(4)
WAYS = ((-1, 0), (0, 1), (1, 0), (0, -1))
PAY = Rewards(step=-1, treasure=200, fire=-500, near_fire=-250, pit=-2500)


def step(maze, cell, move):
    """Return where a move leads, and what it pays."""
    mdp = maze.mdp
    row = mdp.outcome_row[maze.state(*cell), move]
    assert mdp.probability[row].tolist() == [1.0]
    row_column = maze.cells[mdp.next_state[row, 0]]
    return tuple(row_column.tolist()), float(mdp.reward[row, 0])


def by_the_rules(maze, cell, way):
    """Return the cell that a move leads to and what it pays, read off the drawing."""
    drawn = {(r, c): thing for r, line in enumerate(maze.map) for c, thing in enumerate(line)}

    def beside(cell, way):
        return cell[0] + way[0], cell[1] + way[1]

    there = beside(cell, way)
    bumped = drawn.get(there, "#") == "#"
    entered = cell if bumped else there
    pays, thing = maze.rewards, drawn[entered]
    terms = [{"T": pays.treasure, "P": pays.pit, "F": pays.fire}.get(thing)]
    terms += [pays.near_fire] * any(drawn.get(beside(entered, way)) == "F" for way in WAYS)
    terms = [term for term in [*terms, pays.bump if bumped and pays.bump else None] if term]
    if maze.combine == "sum":
        return entered, pays.step + sum(terms)
    return entered, min(terms, default=pays.step)


@given(
    st.integers(1, 4).flatmap(
        lambda n: st.lists(st.text("STFP#...", min_size=n, max_size=n), min_size=1, max_size=4)
    ),
    st.sampled_from(["sum", "worst"]),
    st.sets(st.sampled_from(["treasure", "pit", "fire"])),
    st.sampled_from([0.0, -7.0]),
)
def test_every_step_is_as_the_drawing_says(lines, combine, ends, bump):
    assume("T" in "".join(lines) and any(x in ".S" for x in "".join(lines)))
    pay = Rewards(-1, 200, -500, -250, -2500, bump)
    maze = GridWorld(lines, pay, combine, sorted(ends), start="uniform")
    free = [(r, c) for r, line in enumerate(lines) for c, x in enumerate(line) if x != "#"]
    assert list(map(tuple, maze.cells.tolist())) == free
    ended = {"treasure": "T", "pit": "P", "fire": "F"}
    drawn = [lines[r][c] in [ended[name] for name in ends] for r, c in free]
    assert maze.mdp.terminal.tolist() == drawn
    for cell in (cell for cell, end in zip(free, drawn, strict=True) if not end):
        for move, way in enumerate(WAYS):
            assert step(maze, cell, move) == by_the_rules(maze, cell, way)


def test_starts_are_those_drawn_uniform_or_given():
    assert GridWorld("S.ST").mdp.start.tolist() == [0.5, 0, 0.5, 0]
    maze = GridWorld("S#PFT").with_start("uniform")
    assert maze.mdp.start.tolist() == [0.5, 0, 0.5, 0]
    maze = GridWorld("S..T")
    assert maze.with_start([(0, 1), (0, 2)]).mdp.start.tolist() == [0, 0.5, 0.5, 0]
    assert maze.mdp.start.tolist() == [1, 0, 0, 0]  # the original is as it was
    assert maze.with_start([(0, 1)]) == maze.with_start(((0, 1),))


def test_a_crop_keeps_coordinates_and_rules():
    maze = GridWorld(["S.F.", "..PT"], rewards=PAY)
    part = maze.crop(rows=(0, 2), columns=(3, 4))
    assert part.cells.tolist() == [[0, 3], [1, 3]]
    assert part.states.label(0) == "row=0 column=3"
    assert part.mdp.start.tolist() == [1, 0]
    assert step(maze, (0, 3), NORTH)[1] == -251
    assert step(part, (0, 3), NORTH)[1] == -1  # the fire is gone
    maze = GridWorld(["S....", "....T"])
    part = maze.crop(rows=(0, 2), columns=(2, 5)).crop(rows=(1, 2), columns=(3, 5))
    assert part == maze.crop(rows=(1, 2), columns=(3, 5))
    assert part.objects == (("treasure", 1, 4),)
    maze = GridWorld("S.ST", discount=0.5, time_limit=7, combine="worst")
    part = maze.crop(rows=(0, 1), columns=(1, 4), start="map")
    assert part.mdp.start.tolist() == [0, 1, 0]
    assert (part.discount, part.time_limit, part.combine) == (0.5, 7, "worst")


def test_relative_states_are_one_to_one_with_cells():
    absolute = GridWorld(["S.F", "#.T"])
    relative = GridWorld(["S.F", "#.T"], representation="relative")
    assert relative.states.size == absolute.states.size == 5
    at_start = relative.states.decode(relative.state(0, 0))
    assert {name: int(v) for name, v in at_start.items()} == {
        "fire_1_row": 0, "fire_1_column": 2, "treasure_1_row": 1, "treasure_1_column": 2,
    }  # fmt: skip
    assert (relative.mdp.reward == absolute.mdp.reward).all()
    assert (solve(relative).values == solve(absolute).values).all()


def test_relative_states_do_not_depend_on_the_place_on_the_map():
    maze = GridWorld(["....", "S..T"], representation="relative")
    part = maze.crop(rows=(1, 2), columns=(1, 4))
    for column in (1, 2, 3):
        there, here = part.state(1, column), maze.state(1, column)
        assert part.states.label(there) == maze.states.label(here)


def test_a_map_may_be_drawn_indented_or_as_lines():
    drawn = GridWorld("""
        S.
        .T
    """)
    assert drawn == GridWorld(["S.", ".T"]) == GridWorld(("S.", ".T"))
    assert hash(drawn) == hash(GridWorld(["S.", ".T"]))


def test_a_legend_says_what_other_characters_are():
    drawn = ["|@ o", "| *|"]
    legend = {"|": "wall", "@": "start", " ": "free", "o": "pit", "*": "fire"}
    maze = GridWorld([*drawn, "|..T"], legend=legend)
    assert maze == GridWorld(["#S.P", "#.F#", "#..T"])
    assert maze.crop(rows=(1, 3), columns=(1, 4)).map == (".F#", "..T")
    text = "\n".join(["  |@.o", "  |.*|", "  |..T"])
    assert GridWorld(text, legend=legend) == maze
    lake = FrozenLake("8x8", time_limit=200)
    assert np.array_equal(GridWorld(lake.map, legend="frozen_lake")._ends, lake.mdp.terminal)
