"""Clearances against closed forms, and sweeps that skip nothing."""

from types import SimpleNamespace

import numpy as np
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from robot import shapes
from robot.arm import Arm
from robot.collision import CollisionModel
from robot.world import World
from teach.hull import Region

CAP = 0.3


@pytest.fixture
def world():
    client = BulletClient(pybullet.DIRECT)
    yield SimpleNamespace(client=client, bodies={})
    client.disconnect()


def add(world, name, position, quat_xyzw=(0, 0, 0, 1), **shape):
    world.bodies[name] = world.client.createMultiBody(
        0, world.client.createCollisionShape(**shape), -1, position, quat_xyzw
    )


def gantry(folder, geometry):
    """An arm that carries one shape along x, y and z."""
    slides = "".join(
        f'<link name="{axis}"/>'
        if axis != "z"
        else f'<link name="z"><collision><geometry>{geometry}</geometry></collision></link>'
        for axis in "xyz"
    )
    joints = "".join(
        f'<joint name="j{axis}" type="prismatic"><parent link="{parent}"/><child link="{axis}"/><axis xyz="{along}"/>'
        f'<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
        for parent, axis, along in (("base", "x", "1 0 0"), ("x", "y", "0 1 0"), ("y", "z", "0 0 1"))
    )
    path = folder / "gantry.urdf"
    path.write_text(f'<robot name="gantry"><link name="base"/>{slides}{joints}</robot>')
    return Arm.from_urdf(path, tip_link="z", home=[2, 2, 2])


def box_distance(x, half):
    outside = np.abs(x) - half
    return np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(axis=-1), 0)


def assert_clearance(model, q, truth):
    np.testing.assert_allclose(model.clearance(q), np.minimum(truth, CAP), atol=1e-3)


SPHERE = '<sphere radius="0.05"/>'


def positions(count=2500, seed=0):
    return np.random.default_rng(seed).uniform(-0.45, 0.45, (count, 3))


def test_a_ball_is_as_far_from_a_turned_box_as_the_closed_form(tmp_path, world):
    turn, at, half = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]), np.array([0.1, 0, -0.1]), np.array([0.2, 0.05, 0.1])
    add(world, "box", at, turn.as_quat(), shapeType=pybullet.GEOM_BOX, halfExtents=half)
    q = positions()
    assert_clearance(
        CollisionModel(gantry(tmp_path, SPHERE), world), q, box_distance(turn.inv().apply(q - at), half) - 0.05
    )


def test_a_ball_is_as_far_from_a_cylinder_as_the_closed_form(tmp_path, world):
    add(world, "can", [0, 0.1, 0], shapeType=pybullet.GEOM_CYLINDER, radius=0.06, height=0.2)
    q = positions()
    x = q - [0, 0.1, 0]
    truth = box_distance(np.column_stack([np.linalg.norm(x[:, :2], axis=1), x[:, 2]]), [0.06, 0.1]) - 0.05
    assert_clearance(CollisionModel(gantry(tmp_path, SPHERE), world), q, truth)


def test_a_ball_is_as_far_from_balls_capsules_and_the_floor_as_the_closed_form(tmp_path, world):
    add(world, "ball", [0.2, 0, 0.1], shapeType=pybullet.GEOM_SPHERE, radius=0.08)
    add(world, "capsule", [-0.2, 0, 0], shapeType=pybullet.GEOM_CAPSULE, radius=0.03, height=0.2)
    add(world, "floor", [0, 0, -0.4], shapeType=pybullet.GEOM_PLANE)
    q = positions()
    x = q - [-0.2, 0, 0]
    along = np.maximum(np.abs(x[:, 2]) - 0.1, 0)
    capsule = np.sqrt((x[:, :2] ** 2).sum(axis=1) + along**2) - 0.03
    truth = np.minimum.reduce([np.linalg.norm(q - [0.2, 0, 0.1], axis=1) - 0.08, capsule, q[:, 2] + 0.4]) - 0.05
    assert_clearance(CollisionModel(gantry(tmp_path, SPHERE), world), q, truth)


