"""Letters: each is itself, by whatever size and place, and is written where the world says."""

import numpy as np
import pytest

from conf.writing import nearest, written
from robot import worldfile
from robot.letters import STROKES, letter, on_board
from robot.variation import varied
from teach.scripted import smooth_path


@pytest.mark.parametrize("name", STROKES)
def test_a_letter_on_the_board_looks_like_itself(name):
    path = smooth_path(on_board(name, [0.55, 0.1, 0.4], 0.3))
    np.testing.assert_allclose(path[:, 0], 0.55, atol=1e-9)
    assert nearest(np.column_stack([-path[:, 1], path[:, 2]]))[0] == name


def test_a_letter_that_is_none_is_said():
    with pytest.raises(ValueError, match="no letter 'b'; there are A, B"):
        letter("b")
    spec = worldfile.read("board")
    with pytest.raises(ValueError, match="no letter '?5'?"):
        worldfile.check(spec | {"motion": spec["motion"] | {"letter": 5}})


def test_the_letter_follows_the_board(monkeypatch):
    spec = worldfile.read("board")
    moved = varied(spec | {"seed": 4})["motion"]
    assert len(varied(spec)["motion"]["via"]) == len(moved["via"]) > len(spec["motion"]["via"])
    own = np.array(varied(spec)["motion"]["via"])[-5:]
    np.testing.assert_allclose(np.ptp(own, axis=0)[2], np.ptp(np.array(moved["via"])[-5:], axis=0)[2], atol=1e-9)
    assert moved["right"][2] == 0 and np.linalg.norm(moved["right"]) == pytest.approx(1)


def test_a_letter_as_it_was_meant_is_right_and_no_farther_than_its_oracle():
    motion = varied(worldfile.read("board"))["motion"]
    path = smooth_path(motion["via"])
    rated = written(motion, path + [0, 0, 0.004], path, np.stack([path, path + [0, 0.02, 0]]))
    assert rated["right"] and rated["looks_like"] == "Z"
    assert rated["to_planned_mm"] == pytest.approx(4, abs=0.1) and rated["to_intended_mm"] == pytest.approx(4, abs=1)
    assert rated["oracle_to_intended_mm"] == pytest.approx(10, abs=1)
