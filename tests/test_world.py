"""Worlds: built as their files say, photographed where cameras stand, and refused where files are wrong."""

import copy
import hashlib
import json
from itertools import pairwise, product
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from robot import thing as things
from robot import worldfile
from robot.photographs import hemisphere, sketch_views
from robot.shapes import body_pieces
from robot.standing import free
from robot.thing import placed
from robot.variation import pre_grasp, varied
from robot.world import World
from scene.camera import Camera, look_at

MARKER = {"name": "marker", "shape": "box", "size": [0.02, 0.02, 0.02], "position": [0.1, -0.05, 0.2]}
PLAIN = {"name": "plain", "objects": [MARKER], "view": {"target": [0, 0, 0]}}


def camera_at(eye, target=(0, 0, 0), K=None):
    camera = Camera.from_fov(look_at(eye, target), 320, 240, 50)
    return camera if K is None else Camera(K, camera.world_from_camera, 320, 240)


@pytest.fixture(scope="module")
def table():
    with World.load("table") as world:
        yield world


@pytest.fixture(scope="module")
def tiny():
    with World.load("tiny") as world:
        yield world


def test_the_table_stands_as_motionbenchmaker_published_it():
    """facts/worlds.md: full lengths, or height and radius; places [m]."""
    published = {
        "top": ([1.2, 2.0, 0.04], [1.15, 0.10, 0.20]), "Can1": ([0.12, 0.03], [0.95, 0.10, 0.30]),
        "Cube": ([0.25, 0.25, 0.25], [0.85, 0.50, 0.35]), "Object1": ([0.35, 0.05], [1.45, 0.10, 0.35]),
        "Object2": ([0.2, 0.02, 0.4], [1.15, -0.10, 0.40]), "Object3": ([0.02, 0.2, 0.4], [0.75, 0.30, 0.40]),
        "Object4": ([0.2, 0.05, 0.35], [0.75, -0.10, 0.40]), "Object5": ([0.2, 0.05, 0.35], [1.15, 0.30, 0.40]),
    }  # fmt: skip
    with World.load("table", textured=False) as world:
        things = {thing["name"]: thing for thing in world.spec["objects"]}
        for name, (lengths, place) in published.items():
            thing = things[name]
            assert (thing.get("size") or [thing["height"], thing["radius"]]) == lengths, name
            np.testing.assert_allclose(
                world.client.getBasePositionAndOrientation(world.bodies[name])[0], place, atol=1e-9
            )
        legs = {tuple(things[f"leg{i}"]["position"]) for i in (1, 2, 3, 4)}
        assert legs == {(x, y, -0.15) for x in (0.70, 1.60) for y in (0.95, -0.75)}


def test_box_and_shelves_stand_as_motionbenchmaker_published_them():
    published = {
        "box": {"base": ([0.7, 0.7, 0.04], [0.65, 0, -0.58]), "side1": ([0.7, 0.04, 0.7], [0.65, -0.35, -0.22]), "side2": ([0.7, 0.04, 0.7], [0.65, 0.35, -0.22]),
                "front": ([0.04, 0.7, 0.6], [0.30, 0, -0.32]), "back": ([0.04, 0.7, 0.7], [1.00, 0, -0.22]), "lid": ([0.7, 0.7, 0.04], [0.75, 0, 0.33]),
                "Can1": ([0.14, 0.03], [0.65, 0, -0.47])},
        "shelf": {"side1": ([1.3, 0.04, 1.64], [1.3, -0.5, 0.12]), "side2": ([1.3, 0.04, 1.64], [1.3, 0.5, 0.12])}
        | {f"board{k + 1}": ([1.2, 1.0, 0.04], [1.3, 0, z]) for k, z in enumerate((0, 0.3, 0.6, 0.9))}
        | {f"Can{3 * k + j + 1}": ([0.14, 0.03], [x, 0, z]) for k, z in enumerate((0.08, 0.38, 0.68)) for j, x in enumerate((0.8, 1.0, 1.2))},
        "shelf_small": {f"board{k + 1}": ([1.2, 1.0, 0.04], [1.2, 0, z]) for k, z in enumerate((0.3, 0.6))}
        | {f"side{k + 1}": ([1.2, 0.04, 0.34], [1.2, y, 0.45]) for k, y in enumerate((-0.5, 0.5))}
        | {f"Can{k + 1}": ([0.14, 0.03], [x, 0, 0.38]) for k, x in enumerate((0.7, 0.9, 1.1))},
    }  # fmt: skip
    for name, things_of in published.items():
        found = {one["name"]: one for one in worldfile.read(name)["objects"]}
        for thing, (lengths, place) in things_of.items():
            assert (found[thing].get("size") or [found[thing]["height"], found[thing]["radius"]]) == lengths, thing
            assert found[thing]["position"] == place, thing
        assert sum(one["name"].startswith("Can") for one in found.values()) == sum(thing.startswith("Can") for thing in things_of)