def test_a_capsule_is_as_far_from_a_crossing_capsule_as_the_closed_form(tmp_path, world):
    add(
        world,
        "bar",
        [0, 0, 0],
        Rotation.from_euler("y", 90, degrees=True).as_quat(),
        shapeType=pybullet.GEOM_CAPSULE,
        radius=0.04,
        height=0.3,
    )
    q = positions()
    gap = np.column_stack([np.maximum(np.abs(q[:, 0]) - 0.15, 0), q[:, 1], np.maximum(np.abs(q[:, 2]) - 0.1, 0)])
    apart = np.linalg.norm(gap, axis=1) > 1e-3  # where the axes meet the depth depends on the direction out
    model = CollisionModel(gantry(tmp_path, '<capsule radius="0.03" length="0.2"/>'), world)
    assert_clearance(model, q[apart], (np.linalg.norm(gap, axis=1) - 0.07)[apart])


def test_boxes_are_as_far_apart_or_as_deep_as_the_closed_form(tmp_path, world):
    add(world, "box", [0, 0, 0], shapeType=pybullet.GEOM_BOX, halfExtents=[0.2, 0.05, 0.1])
    q = positions()
    model = CollisionModel(gantry(tmp_path, '<box size="0.1 0.2 0.06"/>'), world)
    assert_clearance(model, q, box_distance(q, np.array([0.25, 0.15, 0.13])))


def test_a_mesh_is_its_convex_hull(tmp_path, world):
    corners = (np.array(np.meshgrid(*[[0, 1]] * 3)).reshape(3, -1).T * [0.2, 0.1, 0.1]).tolist()
    turn = Rotation.from_euler("z", 0.7)
    add(world, "mesh", [0.1, 0.1, 0], turn.as_quat(), shapeType=pybullet.GEOM_MESH, vertices=corners)
    q = positions()
    x = turn.inv().apply(q - [0.1, 0.1, 0]) - [0.1, 0.05, 0.05]
    assert_clearance(
        CollisionModel(gantry(tmp_path, SPHERE), world), q, box_distance(x, np.array([0.1, 0.05, 0.05])) - 0.05
    )


def box_region(name, at, lengths):
    corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    return Region(name, ((at + corners * np.asarray(lengths) / 2, ConvexHull(corners).simplices),))


@pytest.mark.parametrize("with_world", [True, False])
def test_a_ball_is_as_far_from_a_region_as_from_a_body_of_its_shape(tmp_path, world, with_world):
    at, lengths = np.array([0.1, 0, -0.1]), np.array([0.3, 0.1, 0.2])
    model = CollisionModel(gantry(tmp_path, SPHERE), world if with_world else None, [box_region("region", at, lengths)])
    q = positions()
    assert_clearance(model, q, box_distance(q - at, lengths / 2) - 0.05)


def test_a_region_of_several_pieces_is_as_far_as_its_nearest(tmp_path):
    halves = [box_region("region", np.array([x, 0, 0]), [0.1, 0.1, 0.1]).pieces[0] for x in (-0.1, 0.2)]
    model = CollisionModel(gantry(tmp_path, SPHERE), regions=[Region("region", tuple(halves))])
    q, half = positions(), np.full(3, 0.05)
    nearest = np.minimum(*(box_distance(q - [x, 0, 0], half) for x in (-0.1, 0.2)))
    assert_clearance(model, q, nearest - 0.05)
    assert model.nearest([0.2, 0, 0.12])[1] == ("z", "region")


def test_the_base_may_stand_in_a_region_but_the_hand_may_not_touch_it():
    arm = Arm.load("panda")
    model = CollisionModel(arm, regions=[box_region("region", np.zeros(3), [0.2, 0.2, 0.4])])
    assert {model.names[a] for a, b in model._pairs if model.names[b] == "region"} >= {"panda_hand", "panda_link1"}
    assert not any(model.names[a] == "panda_link0" for a, b in model._pairs if model.names[b] == "region")


