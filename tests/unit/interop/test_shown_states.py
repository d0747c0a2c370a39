"""What a class itself shows of a state: text, pictures, boards; in messages, episodes and pages."""

import base64
import io
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from PIL import Image

import curricle as cr
from curricle.errors import SettingError
from curricle.learning.record import Snapshots
from curricle.pictures.episode import Episode
from curricle.pictures.scenes import scene_of
from curricle.show.replay import shown_episode
from curricle.study.analysis import before_and_after
from curricle.study.record import EpisodePair, EpisodeRecord, read_record
from curricle.tasks.spaces import state_name
from tests.unit.show.studies import Reader, page_of, record


class Corridor(gym.Env):
    """Ten places in a row; the last one ends the episode."""

    metadata = {"render_modes": ["ansi", "rgb_array"]}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(self, length=10, render_mode=None):
        self.length, self.render_mode = length, render_mode
        self.observation_space, self.action_space = spaces.Discrete(length), spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return self.place, {}

    def step(self, action):
        self.place = max(0, self.place + 2 * int(action) - 1)
        return self.place, -1.0, self.place == self.length - 1, False, {}

    def render(self):
        if self.render_mode == "ansi":
            return "." * self.place + "@" + "." * (self.length - 1 - self.place)
        return np.full((6, 8, 3), 20 * self.place, np.uint8)