@pytest.mark.parametrize("name", worldfile.names())
def test_the_intended_motion_leads_from_the_arms_start_to_the_pre_grasp_point(name):
    from robot.arm import Arm

    spec, arm = worldfile.read(name), Arm.load("panda")
    via = np.array(spec["motion"]["via"])
    np.testing.assert_allclose(via[0], arm.fk(arm.home)[:3, 3], atol=1e-3)
    if "goal" in spec:
        np.testing.assert_allclose(via[-1], pre_grasp(spec), atol=1e-9)


@pytest.mark.parametrize("eye", [(1.0, 0.4, 0.8), (-0.6, -0.7, 0.5), (0.1, 0.2, 1.2)])
@pytest.mark.parametrize("K", [None, [[300, 0, 140], [0, 320, 150], [0, 0, 1]]], ids=["middle", "off the middle"])
def test_a_point_is_seen_where_the_camera_projects_it(eye, K):
    """The middle of a small cube's silhouette, against the middle of its projected corners' hull."""
    with World.from_spec(PLAIN) as world:
        camera = camera_at(eye, MARKER["position"], K)
        _, depth = world.photograph_with_depth(camera)
    corners = np.array(MARKER["position"]) + 0.01 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    pixels = camera.project(corners)
    rows, columns = np.nonzero(np.isfinite(depth))
    seen = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
    np.testing.assert_allclose(seen, [pixels.min(0), pixels.max(0)], atol=1.0)


def test_depth_is_metric_along_the_optical_axis_and_nan_where_nothing_is():
    slab = {"name": "slab", "shape": "box", "size": [2, 2, 0.1], "position": [0, 0, -0.05]}
    with World.from_spec(PLAIN | {"objects": [slab]}) as world:
        camera = camera_at((0.5, -0.4, 1.0), (0.1, 0, 0))
        _, depth = world.photograph_with_depth(camera)
        _, away = world.photograph_with_depth(camera_at((0, 0, 1.0), (0, 0, 2.0)))
    origins, directions = camera.rays(camera.pixel_centres())
    true = -origins[..., 2] / directions[..., 2] * (directions @ camera.forward)
    hit = (np.abs(origins - origins[..., 2:] / directions[..., 2:] * directions)[..., :2] < 0.95).all(-1)
    np.testing.assert_allclose(depth[hit], true[hit], atol=2e-4)
    assert np.isnan(away).all()


def test_the_official_tag_is_seen_upright_at_the_place_it_is_said_to_be(tiny):
    """scene.frame.apriltag finds each tag's corners where the poses put them, in the official order."""
    from scene.frame.apriltag import TagLayout, detect

    camera = Camera.from_fov(look_at([0.1, -0.5, 1.1], [0.62, 0.0, 0.12]), 640, 480, 50)
    layout, found = TagLayout(tiny.tag_size, tiny.base_from_tag), detect(tiny.photograph(camera))
    assert set(found) == {0, 1, 2, 3}
    for number, corners in layout.corners().items():
        np.testing.assert_allclose(found[number], camera.project(corners), atol=0.7)


def test_tag_pictures_are_the_official_ones():
    import cv2

    from robot.skins import tag_cells

    folder = Path(__file__).parents[2] / "shared" / "data" / "tags"
    if not folder.is_dir():
        pytest.skip("the official tag pictures are not here")
    for number in range(8):
        official = cv2.imread(str(folder / f"tag36_11_{number:05d}.png"), cv2.IMREAD_GRAYSCALE)
        np.testing.assert_array_equal(tag_cells(number), official)


