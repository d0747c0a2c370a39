"""Pictures of tasks, and their text."""

import numpy as np
import pytest

from curricle import GridWorld, Pursuit
from curricle.interop.environment import MazeEnvironment, to_gymnasium
from curricle.interop.scene import AGENT, OBJECTS, PREY, painted, predator, scene_of

from .environments import RING, TASKS, WALLED

EAST = 1


@pytest.mark.parametrize("name", TASKS)
def test_pictures_of_all_states_have_one_size_and_differ(name):
    task = TASKS[name]
    scene = scene_of(task)  # terminal states too, in which no episode starts
    pictures = [scene.image(s) for s in range(0, task.states.size, 1 + task.states.size // 40)]
    assert {picture.shape for picture in pictures} == {pictures[0].shape}
    assert all(side % 2 == 0 for side in pictures[0].shape[:2])  # as video formats want it
    assert pictures[0].dtype == np.uint8
    assert len({picture.tobytes() for picture in pictures}) == len(pictures)


def test_a_picture_is_the_caller_s():
    environment = MazeEnvironment(render_mode="rgb_array")
    environment.reset()
    first = environment.render()
    kept = first.copy()
    first[:] = 0
    assert np.array_equal(environment.render(), kept)


def test_only_the_agent_s_cells_change():
    environment = to_gymnasium(GridWorld("S..T"), render_mode="rgb_array")
    environment.reset()
    before = environment.render()
    environment.step(EAST)
    changed = np.flatnonzero((environment.render() != before).any(axis=(0, 2)))
    width = before.shape[1] / 4
    assert changed.min() < width  # left the first cell
    assert width < changed.max() < 2 * width + 4  # for the second


def test_figures_differ_without_their_colours():
    figures = [AGENT, PREY, predator(1), predator(2), predator(3), *OBJECTS.values()]

    def in_grey(figure):
        colours, through = painted(figure, 32)
        return (colours + 247 * through).mean(axis=2)

    greys = [in_grey(figure) for figure in figures]
    for i, one in enumerate(greys):
        for other in greys[:i]:
            assert abs(one - other).max() > 100


def test_text_shows_the_map_and_the_agent():
    environment = to_gymnasium(WALLED, render_mode="ansi")
    environment.reset(options={"state": {"row": 0, "column": 1}})
    assert environment.render() == "S@#T\nFP.."


def test_text_shows_the_prey_and_the_predators_numbers():
    hunt = Pursuit(3, 2)
    environment = to_gymnasium(hunt, render_mode="ansi")
    environment.reset(options={"state": {"prey": 0, "predator_1": 0, "predator_2": 8}})
    assert environment.render() == "P1 .  .\n.  .  .\n.  .  2"


def test_other_tasks_are_named():
    environment = to_gymnasium(RING, render_mode="ansi")
    environment.reset(options={"state": 3})
    assert environment.render() == "place=3"


def test_rendering_needs_a_mode():
    environment = to_gymnasium(WALLED)
    environment.reset()
    with pytest.warns(UserWarning, match="render_mode"):
        assert environment.render() is None
