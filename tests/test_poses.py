"""Known poses of some photographs give back the similarity that made the model."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from similarities import random_similarity, unscaled

from scene.camera import Camera, invert, look_at
from scene.frame import poses
from scene.model import ReconstructionFailed


def cameras(count=20):
    angles = np.linspace(0, 5, count)
    eyes = [(0.6 + 1.2 * np.cos(a), 1.2 * np.sin(a), 0.9 + 0.1 * np.sin(3 * a)) for a in angles]
    return [Camera.from_fov(look_at(eye, (0.6, 0, 0)), 640, 480, 50) for eye in eyes]


def rows(count=6):
    return [Camera.from_fov(look_at((x, -2.0, 1.0), (x, 0.0, 0.0)), 64, 48, 50) for x in np.linspace(0, 1, count)]


def noisy(pose, rng, mm, degrees):
    pose = pose.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(rng.normal(0, np.radians(degrees), 3)).as_matrix()
    pose[:3, 3] += rng.normal(0, mm / 1000, 3)
    return pose


def scene(true, known, seed=0, mm=0.0, degrees=0.0):
    """(names, poses of the model, poses in the base with noise, the model's cameras)."""
    rng = np.random.default_rng(seed)
    seen = unscaled(true, known)
    base = np.array([noisy(c.world_from_camera, rng, mm, degrees) for c in known])
    return [f"{i:04d}" for i in range(len(known))], np.array([c.world_from_camera for c in seen]), base, seen


def errors_mm(found, true, seen):
    return np.array([1000 * np.linalg.norm(found.move(c).centre - true.move(c).centre) for c in seen])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([cameras, rows]))
def test_exact_poses_return_the_exact_frame_even_in_a_row(seed, arranged):
    true = random_similarity(seed)
    found = poses.fit_frame(*scene(true, arranged()))
    assert np.allclose(found.matrix, true.matrix, atol=1e-6 * true.scale)
    assert found.residual_mm < 1e-3 and not found.warnings and len(found.used) == len(arranged())


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_a_millimetre_leaves_the_cameras_within_two(seed):
    true = random_similarity(seed)
    names, model, base, seen = scene(true, cameras(), seed, 1.0, 0.1)
    found = poses.fit_frame(names, model, base, seen)
    assert errors_mm(found, true, seen).max() < 2
    assert found.residual_mm == pytest.approx(np.sqrt(3), rel=0.4) and found.uncertainty_mm < 2


@pytest.mark.parametrize("wrong", [[4], [0, 1, 2, 3, 4, 5]])
def test_wrong_poses_are_left_out_and_named(wrong):
    true = random_similarity(3)
    names, model, base, seen = scene(true, cameras(), 0, 0.5, 0.05)
    rng = np.random.default_rng(1)
    for i in wrong:
        base[i, :3, 3] += rng.normal(0, 0.2, 3)
    found = poses.fit_frame(names, model, base, seen)
    assert set(names) - set(found.used) == {names[i] for i in wrong}
    assert all(names[i] in found.warnings[0] for i in wrong) and errors_mm(found, true, seen).max() < 2


def test_a_marker_beside_the_camera_spoils_rotations_only_and_is_said():
    true = random_similarity(2)
    names, model, base, seen = scene(true, cameras())
    base[:, :3, :3] = base[:, :3, :3] @ Rotation.from_rotvec([0, 0.3, 0]).as_matrix()
    found = poses.fit_frame(names, model, base, seen)
    assert np.allclose(found.matrix, true.matrix, atol=1e-6 * true.scale) and "17 degrees" in found.warnings[0]