def test_the_same_picture_is_taken_again_and_by_another_world_at_the_same_time(tiny):
    camera = camera_at((0.2, -0.8, 0.9), (0.6, 0, 0.1))
    with World.load("tiny") as other:
        np.testing.assert_array_equal(tiny.photograph(camera), other.photograph(camera))
        other.client.resetBasePositionAndOrientation(other.bodies["Can1"], [0.5, -0.1, 0.18], [0, 0, 0, 1])
        assert (tiny.photograph(camera) != other.photograph(camera)).any()


def table_look(table):
    """Two small pictures of the table, side by side (96, 256, 3)."""
    eyes = [(-0.5, 0.8, 1.0), (2.2, -0.9, 0.9)]
    cameras = [Camera.from_fov(look_at(eye, (0.9, 0.1, 0.3)), 512, 384, 50) for eye in eyes]
    return np.hstack([cv2.resize(table.photograph(camera), (128, 96), interpolation=cv2.INTER_AREA) for camera in cameras])


def test_the_tables_look_is_frozen(table):
    """Figures are compared from one version to the next, so the table world stays as it is: its file to the letter,
    its pictures but for a processor's rounding. (The picture is `table_look`, written with cv2.imwrite in RGB.)"""
    spec = json.dumps(worldfile.read("table"), sort_keys=True)
    assert hashlib.sha256(spec.encode()).hexdigest() == "9537146454750b21546e54783865eb2b384fb3f4436b8e7b3be48f0bf8b30622"
    frozen = cv2.imread(str(Path(__file__).with_name("table_look.png"))).astype(float)
    assert np.abs(table_look(table) - frozen).mean() < 0.5


def test_surfaces_look_the_same_from_all_sides(table):
    """Colour at points of the table top from two cameras: no highlight that a field would have to explain."""
    cameras = [
        Camera.from_fov(look_at(eye, [1.1, -0.4, 0.22]), 320, 240, 30) for eye in ([0.4, -1.3, 1.0], [1.9, -1.2, 1.2])
    ]
    grid = np.stack(np.meshgrid(np.linspace(1.0, 1.2, 9), np.linspace(-0.5, -0.3, 9), [0.22]), -1).reshape(-1, 3)
    means = [table.photograph(c)[tuple(np.floor(c.project(grid)).astype(int).T[::-1])].mean(0) for c in cameras]
    np.testing.assert_allclose(*means, atol=6)


@pytest.mark.parametrize("name", worldfile.names())
def test_the_sketch_views_see_the_whole_intended_motion(name):
    """In pictures that are wide enough for a hand's faults, and not behind anything."""
    from teach.scripted import smooth_path

    with World.load(name, textured=False) as world:
        path = smooth_path(world.spec["motion"]["via"], 60)
        for view in world.spec["sketch_views"]:
            camera = Camera.from_fov(look_at(view["eye"], view["target"]), 640, 480, view["fov_deg"])
            pixels = camera.project(path)
            assert ((pixels > 25) & (pixels < [615, 455])).all()
            to = path + 0.01 * (camera.centre - path) / np.linalg.norm(camera.centre - path, axis=1, keepdims=True)
            between = world.client.rayTestBatch([camera.centre.tolist()] * len(path), to.tolist())
            to_touch = {world.bodies[name] for name in world.spec.get("touch", [])}
            assert np.mean([hit[0] >= 0 and hit[0] not in to_touch for hit in between]) < 0.1, view


