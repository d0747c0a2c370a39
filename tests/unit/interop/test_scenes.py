"""Pictures of tasks, and their text."""

import numpy as np
import pytest

from curricle import Pursuit
from curricle.interop.environment import to_gymnasium
from curricle.show.scenes import AGENT, FIGURES, PREY, painted, predator, scene_of
from curricle.tasks import (
    BlockDude,
    CliffWalking,
    DeepSea,
    FourRooms,
    FrozenLake,
    KeyLockPit,
    RiverSwim,
    Taxi,
)

from .environments import TASKS, WALLED


@pytest.mark.parametrize("name", TASKS)
def test_pictures_of_all_states_have_one_size_and_differ(name):
    task = TASKS[name]
    scene = scene_of(task)  # terminal states too, in which no episode starts
    pictures = [scene.image(s) for s in range(0, task.states.size, 1 + task.states.size // 40)]
    assert {picture.shape for picture in pictures} == {pictures[0].shape}
    assert all(side % 2 == 0 for side in pictures[0].shape[:2])  # as video formats want it
    assert pictures[0].dtype == np.uint8
    assert len({picture.tobytes() for picture in pictures}) == len(pictures)


def test_figures_differ_without_their_colours():
    figures = [AGENT, PREY, predator(1), predator(2), predator(3), *set(FIGURES.values())]

    def in_grey(figure):
        colours, through = painted(figure, 32)
        return (colours + 247 * through).mean(axis=2)

    greys = [in_grey(figure) for figure in figures]
    for i, one in enumerate(greys):
        for other in greys[:i]:
            assert abs(one - other).max() > 100


def test_text_shows_who_is_where():
    environment = to_gymnasium(WALLED, render_mode="ansi")
    environment.reset(options={"state": {"row": 0, "column": 1}})
    assert environment.render() == "S@#T\nFP.."
    hunt = Pursuit(3, 2)
    environment = to_gymnasium(hunt, render_mode="ansi")
    environment.reset(options={"state": {"prey": 0, "predator_1": 0, "predator_2": 8}})
    assert environment.render() == "P1 .  .\n.  .  .\n.  .  2"
    first = int(GRIDS["Block Dude"].mdp.start_states[0])
    assert "1" in scene_of(GRIDS["Block Dude"]).text(first)


GRIDS = {
    "four rooms": FourRooms(size=7),
    "key, lock, pit": KeyLockPit.room(5),
    "Block Dude": BlockDude(1).crop(columns=(0, 12), agent=10),
    "a river": RiverSwim(),
    "a sea": DeepSea(size=4),
    "a lake": FrozenLake(),
    "a cliff": CliffWalking(),
    "a taxi": Taxi(size=3, stands=2),
}


@pytest.mark.parametrize("name", GRIDS)
def test_what_says_where_its_states_lie_is_drawn_there(name):
    task = GRIDS[name]
    scene, layout = scene_of(task), task.layout
    states = range(0, task.states.size, 1 + task.states.size // 40)
    pictures = [scene.image(state) for state in states]
    assert {picture.shape for picture in pictures} == {pictures[0].shape}
    assert all(side % 2 == 0 for side in pictures[0].shape[:2])
    assert len({picture.tobytes() for picture in pictures}) == len(pictures)
    said = [scene.text(state).splitlines() for state in states]
    assert len(set(map(tuple, said))) == len(said)
    for state, lines in zip(states, said, strict=True):
        row, column = layout.cells[state] - layout.origin
        assert lines[row][column] == "@"
        assert "".join(lines[: layout.shape[0]]).count("@") == 1


def test_rendering_needs_a_mode():
    environment = to_gymnasium(WALLED)
    environment.reset()
    with pytest.warns(UserWarning, match="render_mode"):
        assert environment.render() is None