def test_what_gives_no_frame_is_refused():
    true = random_similarity(4)
    names, model, base, seen = scene(true, cameras())
    still = base.copy()
    still[:, :3, 3] = 0.5
    with pytest.raises(ReconstructionFailed, match="one place"):
        poses.fit_frame(names, model, still, seen)
    with pytest.raises(ReconstructionFailed, match="do not fit"):
        poses.fit_frame(names, model, np.random.default_rng(0).permutation(base), seen)
    names, model, base, seen = scene(true, rows())
    base[:, :3, :3] = Rotation.random(len(base), random_state=0).as_matrix()
    with pytest.raises(ReconstructionFailed, match="known poses"):
        poses.fit_frame(names, model, base, seen)


def test_photographs_without_a_pose_are_told_from_those_with_one():
    class Some:
        names, cameras = ("a", "b", "c"), ()

    with pytest.raises(ReconstructionFailed, match=r"name 1 of the 3.*photographs are a, b, c, poses are of c, d"):
        poses.align(Some, {"c": np.eye(4), "d": np.eye(4)})


# Files


def colmap_rows(known):
    """(number, quaternion wxyz and translation, name) as COLMAP has them."""
    for i, camera in enumerate(known):
        inverse = invert(camera.world_from_camera)
        yield i + 1, [*Rotation.from_matrix(inverse[:3, :3]).as_quat(scalar_first=True), *inverse[:3, 3]], f"sub/pic {i}.jpg"


def write_txt(path, known):
    lines = [f"{n} {' '.join(map(repr, map(float, row)))} 1 {name}\n1.5 2.5 -1" for n, row, name in colmap_rows(known)]
    path.write_text("# a comment\n" + "\n".join(lines) + "\n")


def write_bin(path, known):
    data = struct.pack("<Q", len(known))
    for n, row, name in colmap_rows(known):
        data += struct.pack("<I7dI", n, *row, 1) + name.encode() + b"\0" + struct.pack("<Q", 2) + bytes(48)
    path.write_bytes(data)


@pytest.mark.parametrize(("name", "write"), [("images.txt", write_txt), ("images.bin", write_bin)])
def test_a_colmap_model_is_read(tmp_path, name, write):
    write(tmp_path / name, cameras(4))
    for path in (tmp_path, tmp_path / name):
        found = poses.load(path)
        assert list(found) == [f"pic {i}" for i in range(4)]
        assert all(np.allclose(found[f"pic {i}"], c.world_from_camera) for i, c in enumerate(cameras(4)))


def test_transforms_json_is_read_and_refused_where_its_frame_is_arbitrary(tmp_path):
    flipped = [{"file_path": f"images/{i}.png", "transform_matrix": (c.world_from_camera @ np.diag([1, -1, -1, 1])).tolist()}
               for i, c in enumerate(cameras(4))]  # fmt: skip
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({"frames": flipped}))
    assert all(np.allclose(poses.load(path)[str(i)], c.world_from_camera) for i, c in enumerate(cameras(4)))
    path.write_text(json.dumps({"frames": flipped, "scene2skill": {"frame": {"name": "arbitrary", "unit": "arbitrary"}}}))
    with pytest.raises(ValueError, match="arbitrary"):
        poses.load(path)


@pytest.mark.parametrize(("name", "content", "message"), [
    ("p.json", "[", "p.json"), ("p.json", "[1]", "p.json"), ("p.json", "{}", "missing frames"), ("p.json", '{"frames": []}', "no pose"),
    ("p.json", '{"frames": [{"file_path": "a", "transform_matrix": [[1]]}]}', "p.json"), ("p.csv", "", "nerfstudio"),
    ("images.bin", "abc", "images.bin"), ("images.txt", "1 2 3\n\n", "images.txt"),
    ("p.json", json.dumps({"frames": [{"file_path": "a", "transform_matrix": (2 * np.eye(4)).tolist()}]}), "a: the pose"),
])  # fmt: skip
def test_a_broken_file_says_what_is_wrong(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=message):
        poses.load(tmp_path / name)


def test_a_file_that_is_not_there_is_named(tmp_path):
    for path in (tmp_path / "poses.json", tmp_path):
        with pytest.raises(FileNotFoundError, match="no "):
            poses.load(path)