def test_photographs_are_seeded_even_and_outside_of_everything(table):
    cameras = hemisphere(table.spec, seed=3)
    again, other = hemisphere(table.spec, seed=3), hemisphere(table.spec, seed=4)
    assert len(cameras) == 48 and all(
        (a.world_from_camera == b.world_from_camera).all() for a, b in zip(cameras, again)
    )
    assert any((a.world_from_camera != b.world_from_camera).any() for a, b in zip(cameras, other))
    offsets = np.array([c.centre for c in cameras]) - table.spec["view"]["target"]
    quadrants = np.histogram(np.arctan2(offsets[:, 1], offsets[:, 0]), bins=4, range=(-np.pi, np.pi))[0]
    assert quadrants.min() >= 8 and (offsets[:, 2] > 0.2).all()
    for thing in table.spec["objects"]:
        low, high = table.client.getAABB(table.bodies[thing["name"]])
        assert not any(((c.centre > np.subtract(low, 0.05)) & (c.centre < np.add(high, 0.05))).all() for c in cameras)


def test_photographs_to_sketch_on_are_the_world_s_views_but_for_the_hand(table):
    cameras = sketch_views(table.spec, seed=3, jitter=0.02)
    assert len(cameras) == 2 and all((camera.width, camera.height) == (1280, 960) for camera in cameras)
    off = [np.linalg.norm(camera.centre - view["eye"]) for camera, view in zip(cameras, table.spec["sketch_views"])]
    assert 0 < max(off) < 0.1
    with pytest.raises(ValueError, match="has 3 sketch views"):
        sketch_views(table.spec, count=4)


def test_a_world_says_from_where_it_is_photographed_unless_it_is_asked_for():
    view = {"target": [0.3, 0, 0.5], "azimuth_deg": [90, 270], "elevation_deg": [10, 20], "radius": [1, 2]}
    for asked, azimuths, elevations in (({}, (90, 270), (10, 20)), ({"azimuth_deg": [0, 30], "elevation_deg": [40, 50]}, (0, 30), (40, 50))):
        offsets = np.array([camera.centre for camera in hemisphere({"view": view}, jitter=0, **asked)]) - view["target"]
        azimuth = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360
        elevation = np.degrees(np.arcsin(offsets[:, 2] / np.linalg.norm(offsets, axis=1)))
        for angle, (low, high) in ((azimuth, azimuths), (elevation, elevations)):
            assert low - 1e-6 < angle.min() < low + 3 and high - 9 < angle.max() < high + 1e-6
    turned = varied(PLAIN | {"view": view, "seed": 1, "variation": {"yaw_deg": 20}})["view"]["azimuth_deg"]
    assert np.ptp(turned) == pytest.approx(180) and turned[0] != 90


def test_seed_zero_is_as_published_and_another_seed_moves_the_goal_with_its_motion():
    published, moved = worldfile.read("table"), varied(worldfile.read("table") | {"seed": 5})
    assert varied(published) == published
    assert moved["motion"]["via"][0] == published["motion"]["via"][0]  # the hand starts where the arm is
    np.testing.assert_allclose(moved["motion"]["via"][-1], pre_grasp(moved), atol=1e-9)
    assert np.linalg.norm(pre_grasp(moved) - pre_grasp(published)) > 0.003
    assert varied(worldfile.read("table") | {"seed": 5}) == moved


def test_movable_things_fall_and_fixed_ones_stay():
    cube = MARKER | {"name": "cube", "mass": 0.1, "position": [0.1, -0.05, 0.22]}
    with World.from_spec(PLAIN | {"objects": [MARKER, cube]}, textured=False) as world:
        world.client.resetBasePositionAndOrientation(world.bodies["cube"], [0, 0.3, 1.0], [0, 0, 0, 1])
        for _ in range(60):
            world.client.stepSimulation()
        assert world.pose("cube")[2, 3] < 0.75 and world.speed("cube") > 2
        np.testing.assert_allclose(world.pose("marker")[:3, 3], MARKER["position"])


CABINET = {"name": "cabinet", "shape": "box", "size": [0.2, 0.2, 0.2], "position": [0, 0, 0.5]}
DRAWER = {"name": "drawer", "shape": "box", "size": [0.1, 0.1, 0.1], "position": [0.3, 0, 0.5], "mass": 1.0, "rpy_deg": [0, 0, 30]}
SLIDE = {"name": "slide", "parent": "cabinet", "child": "drawer", "type": "prismatic", "axis": [2, 0, 0], "lower": -0.1, "upper": 0.2}


