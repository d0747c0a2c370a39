"""Tasks with an automaton: names, pictures, mappings, learning, and what is refused."""

import pickle

import numpy as np
import pytest

import curricle as cr
from curricle.errors import TaskError
from curricle.pictures.scenes import scene_of
from curricle.pictures.views import GridView
from curricle.tasks import Automaton, with_automaton, with_start

WORLD = cr.GridWorld(["S.#.", "...T"], rewards=cr.Rewards(step=0.0, treasure=0.0), discount=0.9)
EDGES = [("before", "key", "after", 1.0), ("after", "end", "home", 5.0)]


def events(before, action, after):
    row, column = after["row"], after["column"]
    return np.select([(row == 0) & (column == 3), (row == 1) & (column == 0)], ["key", "end"], "")


def made(edges=EDGES, event=events, **settings):
    return with_automaton(WORLD, Automaton(edges, event, **{"terminal": ["home"]} | settings))


def test_states_are_named_and_end_where_the_automaton_ends():
    task = made()
    assert task.states.names == ("row", "column", "automaton")
    assert task.states.label(1).endswith("automaton=after")
    decoded = task.states.decode()
    treasure = (decoded["row"] == 1) & (decoded["column"] == 3)
    np.testing.assert_array_equal(task.mdp.terminal, treasure | (decoded["automaton"] == 2))
    assert task.mdp.start[decoded["automaton"] > 0].sum() == 0


def test_pictures_show_the_map_with_the_state_of_the_automaton_fixed():
    view = GridView.of(made(), at={"automaton": "after"})
    assert view.is_map
    assert len(view.states) == WORLD.states.size
    assert "automaton after" in view.words
    assert GridView.for_replay(made()) is not None
    assert "automaton = before" in scene_of(made()).text(int(made().mdp.start_states[0]))


def test_names_are_mapped_by_and_start_states_apply():
    with pytest.raises(TaskError, match="different names"):
        with_automaton(made(), Automaton(EDGES, events))
    both = with_automaton(made(), Automaton(EDGES, events, name="second"))
    assert both.states.names[-2:] == ("automaton", "second")
    task, other = made(), made([("before", "key", "after", 2.0), ("after", "end", "home", 9.0)])
    mapping = cr.project(task, other)
    assert mapping.coverage().unmapped == 0.0
    assert (with_start(task, "uniform").mdp.start > 0).sum() == (~task.mdp.terminal).sum()


def test_it_is_learnt_and_equal_when_made_again():
    result = cr.learn(made(), budget=2_000, seeds=2)
    assert result.greedy_return[:, -1].max() <= cr.solve(made()).start_value + 1e-9
    assert made() == made()
    assert hash(made()) == hash(made())
    assert pickle.loads(pickle.dumps(made())).mdp.states == made().states


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"edges": "ab"}, "edges of an automaton must be a list"),
        ({"edges": [("a", "b")]}, "an edge must be"),
        ({"edges": [("a", "", "b")]}, "must be text"),
        ({"edges": [("a", "key", "b", "x")]}, "the reward of edge"),
        ({"edges": [*EDGES, ("before", "key", "home")]}, "one edge at most in a state"),
        ({"edges": [*EDGES, ("home", "key", "before")]}, "must not leave a terminal state"),
        ({"edges": [], "terminal": []}, "the start of an automaton must be text"),
        ({"terminal": ["before"], "edges": EDGES[1:], "start": "before"}, "not the start"),
        ({"terminal": ["nowhere"]}, "must be states of edges"),
        ({"terminal": "home"}, "terminal of an automaton must be a list"),
        ({"event": 3}, "must be a function"),
        ({"event": lambda b, a, c: np.zeros(len(c["row"]))}, "must return an array of text"),
        ({"event": lambda b, a, c: np.full(len(c["row"]), "kay")}, "its edges have key, end"),
    ],
)
def test_what_is_refused(change, fragment):
    with pytest.raises(TaskError, match=fragment):
        made(**change)