def test_the_balls_contain_their_piece():
    rng = np.random.default_rng(0)
    for piece in (
        shapes.box("b", [0.3, 0.1, 0.02], np.eye(4)),
        shapes.cylinder("c", 0.05, 0.3, np.eye(4)),
        shapes.convex("h", rng.normal(size=(30, 3)) * 0.1, np.eye(4)),
    ):
        weights = rng.dirichlet(np.full(len(piece.vertices), 0.2), 3000)
        points = shapes.transform(piece.frame_from_piece, weights @ piece.vertices)
        balls = piece.cover()
        depth = balls[:, 3] - np.linalg.norm(points[:, None] - balls[:, :3], axis=2)
        assert depth.max(axis=1).min() >= 0


def test_the_fast_bound_never_hides_a_nearer_pair(world):
    arm = Arm.load("panda")
    for k, at in enumerate(np.random.default_rng(1).uniform([-0.6, -0.6, 0], [0.6, 0.6, 0.9], (8, 3))):
        add(world, f"box{k}", at, shapeType=pybullet.GEOM_BOX, halfExtents=[0.05, 0.03, 0.1])
    model = CollisionModel(arm, world)
    q = arm.random(40, seed=2)
    exact = []
    for poses in arm.link_poses(q):
        placed = {}
        exact.append(min(model._distance(a, b, poses, placed) for a, b in model._pairs))
    np.testing.assert_allclose(model.clearance(q), np.minimum(exact, CAP), atol=1e-6)


def test_the_arm_is_clear_of_itself_at_home_and_touches_itself_when_folded():
    model = CollisionModel(Arm.load("panda"))
    assert model.clearance(model.arm.home) > 0.015
    clearance, (a, b) = model.nearest([0, 1.7, 0, -3.05, 0, 0.0, 0])
    assert clearance < 0 and a.startswith("panda") and b.startswith("panda")


def test_neighbours_are_not_compared():
    pairs = CollisionModel(Arm.load("panda")).own_pairs
    assert ("panda_link1", "panda_link2") not in pairs and ("panda_hand", "panda_leftfinger") not in pairs
    assert ("panda_link6", "panda_hand") not in pairs and ("panda_link1", "panda_hand") in pairs


def test_the_base_may_stand_in_a_pedestal_but_the_hand_may_not_touch_it(world):
    add(world, "pedestal", [0, 0, -0.2], shapeType=pybullet.GEOM_BOX, halfExtents=[0.2, 0.2, 0.25])
    model = CollisionModel(Arm.load("panda"), world)
    assert model.clearance(model.arm.home) > 0.015
    assert any("pedestal" in (model.names[b],) and model.names[a] == "panda_hand" for a, b in model._pairs)


def test_the_nearest_pair_is_named(world):
    arm = Arm.load("panda")
    add(world, "pole", arm.fk(arm.home)[:3, 3] + [0, 0, -0.03], shapeType=pybullet.GEOM_SPHERE, radius=0.03)
    clearance, names = CollisionModel(arm, world).nearest(arm.home)
    assert names[1] == "pole" and "finger" in names[0] and clearance < 0.02


@pytest.mark.parametrize("at", [0.3, 0.4111, 0.6])
def test_a_thin_pole_between_two_waypoints_is_not_skipped(world, at):
    arm = Arm.load("panda")
    path = np.stack([arm.home, arm.home + [1.5, 0, 0, 0, 0, 0, 0]])
    through = arm.fk(path[0] + at * (path[1] - path[0]))[:3, 3]
    add(world, "pole", through + [0, 0, 0.02], shapeType=pybullet.GEOM_CYLINDER, radius=0.005, height=0.1)
    model = CollisionModel(arm, world)
    assert model.clearance(path).min() > 0
    sweep = model.sweep(path)
    assert sweep.clearance[0] < 0 and "pole" in sweep.pairs[0]