def test_a_drawer_slides_along_its_axis_only_and_stops_at_its_limits():
    with World.from_spec(PLAIN | {"objects": [CABINET, DRAWER], "joints": [SLIDE]}, textured=False) as world:
        np.testing.assert_allclose(world.pose("drawer"), things.pose(DRAWER), atol=1e-6)
        assert world.joint_opening("slide") == pytest.approx(0.1)
        for push, end in ((2, 0.5), (-2, 0.2)):
            for _ in range(480):
                world.client.applyExternalForce(world.bodies["drawer"], 0, [push, 3, 0], world.pose("drawer")[:3, 3], 1)
                world.client.stepSimulation()
            np.testing.assert_allclose(world.pose("drawer")[:3, 3], [end, 0, 0.5], atol=5e-3)
        np.testing.assert_allclose(world.pose("drawer")[:3, :3], things.pose(DRAWER)[:3, :3], atol=1e-3)
        assert world.joint_opening("slide") == pytest.approx(0.0, abs=5e-3)


def test_a_drawer_with_friction_stays_where_it_is_left():
    with World.from_spec(PLAIN | {"objects": [CABINET, DRAWER], "joints": [SLIDE | {"axis": [1, 0, 1], "friction": 20}]}, textured=False) as world:
        for _ in range(240):
            world.client.stepSimulation()
        assert world.joint_opening("slide") == pytest.approx(0.1, abs=1e-3)


def test_a_lid_turns_about_its_hinge_only():
    hinge = SLIDE | {"name": "hinge", "type": "revolute", "axis": [0, 0, 1], "lower": -2, "upper": 2, "at": [0.2, 0, 0.5]}
    with World.from_spec(PLAIN | {"objects": [CABINET, DRAWER], "joints": [hinge]}, textured=False) as world:
        np.testing.assert_allclose(world.pose("drawer"), things.pose(DRAWER), atol=1e-6)
        for _ in range(120):
            world.client.applyExternalTorque(world.bodies["drawer"], 0, [0.05, 0.05, 0.05], 2)
            world.client.stepSimulation()
        turned = world.joint_opening("hinge") - 2
        assert turned > 0.2
        np.testing.assert_allclose(world.pose("drawer")[:3, 3], [0.2 + 0.1 * np.cos(turned), 0.1 * np.sin(turned), 0.5], atol=2e-3)
        np.testing.assert_allclose(world.pose("drawer")[2, :3], [0, 0, 1], atol=1e-3)
        (piece,) = [p for p in body_pieces(world.client, world.bodies) if p.name == "drawer"]
        np.testing.assert_allclose(piece.frame_from_piece, world.pose("drawer"), atol=1e-6)


CUP = {"name": "cup", "shape": "cup", "height": 0.1, "radius": 0.05, "wall": 0.004, "position": [0, 0, 0.05], "mass": 0.1}
CRATE = {"name": "crate", "shape": "crate", "size": [0.2, 0.1, 0.1], "wall": 0.01, "position": [0, 0, 0.05], "mass": 0.1}
FLOOR = {"name": "floor", "shape": "box", "size": [2, 2, 0.1], "position": [0, 0, -0.05]}


@pytest.mark.parametrize("vessel", [CUP, CRATE], ids=["cup", "crate"])
def test_a_vessel_is_hollow_and_closed(vessel):
    """A rain of marbles stays in it, on its floor, and it stands still."""
    marble = {"name": "marble", "shape": "box", "size": [0.02, 0.02, 0.02], "position": [0, 0, 0.05], "mass": 0.02}
    lowest = marble | {"position": [0, 0, vessel["wall"] + 0.01]}
    with World.from_spec(PLAIN | {"objects": [FLOOR, vessel, lowest]}, textured=False) as world:
        world.client.resetBasePositionAndOrientation(world.bodies["marble"], [0.02, -0.01, 0.2], [0, 0, 0, 1])
        for _ in range(240):
            world.client.stepSimulation()
        assert world.pose("marble")[2, 3] == pytest.approx(vessel["wall"] + 0.01, abs=2e-3)
        np.testing.assert_allclose(world.pose(vessel["name"])[:3, 3], vessel["position"], atol=3e-3)


