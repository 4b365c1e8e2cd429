"""Distances of convex pieces from their supports: closed forms, and where FCL stops early."""

import fcl
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot import shapes
from robot.separation import Solid, distance, gap, support


def pose(at=(0, 0, 0), turn=(0, 0, 0)):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", turn).as_matrix(), at
    return T


PIECES = {
    "box": shapes.box("b", [0.3, 0.1, 0.02], np.eye(4)),
    "sphere": shapes.sphere("s", 0.05, np.eye(4)),
    "cylinder": shapes.cylinder("c", 0.05, 0.3, np.eye(4)),
    "capsule": shapes.capsule("k", 0.05, 0.3, np.eye(4)),
    "mesh": shapes.convex("m", np.random.default_rng(0).normal(size=(30, 3)) * 0.1, np.eye(4)),
}


@pytest.mark.parametrize("name", PIECES)
def test_the_support_is_the_farthest_point(name):
    T, rng = pose((0.1, -0.2, 0.3), (0.4, 0.5, -0.6)), np.random.default_rng(1)
    piece = Solid(PIECES[name]).arrays(T)
    points = np.array([support(*piece, n) for n in rng.normal(size=(300, 3))])
    for n in rng.normal(size=(20, 3)):
        assert (points @ n).max() <= support(*piece, n) @ n + 1e-12
    lengths = {"box": [0.3, 0.1, 0.02], "sphere": [0.1] * 3, "cylinder": [0.1, 0.1, 0.3], "capsule": [0.1, 0.1, 0.4]}
    for axis, length in zip(T[:3, :3].T, lengths.get(name, [])):
        assert (support(*piece, axis) - support(*piece, -axis)) @ axis == pytest.approx(length)


@pytest.mark.parametrize("first", PIECES)
@pytest.mark.parametrize("second", PIECES)
def test_distance_and_room_between_agree_with_fcl_where_that_is_right(first, second):
    rng, right = np.random.default_rng(2), 0
    for _ in range(30):
        A, B = pose(turn=rng.uniform(-3, 3, 3)), pose(rng.uniform(-0.6, 0.6, 3), rng.uniform(-3, 3, 3))
        a, b = Solid(PIECES[first]).arrays(A), Solid(PIECES[second]).arrays(B)
        placed = ((first, A), (second, B))
        objects = [fcl.CollisionObject(PIECES[n].geometry, fcl.Transform(T[:3, :3], T[:3, 3])) for n, T in placed]
        theirs = max(fcl.distance(*objects, fcl.DistanceRequest(enable_signed_distance=True), fcl.DistanceResult()), 0.0)
        ours = distance(a, b)
        assert ours <= theirs + 2e-4
        right += abs(ours - theirs) < 2e-4
        for n in rng.normal(size=(5, 3)):
            assert gap(*a, *b, *n) <= ours + 1e-5
    assert right >= 28


def test_boxes_apart_along_an_axis_have_that_distance():
    box = Solid(PIECES["box"])
    assert distance(box.arrays(pose()), box.arrays(pose((0.5, 0.02, 0)))) == pytest.approx(0.2, abs=2e-5)
    assert distance(box.arrays(pose()), box.arrays(pose((0.1, 0.02, 0)))) == pytest.approx(0, abs=2e-5)