def test_a_swept_clearance_bounds_every_posture_on_the_way_and_is_sharp(world):
    arm = Arm.load("panda")
    add(world, "post", [0.45, 0.2, 0.3], shapeType=pybullet.GEOM_BOX, halfExtents=[0.02, 0.02, 0.3])
    model = CollisionModel(arm, world)
    path = np.stack([arm.home, arm.home + [0.25, 0, 0, 0.1, 0, 0, 0.3], arm.home + [-0.4, 0.2, 0, 0, 0, 0, 0]])
    for k, bound in enumerate(model.sweep(path, required=0.25).clearance):
        fine = path[k] + np.linspace(0, 1, 200)[:, None] * (path[k + 1] - path[k])
        assert bound <= model.clearance(fine).min() + 1e-9
    sharp = model.sweep(path, required=0.005, resolution=1e-4).clearance
    assert (sharp > 0.005 - 2e-4).all()


def test_a_path_with_room_is_certified(world):
    arm = Arm.load("panda")
    add(world, "wall", [0.9, 0, 0.5], shapeType=pybullet.GEOM_BOX, halfExtents=[0.02, 1, 1])
    path = arm.home + np.linspace(0, 1, 20)[:, None] * np.array([0.5, 0, 0, 0, 0, 0, 0])
    assert CollisionModel(arm, world).sweep(path, required=0.01).clearance.min() >= 0.01


def test_a_region_may_bind_one_link_alone():
    arm = Arm.load("panda")
    elbow = arm.link_poses(arm.home)[0, arm.link_names.index("panda_link4"), :3, 3]
    region = box_region("elbow's", elbow, [0.1, 0.1, 0.1])
    assert CollisionModel(arm, regions=[region]).nearest(arm.home)[0] < 0
    assert CollisionModel(arm, regions=[region], only={"elbow's": ["panda_link4"]}).nearest(arm.home)[1][0] == "panda_link4"
    hand_only = CollisionModel(arm, regions=[region], only={"elbow's": ["panda_hand"]})
    assert hand_only.measure(arm.home)[0][0, 0] > 0.1
    assert {hand_only.names[a] for a, b in hand_only._pairs if hand_only.names[b] == "elbow's"} == {"panda_hand"}


def test_a_region_or_link_that_is_not_there_is_said():
    arm, region = Arm.load("panda"), box_region("here", np.ones(3), [0.1, 0.1, 0.1])
    with pytest.raises(ValueError, match="names 'elbow'; there are here, panda_link0"):
        CollisionModel(arm, regions=[region], only={"here": ["elbow"]})
    with pytest.raises(ValueError, match="names 'there'"):
        CollisionModel(arm, regions=[region], only={"there": ["panda_hand"]})
    with pytest.raises(ValueError, match="'cup' cannot be held; there are no bodies"):
        CollisionModel(arm, held={"cup": arm.home})