@pytest.mark.parametrize("thing", [CUP, CRATE, CUP | {"shape": "parts", "parts": [MARKER, CRATE | {"position": [0, 0, 0.2], "rpy_deg": [0, 0, 45]}]}],
                         ids=["cup", "crate", "parts"])  # fmt: skip
def test_things_are_seen_where_they_are_touched(thing):
    """Rays of the physics and depth of the pictures, from two sides."""
    with World.from_spec(PLAIN | {"objects": [thing | {"mass": 0, "rpy_deg": [0, 0, 20]}]}) as world:
        for eye in ((0.3, 0.1, 0.4), (-0.2, -0.4, 0.1)):
            camera = camera_at(eye, (0, 0, 0.08))
            _, depth = world.photograph_with_depth(camera)
            pixels = camera.pixel_centres()[::3, ::3].reshape(-1, 2)
            origins, directions = camera.rays(pixels)
            hits = world.client.rayTestBatch(origins.tolist(), (origins + 2.0 * directions).tolist())
            touched = np.array([np.nan if hit[0] < 0 else 2 * hit[2] for hit in hits]) * (directions @ camera.forward)
            seen = depth[::3, ::3].ravel()
            both = np.isfinite(touched) & np.isfinite(seen)
            assert both.sum() > 20 and (np.isfinite(touched) ^ np.isfinite(seen)).mean() < 0.02
            assert np.median(np.abs(touched - seen)[both]) < 2.5e-3 and (np.abs(touched - seen)[both] > 0.01).mean() < 0.05


def test_the_pedestal_stays_with_the_robot_whatever_the_seed():
    with World.load("table", seed=7, textured=False) as world:
        position, quat_xyzw = world.client.getBasePositionAndOrientation(world.bodies["pedestal"])
    np.testing.assert_allclose([*position[:2], *quat_xyzw], [0, 0, 0, 0, 0, 1], atol=1e-9)


