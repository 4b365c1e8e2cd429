from dataclasses import replace

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach import hand, scripted
from teach.align import common_times
from teach.bundle import COUNT, ViewedStroke
from teach.consensus import consensus
from teach.metrics import frechet
from teach.sketch import SketchError

BOARD = np.array([0.55, 0.0, 0.45])
PERSON = hand.Hand(tremor=0.001, speed=(0.6, 0.6))


def motion(rng):
    via = BOARD + 0.15 * np.cumsum(rng.normal(0, 1, (5, 3)), axis=0)
    return via + BOARD - via.mean(axis=0)


def ring(rng, count):
    azimuths = rng.uniform(0, 2 * np.pi) + np.cumsum(np.radians(rng.uniform(40, 80, count)))
    eyes = [BOARD + [1.6 * np.cos(a), 1.6 * np.sin(a), rng.uniform(0.3, 0.9)] for a in azimuths]
    return [Camera.from_fov(look_at(eye, BOARD), 640, 480, 60) for eye in eyes]


def drawn(seed, count, person=PERSON):
    """A generator, the sketches of a random motion on ``count`` views, and its via points."""
    for attempt in range(100):
        rng = np.random.default_rng([11, seed, attempt])
        via, cameras = motion(rng), ring(rng, count)
        try:
            return rng, [scripted.sketch(f"v{k}", c, via, person, rng)[0] for k, c in enumerate(cameras)], via
        except SketchError:
            continue  # outside of a picture
    raise AssertionError("no motion fits into its pictures")


def moved(sketch, change):
    return replace(sketch, strokes=tuple(replace(stroke, points=change(stroke.points)) for stroke in sketch.strokes))


def shifted(sketch):
    return moved(sketch, lambda points: points + [0.15 * sketch.camera.width, 0])


def mirrored(sketch):
    middle = np.mean(np.concatenate([stroke.points for stroke in sketch.strokes])[:, 0])
    return moved(sketch, lambda points: points * [-1, 1] + [2 * middle, 0])


def with_one(sketches, number, change):
    return [change(sketch) if k == number else sketch for k, sketch in enumerate(sketches)]


def views(sketches):
    from teach.align import arc_length, viewed

    return [viewed(sketch, [arc_length(stroke) for stroke in sketch.motions]) for sketch in sketches]


@pytest.mark.parametrize("count", [3, 4])
def test_honest_views_agree(count):
    assert common_times(drawn(1, count)[1]).agree.all()


@pytest.mark.parametrize("change", [shifted, mirrored])
def test_the_view_that_contradicts_three_others_is_found_and_they_are_as_if_it_were_not_there(change):
    _, sketches, _ = drawn(3, 4)
    found = consensus(views(with_one(sketches, 1, change)))
    assert found.agree.tolist() == [True, False, True, True] and found.off[1] > 3 * found.off[[0, 2, 3]].max()
    alone = consensus(views(sketches[:1] + sketches[2:]))
    assert np.abs(found.bundle.points - alone.bundle.points).max() < 0.01


def test_of_three_views_the_shifted_one_is_found():
    _, sketches, _ = drawn(2, 3)
    assert common_times(with_one(sketches, 0, shifted)).agree.tolist() == [False, True, True]


def test_views_that_must_not_be_left_out_are_kept():
    _, sketches, _ = drawn(2, 3)
    assert consensus(views(with_one(sketches, 0, shifted)), robust=False).agree.all()


def test_the_worlds_place_and_size_do_not_matter():
    seen = views(drawn(4, 2)[1])
    frame = np.diag([50.0, 50.0, 50.0, 1.0])
    frame[:3, 3] = [3000.0, -2000.0, 100.0]
    far = [replace(view, camera=view.camera.moved(frame)) for view in seen]
    here, there = consensus(seen).bundle.points, consensus(far).bundle.points
    assert np.abs((there - frame[:3, 3]) / 50 - here).max() < 1e-4


def test_a_motion_straight_at_a_camera_contradicts_nobody():
    rng = np.random.default_rng(0)
    cameras = ring(rng, 3)
    toward = (BOARD - cameras[0].centre) / np.linalg.norm(BOARD - cameras[0].centre)
    line = BOARD + np.linspace(-0.15, 0.15, COUNT)[:, None] * toward
    strokes = [c.project(line) + rng.normal(0, 1, (2, COUNT, 2)) for c in cameras]
    assert consensus([ViewedStroke.of(c, pair) for c, pair in zip(cameras, strokes)]).agree.all()


def test_no_motion_in_front_of_the_cameras_is_told():
    seen = views(drawn(1, 2)[1])
    turned = seen[0].camera.world_from_camera.copy()
    turned[:3, :3] = turned[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    behind = replace(seen[0], camera=replace(seen[0].camera, world_from_camera=turned))
    with pytest.raises(SketchError, match="no one motion in front"):
        consensus([behind, seen[1]])


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4])
def test_contradictory_sketches_are_named_and_cost_no_accuracy_over_20_seeds(count):
    named, fine, total = 0, 0, 0
    for seed in range(20):
        rng, sketches, via = drawn(seed, count)
        bad, truth = int(rng.integers(count)), scripted.smooth_path(via, 100)
        for change in (shifted, mirrored):
            found = consensus(views(with_one(sketches, bad, change)))
            alone = consensus(views(sketches[:bad] + sketches[bad + 1 :]))
            named += np.flatnonzero(~found.agree).tolist() == [bad]
            fine += frechet(found.bundle.points, truth) < 1.3 * frechet(alone.bundle.points, truth)
            total += 1
    assert min(named, fine) >= {3: 0.7, 4: 0.95}[count] * total


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1, 2])
def test_honest_views_are_hardly_ever_called_contradictory(factor):
    alarms = sum(not common_times(drawn(seed, 4, hand.scaled(PERSON, factor))[1]).agree.all() for seed in range(20))
    assert alarms == 0
