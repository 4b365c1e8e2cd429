import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from robot.arm import Arm
from robot.collision import WORLD, CollisionModel
from robot.execution import perform
from robot.obstacles import around, on_the_arm, reconstructed, split, unseen
from robot.planner import plan
from robot.world import World
from scene.surface.space import FREE, OCCUPIED, UNSEEN, Space
from teach.basis import SquaredExponential
from teach.trajectory import Skill, TrajectoryDistribution


@pytest.fixture(scope="module")
def arm():
    return Arm.load("panda")


def space(label=FREE):
    return Space(np.array([-0.2, -0.6, -0.2]), 0.05, np.full((24, 24, 24), label, np.uint8))


def capture(folder, *boxes):
    for i, (size, position) in enumerate(boxes):
        (folder / "collision").mkdir(exist_ok=True)
        trimesh.creation.box(size).apply_translation(position).export(folder / "collision" / f"piece{i:03d}.obj")
    return folder


def test_pieces_stand_in_the_world_where_the_mesh_has_them(tmp_path, arm):
    folder = capture(tmp_path, ([0.1, 0.2, 0.3], [0.5, 0.1, 0.4]), ([0.1, 0.1, 0.1], [0.2, -0.4, 0.6]))
    spec = reconstructed(folder, None, np.zeros((1, 3)), np.zeros((1, 3)))
    same = {"name": "boxes", "objects": [
        {"name": "a", "shape": "box", "size": [0.1, 0.2, 0.3], "position": [0.5, 0.1, 0.4]},
        {"name": "b", "shape": "box", "size": [0.1, 0.1, 0.1], "position": [0.2, -0.4, 0.6]},
    ]}  # fmt: skip
    postures = arm.random(20, 0)
    with World.from_spec(spec, textured=False) as found, World.from_spec(same, textured=False) as true:
        a, b = (CollisionModel(arm, world).measure(postures)[0][:, 0] for world in (found, true))
    np.testing.assert_allclose(a, b, atol=1e-4)


def test_unseen_space_counts_near_the_path_and_not_around_the_arm():
    path, around = np.array([[0.6, 0.0, 0.4], [0.7, 0.0, 0.4]]), np.array([[0.5, 0.0, 0.4]])
    boxes = unseen(space(UNSEEN), path, around, 0.2, 0.15)
    x = np.random.default_rng(0).uniform([0, -0.4, 0], [0.95, 0.5, 0.9], (4000, 3))
    inside = ((x[:, None] > boxes[:, 0]) & (x[:, None] < boxes[:, 1])).all(-1).any(1)
    off = lambda points: np.linalg.norm(x[:, None] - points, axis=-1).min(1)
    slack = 0.05 * np.sqrt(3) / 2
    assert inside[(off(path) < 0.2 - slack) & (off(around) > 0.15 + slack)].all()
    assert not inside[(off(path) > 0.2 + slack) | (off(around) < 0.15 - slack)].any()
    assert len(unseen(space(FREE), path, around, 0.2, 0.15)) == len(unseen(space(OCCUPIED), path, around, 0.2, 0.15)) == 0


def test_boxes_of_unseen_space_are_in_the_way(tmp_path, arm):
    folder = capture(tmp_path, ([0.1, 0.1, 0.1], [2.0, 0.0, 0.0]))
    ahead = arm.fk(arm.home)[:3, 3] + [0.15, 0, 0]
    around = on_the_arm(arm, arm.home)
    for label, clear in ((FREE, True), (UNSEEN, False)):
        spec = reconstructed(folder, space(label), ahead[None], around, near=0.2, free=0.14)
        with World.from_spec(spec, textured=False) as world:
            distance, _ = CollisionModel(arm, world).measure(arm.home)
        assert (distance[0, WORLD] > 0.2) == clear


def test_points_on_the_arm_reach_from_its_base_to_its_links(arm):
    points, frames = on_the_arm(arm, arm.home), arm.link_poses(arm.home)[0][:, :3, 3]
    assert np.linalg.norm(points[:, None] - frames, axis=-1).min(0).max() < 1e-9


def test_without_pieces_it_is_said_how_to_make_them(tmp_path):
    with pytest.raises(FileNotFoundError, match="python -m scene.mesh"):
        reconstructed(tmp_path, None, np.zeros((1, 3)), np.zeros((1, 3)))


def test_a_piece_is_cut_into_what_lies_in_a_box_and_what_does_not():
    rng = np.random.default_rng(3)
    for _ in range(20):
        points, lower = rng.uniform(-1, 1, (12, 3)), rng.uniform(-0.9, 0.2, 3)
        upper = lower + rng.uniform(0.2, 1.0, 3)
        inside, outside = split(points, lower, upper)
        parts = outside + [inside] * (inside is not None)
        assert sum(ConvexHull(part).volume for part in parts) == pytest.approx(ConvexHull(points).volume, rel=1e-6)
        if inside is not None:
            assert (inside >= lower - 1e-9).all() and (inside <= upper + 1e-9).all()


def test_a_box_beside_a_piece_leaves_it_whole():
    points = np.random.default_rng(0).uniform(-1, 1, (12, 3))
    inside, (outside,) = split(points, np.full(3, 2.0), np.full(3, 3.0))
    assert inside is None and outside is points