WRONG = {
    "negative size": ({"size": [0.1, -0.1, 0.1]}, "marker.*size"),
    "two lengths": ({"size": [0.1, 0.1]}, "marker.*size"),
    "not a number": ({"position": [0, float("nan"), 0]}, "marker.*position"),
    "unknown shape": ({"shape": "torus"}, "marker.*torus.*box, crate, cup, cylinder, mesh"),
    "unknown texture": ({"texture": "marble"}, "marker.*marble.*wood"),
    "negative mass": ({"mass": -1}, "marker.*mass"),
    "mass that is a truth": ({"mass": True}, "marker.*mass"),
    "shape that is a list": ({"shape": ["box"]}, "marker.*shape"),
    "colour by name": ({"colour": "red"}, "marker.*colour"),
    "a wall too thick": ({"shape": "cup", "height": 0.1, "radius": 0.02, "wall": 0.02}, "marker.*leaves no room"),
    "too many parts": ({"shape": "parts", "parts": [CUP, CRATE]}, "marker.*18 primitives, 16 at most"),
    "a part in a part": ({"shape": "parts", "parts": [{"shape": "parts", "position": [0, 0, 0]}]}, "part 0.*cannot be of shape parts"),
    "misspelt key": ({"colur": [1, 2, 3]}, "marker.*unknown colur; did you mean colour"),
    "no such mesh": ({"shape": "mesh", "file": "none.obj"}, "marker.*none.obj"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_field_is_named_with_its_object(case):
    change, message = WRONG[case]
    spec = copy.deepcopy(PLAIN)
    spec["objects"][0] |= change
    with pytest.raises(ValueError, match=message):
        World.from_spec(spec)


def test_missing_keys_twins_and_foreign_goals_are_named():
    def refuse(message, **change):
        with pytest.raises(ValueError, match=message):
            World.from_spec(copy.deepcopy(PLAIN) | change)

    refuse("marker.*missing position", objects=[{k: v for k, v in MARKER.items() if k != "position"}])
    refuse("two objects are called marker", objects=[MARKER, MARKER])
    refuse("Cup.*none of marker", goal={"object": "Cup"})
    refuse(
        "joint j.*parent",
        joints=[SLIDE | {"name": "j", "parent": "x", "child": "marker"}],
    )


TAG = {"id": 1, "size": 0.1, "position": [0, 0, 0]}
GOAL = {"object": "marker", "approach": [1, 0, 0], "distance": 0.1}
BOX = MARKER | {"name": "cube", "mass": 0.1, "position": [0.1, -0.05, 0.22]}


@pytest.mark.parametrize("change", [
    {"joints": ["a"]}, {"tags": None}, {"tags": ["x"]}, {"tags": [TAG | {"id": 9999}]}, {"tags": [TAG, TAG]}, {"tags": [TAG, TAG | {"id": 2, "size": 0.2}]},
    {"tags": [TAG | {"rpy_deg": "a"}]}, {"seed": "a"}, {"seed": -1}, {"variation": {"shift": "x"}}, {"goal": "Can"}, {"goal": {"object": "marker"}},
    {"goal": GOAL | {"approach": [0, 0, 0]}}, {"sketch_views": [{"eye": [0, 0, 1]}]}, {"success": {"reached_m": "x"}}, {"view": "x"}, {"film": {"eye": [0, 0, 0]}},
], ids=str)  # fmt: skip
def test_whatever_else_is_wrong_in_a_file_is_one_clear_error(change):
    with pytest.raises(ValueError, match=next(iter(change)).rstrip("s").split("_")[0]):
        World.from_spec(copy.deepcopy(PLAIN) | change, textured=False)


@pytest.mark.parametrize(("change", "message"), [
    ({"object": [BOX]}, "unknown object; did you mean objects"),
    ({"objects": [MARKER, BOX | {"position": [0.1, -0.05, 0.215]}]}, "object cube: it can move and overlaps marker"),
    ({"objects": [MARKER, BOX | {"position": [0.1, -0.05, 0.225]}]}, "object cube: it can move and rests on nothing"),
    ({"objects": [FLOOR, CUP, BOX | {"position": [0, 0, 0.05]}]}, "object cube: it can move and rests on nothing"),
    ({"objects": [MARKER, BOX], "success": {"belo": []}}, "success: unknown belo; did you mean below"),
    ({"objects": [MARKER, BOX], "success": {"below": [{"body": "cub", "height": 1}]}}, "no object is called 'cub'; did you mean cube"),
    ({"objects": [MARKER, BOX], "success": {"below": [{"body": "cube"}]}}, "below: height must be 1 finite number"),
    ({"objects": [MARKER, BOX], "success": {"inside": [{"body": "cube", "container": "marker"}]}}, "marker is no crate or cup"),
    ({"objects": [MARKER, BOX], "success": {"closed": [{"joint": "runner", "within": 0.1}]}}, "no joint is called 'runner'"),
    ({"touch": ["markr"]}, "no object is called 'markr'; did you mean marker"),
    ({"motion": {"via": [[0, 0, 0]]}}, "via must be at least two points"),
    ({"motion": {"via": [[0, 0, 0], [0, 0, 1]], "events": [["gripper_opne", 1.0]]}}, "gripper_opne.*did you mean gripper_open"),
    ({"motion": {"via": [[0, 0, 0], [0, 0, 1]], "follow": [1]}}, "follow must be 2 finite numbers"),
    ({"held": MARKER | {"name": "cube"}}, "held cube: what is held needs a mass"),
    ({"variation": {"things": {"markr": [0, 0, 0]}}}, "unknown markr; did you mean marker"),
    ({"objects": [CABINET, DRAWER], "joints": [{k: v for k, v in SLIDE.items() if k != "upper"}]}, "joint slide: upper must be 1 finite"),
    ({"objects": [CABINET, DRAWER], "joints": [SLIDE | {"lower": 0.1}]}, "joint slide: limits must lie around 0"),
    ({"objects": [CABINET, DRAWER | {"mass": 0}], "joints": [SLIDE]}, "joint slide: its parent must be fixed"),
    ({"crowd": {"count": -1}}, "crowd: count must be a whole number from 0 on, not -1"),
    ({"crowd": {"count": 1, "lower": [0, 0, 1], "upper": [1, 1, 0], "size": 0.1, "clear": 0}}, "crowd: lower .* lies above upper"),
    ({"crowd": {"count": 1, "lower": [0, 0, 0], "upper": [1, 1, 1], "size": 0, "clear": 0}}, "crowd: size must"),
    ({"view": {"target": [0, 0, 0], "azimut_deg": [0, 1]}}, "view: unknown azimut_deg; did you mean azimuth_deg"),
])  # fmt: skip
def test_a_task_that_cannot_be_is_one_clear_error_with_what_comes_near(change, message):
    with pytest.raises(ValueError, match=message):
        World.from_spec(copy.deepcopy(PLAIN) | change, textured=False)


def test_a_drawer_may_touch_its_cabinet_and_needs_nothing_to_rest_on():
    deep = DRAWER | {"position": [0.05, 0, 0.5]}
    with World.from_spec(PLAIN | {"objects": [CABINET, deep], "joints": [SLIDE]}, textured=False) as world:
        assert world.bodies["drawer"] != world.bodies["cabinet"]


def test_things_that_vary_stand_free_and_the_motion_goes_with_the_goals():
    published = worldfile.read("shelf")
    for seed in (1, 2, 3):
        moved = varied(published | {"seed": seed})
        cans = [thing for thing in moved["objects"] if thing["name"].startswith("Can")]
        assert all(free(one, [other for other in cans if other is not one]) for one in cans)
        np.testing.assert_allclose(moved["motion"]["via"][-1], pre_grasp(moved), atol=1e-9)
        assert moved["motion"]["via"][0] == published["motion"]["via"][0]


def test_where_nothing_stands_free_it_is_said():
    walls = [MARKER | {"name": f"wall{side}", "size": [1, 5000, 1], "position": [0, 2500.011 * side, 0]} for side in (-1, 1)]
    spec = PLAIN | {"objects": [MARKER | {"position": [0, 0, 0]}, *walls], "seed": 1, "variation": {"things": {"marker": [0, 1000, 0]}}}
    with pytest.raises(ValueError, match="marker never stood free"):
        varied(spec)


def test_a_crowd_stands_clear_of_the_motion_and_grows_by_more_of_the_same():
    spec = worldfile.read("tiny") | {"crowd": {"count": 8, "lower": [0.2, -0.9, 0], "upper": [1.2, 0.9, 1.2], "size": 0.04, "clear": 0.3}}
    worldfile.check(spec)
    few, more = ([one for one in varied(spec | {"crowd": spec["crowd"] | {"count": n}})["objects"] if one["name"].startswith("crowd")] for n in (8, 40))
    assert len(more) == 40 and few == more[:8]
    path = np.concatenate([np.linspace(a, b, 100) for a, b in pairwise(spec["motion"]["via"])])
    corners = np.array([placed(cube["position"], cube["rpy_deg"]) @ [*np.multiply(sign, 0.02), 1] for cube in more for sign in product((-1, 1), repeat=3)])[:, :3]
    assert np.linalg.norm(corners[:, None] - path, axis=2).min() > 0.3
    with pytest.raises(ValueError, match="found no place clear of the motion"):
        varied(spec | {"crowd": spec["crowd"] | {"clear": 5.0}})


def test_a_world_without_a_task_varies_too():
    assert varied(PLAIN | {"seed": 1, "variation": {"shift": [0.1, 0, 0]}})["objects"][0]["position"] != MARKER["position"]


def test_an_unknown_world_is_told_which_there_are(tmp_path):
    with pytest.raises(FileNotFoundError, match="moon.*table, tiny"):
        World.load("moon")
    (tmp_path / "mine.yaml").write_text("objects: [")
    with pytest.raises(ValueError, match="not YAML"):
        World.load(tmp_path / "mine.yaml")


def test_a_users_own_file_is_read_and_never_executed(tmp_path):
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(PLAIN))
    with World.load(tmp_path / "mine.yaml", textured=False) as world:
        assert set(world.bodies) == {"marker"}
    (tmp_path / "evil.yaml").write_text("!!python/object/apply:os.getcwd []")
    with pytest.raises(ValueError, match="not YAML"):
        World.load(tmp_path / "evil.yaml")