def test_a_held_thing_goes_with_the_hand_and_counts_as_part_of_it(world):
    arm = Arm.load("panda")
    tip = arm.fk(arm.home)[:3, 3]
    add(world, "stick", tip - [0, 0, 0.10], shapeType=pybullet.GEOM_CYLINDER, radius=0.01, height=0.25)
    add(world, "wall", tip + [0, 0.3, -0.2], shapeType=pybullet.GEOM_BOX, halfExtents=[0.3, 0.01, 0.05])
    add(world, "floor", tip - [0, 0, 0.2255], shapeType=pybullet.GEOM_BOX, halfExtents=[0.05, 0.05, 0.0005])
    turned = arm.home + [0.6, 0, 0, 0, 0, 0, 0]
    alone = CollisionModel(arm, world, ignored=[("panda_leftfinger", "stick"), ("panda_rightfinger", "stick"), ("panda_hand", "stick")])
    model = CollisionModel(arm, world, held={"stick": arm.home}, margin=0.01)
    assert model.clearance(arm.home) > 0.01  # as near to the floor as where it was grasped, which is allowed
    sweep = model.sweep(np.stack([arm.home, arm.home + [1.4, 0, 0, 0, 0, 0, 0]]))
    assert sweep.clearance[0] < 0 and sweep.pairs[0] == ("stick", "wall")
    assert alone.sweep(np.stack([arm.home, arm.home + [1.4, 0, 0, 0, 0, 0, 0]])).clearance[0] > 0
    down = arm.fk(arm.home) - np.array([[0, 0, 0, 0]] * 2 + [[0, 0, 0, 0.005], [0, 0, 0, 0]])
    q = arm.ik(down, start=arm.home)
    clearance, names = model.nearest(q)
    assert names == ("stick", "floor") and clearance == pytest.approx(0.006, abs=1e-3)
    _, pairs, gaps, _ = model.close(turned[None], 0.3)
    gap = gaps[[(model.names[a], model.names[b]) == ("stick", "wall") for a, b in model._pairs[pairs]]]
    moved = np.linalg.inv(arm.fk(arm.home))[:3] @ np.append(tip - [0, 0, 0.1], 1)
    at = (arm.fk(turned) @ np.append(moved, 1))[:3]
    assert gap[0] == pytest.approx(tip[1] + 0.29 - at[1] - 0.01, abs=2e-3)


def test_all_near_pairs_are_given_with_their_clearance(world):
    arm = Arm.load("panda")
    add(world, "post", [0.45, 0.2, 0.3], shapeType=pybullet.GEOM_BOX, halfExtents=[0.02, 0.02, 0.3])
    model, q = CollisionModel(arm, world), arm.random(30, seed=5)
    rows, pairs, clearance, _ = model.close(q, 0.2)
    for n in range(len(q)):
        smallest = clearance[rows == n].min(initial=0.2)
        assert smallest == pytest.approx(min(model.clearance(q[n]), 0.2), abs=1e-9)
    assert (clearance < 0.2).all() and model.of_world(pairs).any()


@pytest.mark.parametrize("name", ["panda", "aliengo_z1"])
def test_the_gradient_of_a_clearance_is_that_of_its_differences(world, name):
    arm = Arm.load(name)
    add(world, "post", [0.45, 0.2, 0.3], shapeType=pybullet.GEOM_BOX, halfExtents=[0.1, 0.1, 0.3])
    model, q, small = CollisionModel(arm, world), arm.random(40, seed=5), 1e-5
    rows, pairs, clearance, gradient = model.close(q, 0.1)
    measured = np.zeros_like(gradient)
    for joint in range(q.shape[1]):
        away = small * np.eye(q.shape[1])[joint]
        ahead, behind = (model._slopes(arm.link_poses(q[rows] + side), np.arange(len(rows)), pairs)[0] for side in (away, -away))
        measured[:, joint] = (ahead - behind) / (2 * small)
    off = np.abs(measured - gradient).max(axis=1)
    assert (clearance < 0).any() and model.of_world(pairs).any() and not model.of_world(pairs).all()
    assert np.mean(off < 0.01) > 0.95  # a corner passes from one face to another here and there


def test_what_stands_beside_a_point_is_told_by_its_distance():
    box = lambda name, x: {"name": name, "shape": "box", "size": [0.2, 0.2, 0.2], "position": [x, 0, 0]}
    with World.from_spec({"name": "w", "objects": [box("a", 0.5), box("b", 0.8)]}, textured=False) as world:
        model = CollisionModel(Arm.load("z1"), world)
    assert model.beside([0.62, 0, 0], 0.03) == ["a"] and model.beside([0.65, 0, 0], 0.06) == ["a", "b"] and model.beside([0.65, 0, 0], 0.04) == []