class Written(Corridor):
    """It has no modes of rendering, and a text of two lines."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self):
        super().__init__()

    def __str__(self):
        return f"place\n{self.place}"


class Coloured(Corridor):
    def render(self):
        return "\x1b[41m@\x1b[0m" if self.render_mode == "ansi" else np.zeros((2, 2, 3), np.uint8)


class Broken(Corridor):
    def render(self):
        raise RuntimeError("no screen")


class Slides(gym.Env):
    """Three tiles and a gap, 2 x 2."""

    def __init__(self):
        self.observation_space = spaces.Box(0, 3, (2, 2), np.int64)
        self.action_space = spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.board = np.array([[1, 2], [0, 3]])
        return self.board.copy(), {}

    def step(self, action):
        gap = tuple(np.argwhere(self.board == 0)[0])
        other = tuple(np.add(gap, [(-1, 0), (0, 1), (1, 0), (0, -1)][action]))
        if {*other} <= {0, 1}:
            self.board[gap], self.board[other] = self.board[other], 0
        over = self.board.ravel().tolist() == [1, 2, 3, 0]
        return self.board.copy(), -1.0, over, False, {}


def table(environment, time_limit=30, **settings):
    return cr.tabulate(environment, discount=0.9, time_limit=time_limit, **settings)


@pytest.fixture(scope="module")
def corridor():
    return table(Corridor)


def test_a_state_is_shown_as_the_class_itself_shows_it(corridor):
    scene = scene_of(corridor)
    assert [scene.text(state) for state in (0, 3, 9)] == ["@.........", "...@......", ".........@"]
    assert (scene.image(3) == np.full((6, 8, 3), 60)).all()
    assert state_name(corridor.states, 3) == "state 3 (shown as ...@......)"
    short = table(Corridor, length=4)  # its arguments are passed on
    assert scene_of(short).text(1) == ".@.."


def test_a_text_of_several_lines_is_in_no_message():
    task = table(Written)
    assert scene_of(task).text(3) == "place\n3"
    assert state_name(task.states, 3) == "state 3"
    assert scene_of(task).image(3).shape[1] == 480  # a card, as it draws no picture


@pytest.mark.parametrize("environment", [Coloured, Broken])
def test_numbers_stand_for_what_cannot_be_shown(environment):
    task = table(environment)
    assert scene_of(task).text(3) == "place=3"
    assert state_name(task.states, 3) == "state 3"


def test_a_state_is_not_shown_where_the_environment_leads_elsewhere(monkeypatch):
    task = table(Corridor)
    starting = Corridor.reset

    def elsewhere(self, *, seed=None):
        starting(self, seed=seed)
        return self.step(1)[0], {}

    monkeypatch.setattr(Corridor, "reset", elsewhere)
    assert task.states.drawn(3, "ansi") is None
    assert scene_of(task).text(3) == "place=3"


class Slippery(Corridor):
    def step(self, action):
        return super().step(action if self.np_random.random() < 0.5 else 1)


def test_actions_with_random_outcomes_lead_to_no_state_for_sure():
    task = table(Slippery, samples=20)
    assert task.states.drawn(3, "ansi") is None
    assert scene_of(task).text(3) == task.states.label(3)


def test_a_copy_and_a_pickle_show_numbers(corridor):
    again = pickle.loads(pickle.dumps(corridor))
    assert again.states == corridor.states
    assert again.states.drawn is None
    assert state_name(again.states, 3) == "state 3"


def test_an_array_of_rows_and_columns_is_a_board():
    for task in (table(Slides), cr.from_gymnasium(Slides, discount=0.9, time_limit=30)):
        state = int(task.states.encode(**dict(zip(task.states.names, (1, 2, 0, 3), strict=True))))
        scene = scene_of(task)
        assert scene.text(state) == "1 2\n. 3"
        picture = scene.image(state).astype(int)
        half = picture.shape[0] // 2
        corners = [picture[y : y + half, x : x + half].std() for y in (0, half) for x in (0, half)]
        assert np.argmin(corners) == 2  # the gap is plain


def test_an_episode_keeps_what_the_class_shows(corridor):
    values = np.zeros((2, 10, 2), np.float32)
    values[1, :, 1] = 1
    pair = before_and_after(Snapshots(0, np.array([0, 9]), values), corridor, 0.9)
    after = read_record(EpisodePair, pair.model_dump(mode="json")).after
    texts = [after.drawings[number][0] for number in after.drawn]
    assert texts == ["." * place + "@" + "." * (9 - place) for place in range(10)]
    with Image.open(io.BytesIO(base64.b64decode(after.drawings[3][1]))) as picture:
        assert np.asarray(picture.convert("RGB"))[0, 0].tolist() == [60, 60, 60]
    assert len(pair.before.drawings) <= 40
    assert shown_episode(after, 6)["drawn"] == list(range(10))
    plain_chain = before_and_after(Snapshots(0, np.array([0, 9]), values), corridor.mdp, 0.9)
    assert plain_chain.after.drawings == after.drawings  # its states are the same


def test_a_task_of_many_states_has_an_episode_where_its_class_shows_them():
    task = table(Corridor, 100, length=70)
    values = np.zeros((2, 70, 2), np.float32)
    values[:, :, 1] = 1
    pair = before_and_after(Snapshots(0, np.array([0, 9]), values), task, 0.9)
    assert pair.after.cells.shape == (70, 0)
    assert [number >= 0 for number in pair.after.drawn] == [True] * 40 + [False] * 30
    assert pair.after.drawings[39][0].index("@") == 39
    assert shown_episode(pair.after, 6)["trails"] == []
    text_alone = Episode((), np.zeros(0), np.zeros(1), False, 4.0, ("a", "b"))
    with pytest.raises(SettingError, match="needs pictures"):
        text_alone.save("no.gif")


@pytest.mark.parametrize("drawn", [[0], [0, 1], [0, -2]])
def test_a_record_names_drawings_that_it_has(drawn):
    written = {"cells": [[0], [1]], "returns": [0.0, 1.0], "rewards": [1.0], "terminated": True}
    read_record(EpisodeRecord, {**written, "drawings": [["a", ""]], "drawn": [0, -1]})
    with pytest.raises(ValueError, match="drawn must be"):
        read_record(EpisodeRecord, {**written, "drawings": [["a", ""]], "drawn": drawn})


@pytest.mark.parametrize(("environment", "shown"), [(Corridor, "img"), (Written, "pre")])
def test_a_page_shows_the_picture_or_the_text(environment, shown):
    long = table(environment)
    plan = cr.Curriculum(
        {"short": long.mdp, "long": long},
        [cr.Transfer("short", "long", cr.transfer.identity(long, long.mdp))],
        budget={"short": 300, "long": 900},
    )
    page = Reader(page_of(record("own", {"arm": plan}, 2, moments=3)))
    assert page.problems == []
    own = [(tag, a) for tag, a in page.elements if a.get("class") == "own" and "hidden" not in a]
    assert {tag for tag, _ in own} == {shown}
    assert all(a["src"].startswith("data:image/png;base64,iVBOR") for _, a in own if "src" in a)
    assert ("place 0" in page.words) == (shown == "pre")
