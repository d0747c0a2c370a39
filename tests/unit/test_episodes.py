"""An episode to look at: text for a terminal, a GIF for a file, an image for a notebook."""

import base64
import io
import os
import re
import tracemalloc

import numpy as np
import pytest
from PIL import Image

import curricle as cr
from curricle.errors import SettingError, StoreError
from curricle.pictures import Episode
from curricle.planning import rollout

MAZE = cr.GridWorld(["S.#", "..T"])
WAY = rollout(MAZE, [1, 2, 1, 1, 0])


@pytest.fixture
def episode():
    return Episode.of(MAZE, WAY)


def test_print_draws_each_moment_side_by_side(episode):
    assert str(episode) == (
        "start          1 east, -1     2 south, -1    3 east, +199\n"
        "@.#            S@#            S.#            S.#\n"
        "..T            ..T            .@T            ..@\n"
        "\n"
        "3 steps, return 197, terminated"
    )
    assert repr(episode) == "Episode(3 steps, return 197, terminated)"


def test_no_printed_line_is_wide_and_long_episodes_are_cut(episode):
    maze = cr.GridWorld(["S........T"], time_limit=200)
    stuck = Episode.of(maze, rollout(maze, np.full(10, 3)))
    lines = str(stuck).splitlines()
    assert max(map(len, lines)) <= 96
    assert lines[-2:] == [
        "... and 141 more steps, which a GIF shows",
        "200 steps, return -200, truncated",
    ]
    assert "59 west, -1" in str(stuck)
    assert "60 west" not in str(stuck)


def test_without_drawings_the_steps_are_listed():
    frames = (np.zeros((4, 4, 3), np.uint8),) * 3
    episode = Episode(frames, np.array([[0.5], [1.0]]), np.array([1.0, 0.0]), False, 4.0)
    assert str(episode) == "start         1 [0.5], +1   2 [1.]\n2 steps, return 1, truncated"
    unknown = Episode(frames, np.zeros(0, int), np.array([1.0, 0.0]), False, 4.0)
    assert str(unknown).startswith("start   1, +1   2\n")


def test_a_gif_shows_each_moment_in_its_colours(episode, tmp_path):
    file = episode.save(tmp_path / "new" / "maze.GIF", fps=5)
    with Image.open(file) as picture:
        assert (picture.format, picture.n_frames) == ("GIF", 4)
        for place, frame in enumerate(episode.frames):
            picture.seek(place)
            shown = np.asarray(picture.convert("RGB")).astype(int)[: len(frame), : len(frame[0])]
            assert abs(shown - frame).max() < 48
            assert abs(shown - frame).mean() < 1
            assert picture.info["duration"] == (1000 if place == 3 else 200)
            said = np.asarray(picture.convert("L"))[len(frame) :]  # the step, reward and return
            assert said.shape[0] > 16
            assert np.ptp(said) > 150
    assert file.read_bytes() == episode.save(tmp_path / "again.gif", fps=5).read_bytes()
    html = episode._repr_html_()  # a notebook gets it too
    assert html.startswith('<img alt="Episode(3 steps, return 197, terminated)" ')
    code = re.search(r'src="data:image/gif;base64,([\w+/=]+)">$', html)[1]
    with Image.open(io.BytesIO(base64.b64decode(code))) as picture:
        assert picture.n_frames == 4


def test_pictures_are_drawn_when_asked_for():
    maze = cr.GridWorld(["." * 9 + "T"] * 9 + ["S" + "." * 9], time_limit=2000)
    tracemalloc.start()
    long = Episode.of(maze, rollout(maze, np.full(maze.states.size, 3)))
    assert len(long.frames) == len(long.texts) == 2001
    assert long.frames[1000].shape == (648, 648, 3)
    assert len(long.frames[5:9]) == 4
    assert tracemalloc.get_traced_memory()[1] < 30e6
    tracemalloc.stop()


def test_what_cannot_be_written_leaves_nothing_half_done(episode, tmp_path, monkeypatch):
    with pytest.raises(SettingError, match=r"must end in .gif: got 'maze.png'"):
        episode.save(tmp_path / "maze.png")
    with pytest.raises(SettingError, match="fps"):
        episode.save(tmp_path / "maze.gif", fps=-1)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"cannot be written to .*maze.gif: No space left"):
        episode.save(tmp_path / "maze.gif")
    assert not list(tmp_path.iterdir())
