"""Grid worlds, rule by rule, on maps small enough to check by hand."""

import pytest

from curricle import GridWorld, Rewards, solve

NORTH, EAST, SOUTH, WEST = range(4)
PAY = Rewards(step=-1, treasure=200, fire=-500, near_fire=-250, pit=-2500)


def step(maze, cell, move):
    """Return where a move leads, and what it pays."""
    mdp = maze.mdp
    row = mdp.outcome_row[maze.state(*cell), move]
    assert mdp.probability[row].tolist() == [1.0]
    row_column = maze.cells[mdp.next_state[row, 0]]
    return tuple(row_column.tolist()), float(mdp.reward[row, 0])


@pytest.mark.parametrize(
    ("move", "cell"), [(NORTH, (0, 1)), (EAST, (1, 2)), (SOUTH, (2, 1)), (WEST, (1, 0))]
)
def test_moves_lead_where_they_say(move, cell):
    assert step(GridWorld(["...", ".S.", "..T"]), (1, 1), move) == (cell, -1)


@pytest.mark.parametrize(
    ("drawing", "paid"),
    [
        ("S.T", -1),
        ("ST.", 199),
        ("SPT", -2501),
        ("SFT", -501),
        ("S.FT", -251),
    ],
    ids=["free", "treasure", "pit", "fire", "near fire"],
)
def test_a_step_pays_for_the_cell_entered(drawing, paid):
    assert step(GridWorld(drawing, rewards=PAY), (0, 0), EAST) == ((0, 1), paid)


def test_fires_nearby_are_paid_once_and_not_diagonally():
    maze = GridWorld(["S.F", ".F.", "..T"], rewards=PAY)
    assert step(maze, (0, 0), EAST) == ((0, 1), -251)
    maze = GridWorld(["S....", "..F..", "....T"], rewards=PAY)
    paid = {(r, c): step(maze, (r, c - 1), EAST)[1] for r in range(3) for c in (1, 2, 3)}
    near = {cell for cell, reward in paid.items() if reward == -251}
    assert near == {(0, 2), (1, 1), (1, 3), (2, 2)}
    assert paid[1, 2] == -501


def test_all_terms_of_a_cell_add_up():
    assert step(GridWorld("STF", rewards=PAY), (0, 0), EAST)[1] == -1 + 200 - 250
    assert step(GridWorld("SPFT", rewards=PAY), (0, 0), EAST)[1] == -1 - 2500 - 250


@pytest.mark.parametrize(
    ("drawing", "paid"),
    [("S.T", -1), ("ST.", 200), ("STF", -250), ("SPFT", -2500), ("SFFT", -500)],
)
def test_the_worst_term_alone_counts_if_asked(drawing, paid):
    assert step(GridWorld(drawing, rewards=PAY, combine="worst"), (0, 0), EAST)[1] == paid


@pytest.mark.parametrize("move", [NORTH, SOUTH, WEST])
def test_leaving_the_grid_is_staying_and_pays_the_cell_again(move):
    assert step(GridWorld("S.T", rewards=PAY), (0, 0), move) == ((0, 0), -1)
    assert step(GridWorld("SFT", rewards=PAY), (0, 0), move) == ((0, 0), -251)
    burning = GridWorld(["S.", "F.", ".T"], rewards=PAY)
    assert step(burning, (1, 0), WEST) == ((1, 0), -501)


def test_a_bump_pays_its_own_term_on_top():
    maze = GridWorld("SF.T", rewards=Rewards(step=-1, bump=-7))
    assert step(maze, (0, 0), WEST)[1] == -1 - 250 - 7
    assert step(maze, (0, 2), EAST)[1] == 199
    worst = GridWorld("S..T", rewards=Rewards(step=-1, bump=-7), combine="worst")
    assert step(worst, (0, 0), WEST)[1] == -7
    assert step(worst, (0, 0), EAST)[1] == -1


def test_a_wall_is_no_state_and_cannot_be_entered():
    maze = GridWorld(["S#T", "..."], rewards=PAY)
    assert maze.states.size == 5
    assert step(maze, (0, 0), EAST) == ((0, 0), -1)
    assert step(maze, (1, 1), NORTH) == ((1, 1), -1)
    assert [maze.state(*cell) for cell in maze.cells] == list(range(5))


def test_pits_and_treasure_end_the_episode_and_fire_does_not():
    assert GridWorld("SFPT").mdp.terminal.tolist() == [False, False, True, True]


@pytest.mark.parametrize(
    ("ends", "ended"),
    [(("treasure",), "T"), (("fire", "pit"), "FP"), ((), ""), (["pit", "pit"], "P")],
)
def test_what_ends_an_episode_can_be_chosen(ends, ended):
    maze = GridWorld("SFPT", ends=ends)
    assert maze.mdp.terminal.tolist() == [c in ended for c in "SFPT"]


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
