import numpy as np
import pytest

from teach.align import COUNT, common_times
from teach.lag import at
from teach.likelihood import DRIFT, PEOPLE
from teach.repeats import lags_of_repeats
from teach.sketch import Sketch, Stroke
from tests.test_epipolar import CAMERAS

U = np.linspace(0, 1, COUNT)


def angle(first: float) -> np.ndarray:
    """(COUNT, 2) [px] at even arc length: two arms with a corner after ``first`` of the way."""
    along = np.linspace(0, 300, COUNT)
    return np.stack([100 + np.minimum(along, 300 * first), 200 + np.maximum(along - 300 * first, 0)], axis=1)


def test_corners_that_come_sooner_or_later_are_the_same_moment():
    strokes = [angle(first) for first in (0.42, 0.5, 0.58)]
    lags = lags_of_repeats(strokes)
    corners = [float(np.interp(0.5, U, U + lag)) for lag in lags]
    assert corners == pytest.approx([0.42, 0.5, 0.58], abs=0.025)
    together = np.mean([at(stroke, U + lag) for stroke, lag in zip(strokes, lags, strict=True)], axis=0)
    blunt = np.mean(strokes, axis=0)
    corner = np.mean([[100 + 300 * first, 200] for first in (0.42, 0.5, 0.58)], axis=0)
    off = [np.linalg.norm(mean - corner, axis=1).min() for mean in (together, blunt)]
    assert off[0] < 5 and off[1] > 7


def test_lags_are_zero_at_both_ends_and_on_average():
    lags = lags_of_repeats([angle(first) for first in (0.4, 0.45, 0.6)])
    assert np.abs(lags[:, [0, -1]]).max() < 1e-12 and np.abs(lags.mean(axis=0)).max() < 1e-12


@pytest.mark.parametrize("strokes", [[angle(0.5)], [angle(0.5)] * 3, [angle(0.5), angle(0.5) + 20, 0.8 * angle(0.5)]])
def test_place_and_size_make_no_lag(strokes):
    assert np.abs(lags_of_repeats(strokes)).max() < 0.005


def test_drift_is_what_is_seen_drawn_towards_what_people_do():
    even = Sketch("a", CAMERAS[0], tuple(Stroke(angle(0.5) + k, U) for k in range(3)))
    uneven = Sketch("a", CAMERAS[0], tuple(Stroke(angle(first), U) for first in (0.42, 0.5, 0.58)))
    other = Sketch("b", CAMERAS[1], (Stroke(angle(0.5), U),))
    calm, wild = (common_times([sketch, other]).drift for sketch in (even, uneven))
    assert calm == pytest.approx(DRIFT * (PEOPLE / (2 + PEOPLE)) ** 0.5, rel=0.1) and wild > 3 * calm  # two free strokes saw none
    assert common_times([uneven, other], "arc_length").drift == 0