def test_the_hand_may_touch_what_it_is_to_touch_and_nothing_else_may(tmp_path, arm):
    """One piece of the mesh is both a table and the parcel on it: the hand may come to the parcel, the table stays in its way."""
    folder = capture(tmp_path, ([0.3, 0.8, 0.4], [0.5, 0.0, 0.0]))
    touch = [{"name": "parcel", "lower": [0.3, -0.5, 0.1], "upper": [0.7, 0.5, 0.3]}]
    spec = reconstructed(folder, None, np.zeros((1, 3)), np.zeros((1, 3)), touch=touch, work=tmp_path / "cut")
    assert spec["touch"] == ["parcel_piece000"] and [thing["name"] for thing in spec["objects"]] == ["parcel_piece000", "piece000_0"]
    pose = arm.fk(arm.home)
    pose[:3, 3] = [0.5, 0.0, 0.17]
    q = arm.ik(pose)
    with World.from_spec(spec, textured=False) as world:
        model = CollisionModel(arm, world.obstacles, only=dict.fromkeys(world.obstacles.touch, arm.beside_hand))
        assert CollisionModel(arm, world.obstacles).measure(q)[0][0, WORLD] < 0 < model.measure(q)[0][0, WORLD] < 0.08
        low = arm.ik(pose - np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0.15], [0, 0, 0, 0]]))
        assert model.measure(low)[0][0, WORLD] < 0


def test_boxes_around_things_hold_them_and_nothing_below(tmp_path):
    thing = {"name": "parcel", "shape": "box", "size": [0.2, 0.1, 0.1], "position": [0.5, 0.0, 0.15], "rpy_deg": [0, 0, 90]}
    (box,) = around([thing])
    np.testing.assert_allclose(box["lower"], [0.43, -0.12, 0.1], atol=1e-9)
    np.testing.assert_allclose(box["upper"], [0.57, 0.12, 0.22], atol=1e-9)


def test_a_box_that_is_none_is_said(tmp_path):
    folder = capture(tmp_path, ([0.3, 0.8, 0.4], [0.5, 0.0, 0.0]))
    with pytest.raises(ValueError, match="the box parcel must have lower below upper"):
        reconstructed(folder, None, np.zeros((1, 3)), np.zeros((1, 3)), touch=[{"name": "parcel", "lower": [1, 0, 0], "upper": [0, 1, 1]}])


def test_a_motion_into_a_thing_is_planned_once_that_may_be_touched_and_touches_nothing_else(tmp_path, arm):
    """Pieces a few millimetres larger than the truth, the parcel in one piece with the table, a post beside, unseen space behind."""
    table, parcel, post = ([0.4, 1.0, 0.1], [0.6, 0.0, 0.15]), ([0.1, 0.1, 0.1], [0.6, 0.0, 0.25]), ([0.04, 0.04, 0.4], [0.6, 0.25, 0.4])
    grown = [np.array(table[0]) + 0.006, np.array(post[0]) + 0.006]
    folder = capture(tmp_path, (grown[0], table[1]), ([0.106, 0.106, 0.2], [0.6, 0.0, 0.2]), (grown[1], post[1]))
    labels = np.full((24, 24, 24), FREE, np.uint8)
    labels[18:] = UNSEEN  # x beyond 0.7 m
    t, begin = np.linspace(0, 1, 60)[:, None], arm.fk(arm.home)[:3, 3]
    points = begin + t * ([0.6, 0.0, 0.285] - begin) + 0.1 * np.sin(np.pi * t) * [0, 0, 1]
    weights = np.linalg.lstsq(SquaredExponential(10, 30.0)(t[:, 0]), points, rcond=None)[0]
    into = Skill(TrajectoryDistribution(SquaredExponential(10, 30.0), weights, 1e-6 * np.eye(30)), 3.0)
    boxes = {"parcel": [{"name": "parcel", "lower": [0.52, -0.08, 0.21], "upper": [0.68, 0.08, 0.33]}], "nothing": []}
    plans = {}
    for name, touch in boxes.items():
        found = reconstructed(folder, Space(np.array([-0.2, -0.6, -0.2]), 0.05, labels), points, on_the_arm(arm, arm.home), touch=touch, work=tmp_path / "cut")
        with World.from_spec(found, textured=False) as known:
            plans[name] = plan(into, arm, known.obstacles, samples=3, orientation="down")
    assert not plans["nothing"].feasible and "piece001" in plans["nothing"].sentence
    assert plans["parcel"].feasible
    truth = [{"name": name, "shape": "box", "size": size, "position": at} for name, (size, at) in {"table": table, "parcel": parcel, "post": post}.items()]
    with World.from_spec({"name": "truth", "objects": truth, "touch": ["parcel"]}, textured=False) as world:
        model = CollisionModel(arm, world)
        done = perform(plans["parcel"], arm, world, fps=0)
    assert done.touched == () and done.success
    near, _ = model.measure(plans["parcel"].joints)
    assert near[:, WORLD].min() < 0.0 and model.nearest(plans["parcel"].joints[-1])[1][1] == "parcel"
