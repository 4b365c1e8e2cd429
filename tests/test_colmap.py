import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from scene import album, colmap, dataset, masks
from scene.camera import Camera, look_at
from scene.colmap import mapping
from scene.frame import apriltag, gravity
from scene.frame.similarity import umeyama

DATA = Path(__file__).parents[2] / "shared" / "data"
ROOT = Path(__file__).parents[1]


# A world of textured rectangles with tags: the ground and three boxes, painted from far to near by homographies.


def texture(seed, width=700, height=700):
    """Blobs and edges of many sizes, such as features like."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width, 3))
    for cells in (6, 20, 60, 180):
        coarse = rng.uniform(0, 255, (max(cells * height // width, 1), cells, 3))
        smooth = cv2.INTER_NEAREST if cells == 20 else cv2.INTER_CUBIC
        image += cv2.resize(coarse, (width, height), interpolation=smooth)
    return np.clip(image / 4 * 1.6 - 70, 0, 255).astype(np.uint8)


def tag_picture(number):
    """36h11 with its white border, upright as the official pictures are; the black square is 8 of 10 cells wide."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    bits = cv2.rotate(cv2.aruco.generateImageMarker(dictionary, number, 8), cv2.ROTATE_180)
    return np.repeat(np.pad(bits, 1, constant_values=255)[..., None], 3, axis=2)


def rectangle(origin, right, down):
    """Corners (4, 3) of a rectangle: top left, top right, bottom right, bottom left of its picture."""
    origin, right, down = (np.array(v, dtype=float) for v in (origin, right, down))
    return np.array([origin, origin + right, origin + right + down, origin + down])


def world(tags=True, seed=0):
    faces = [(rectangle((-0.8, 0.8, 0), (1.6, 0, 0), (0, -1.6, 0)), texture(seed, 1400, 1400))]
    for i, (x, y, w, h) in enumerate([(-0.25, 0.1, 0.2, 0.25), (0.2, 0.15, 0.25, 0.15), (0.0, -0.25, 0.2, 0.1)]):
        a, b, c, d = (x - w / 2, y - w / 2), (x + w / 2, y - w / 2), (x + w / 2, y + w / 2), (x - w / 2, y + w / 2)
        for j, (p, q) in enumerate([(a, b), (b, c), (c, d), (d, a)]):
            right = (q[0] - p[0], q[1] - p[1], 0)
            faces.append((rectangle((*p, h), right, (0, 0, -h)), texture(seed + 10 * i + j + 1)))
        faces.append((rectangle((*d, h), (w, 0, 0), (0, -w, 0)), texture(seed + 10 * i + 9)))
    layout = tag_layout()
    for number, pose in layout.base_from_tag.items() if tags else ():
        half = layout.size * 10 / 8 / 2
        corners = rectangle((-half, half, 1e-4), (2 * half, 0, 0), (0, -2 * half, 0)) @ pose[:3, :3].T + pose[:3, 3]
        faces.append((corners, cv2.resize(tag_picture(number), (400, 400), interpolation=cv2.INTER_NEAREST)))
    return faces


def tag_layout():
    poses = {}
    for number, (x, y, yaw) in enumerate([(-0.55, -0.5, 10), (0.55, -0.5, 100), (0.55, 0.5, 190), (-0.55, 0.5, -75)]):
        pose = np.eye(4)
        c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        pose[:2, :2], pose[:2, 3] = [[c, -s], [s, c]], (x, y)
        poses[number] = pose
    return apriltag.TagLayout(0.16, poses)


def render(faces, camera, oversampling=3):
    """A picture of the faces seen from their front; boxes must not stand behind one another's faces too cunningly."""
    large = camera.resized(camera.width * oversampling, camera.height * oversampling)
    canvas = np.full((large.height, large.width, 3), 40, np.uint8)
    floor = [face for face in faces if face[0][:, 2].max() < 1e-2]
    rest = [face for face in faces if face[0][:, 2].max() >= 1e-2]
    rest.sort(key=lambda face: -np.linalg.norm(face[0].mean(axis=0) - camera.centre))
    for corners, picture in floor + rest:
        normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
        if normal @ (camera.centre - corners[0]) <= 0:
            continue
        h, w = picture.shape[:2]
        pixels = large.project(corners) - 0.5
        source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - 0.5
        H, size = cv2.getPerspectiveTransform(source, pixels.astype(np.float32)), (large.width, large.height)
        warped = cv2.warpPerspective(picture, H, size, flags=cv2.INTER_LINEAR)
        inside = cv2.warpPerspective(np.full((h, w), 255, np.uint8), H, size, flags=cv2.INTER_NEAREST)
        canvas[inside > 127] = warped[inside > 127]
    return cv2.resize(canvas, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def cameras(count, width=320, height=240, fov_deg=55):
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    eyes = [(1.1 * np.cos(a), 1.1 * np.sin(a), 0.8 + 0.25 * np.cos(2 * a)) for a in angles]
    return [Camera.from_fov(look_at(eye, (0.02 * i, 0, 0.05)), width, height, fov_deg) for i, eye in enumerate(eyes)]


def photograph(folder, count=10, **keywords):
    faces = world(**keywords)
    for i, camera in enumerate(cameras(count)):
        dataset.save_image(folder / f"{i:02d} photo.png", render(faces, camera))
    return album.load_photographs(folder)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Photographs of the rectangles, and the model made of them."""
    folder = tmp_path_factory.mktemp("rectangles")
    photographs = photograph(folder / "photographs", 12)
    return photographs, folder, colmap.reconstruct(photographs, folder / "work", progress=False)


def camera_errors(model, similarity, true):
    """Per camera: distance of the centres [mm] and angle between the axes [deg]."""
    moved = [similarity.move(camera) for camera in model.cameras]
    distance = [1000 * np.linalg.norm(a.centre - b.centre) for a, b in zip(moved, true, strict=True)]
    turns = [a.world_from_camera[:3, :3].T @ b.world_from_camera[:3, :3] for a, b in zip(moved, true)]
    cosine = (np.trace(turns, axis1=1, axis2=2) - 1) / 2
    return np.array(distance), np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_every_photograph_is_registered_and_the_cameras_are_right_up_to_a_similarity(capture):
    _, _, model = capture
    true = cameras(12)
    similarity = umeyama(np.array([c.centre for c in model.cameras]), np.array([c.centre for c in true]))
    mm, degrees = camera_errors(model, similarity, true)
    assert (model.registered, model.total, model.unregistered) == (12, 12, ())
    assert model.names == tuple(f"{i:02d} photo" for i in range(12))
    assert model.reprojection_px < 0.5
    assert np.median(mm) < 3 and np.median(degrees) < 0.2
    assert model.cameras[0].K[0, 0] == pytest.approx(true[0].K[0, 0], rel=0.01)


def test_tags_bring_the_model_to_the_robots_frame(capture):
    _, _, model = capture
    similarity = apriltag.align(model, tag_layout())
    mm, degrees = camera_errors(model, similarity, cameras(12))
    assert similarity.residual_mm < 5 and len(similarity.used) >= 3
    assert np.median(mm) < 6 and np.median(degrees) < 0.3
    on_floor = np.abs(similarity.apply(model.points)[:, 2]) < 0.01
    assert on_floor.mean() > 0.5


def test_gravity_points_up_in_a_frame_without_tags(capture):
    _, _, model = capture
    to_robot, arbitrary = apriltag.align(model, tag_layout()), gravity.align(model)
    up = to_robot.rotation @ arbitrary.rotation.T @ [0, 0, 1]
    assert np.degrees(np.arccos(up[2])) < 1
    assert arbitrary.frame == "arbitrary"


def test_pictures_of_a_straight_lens_are_kept_bit_by_bit(capture):
    photographs, _, model = capture
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(photographs, model.images, strict=True))


def test_points_and_files_are_whole(capture):
    _, folder, model = capture
    assert model.points.shape == model.colours.shape and model.points.shape[1] == 3 and len(model.points) > 300
    assert model.colours.dtype == np.uint8 and len(model.point_errors) == len(model.points)
    assert {"cameras.bin", "images.bin", "points3D.bin"} <= {p.name for p in model.sparse.iterdir()}
    assert sorted(p.name for p in (folder / "work").iterdir()) == ["colmap", "images"]
    assert [view.name for view in model.views()] == list(model.names)
    assert np.array_equal(colmap.Model.load(folder / "work").points, model.points)


def test_the_same_seed_gives_the_same_model_bit_by_bit(capture, tmp_path):
    photographs, _, model = capture
    again = colmap.reconstruct(photographs, tmp_path, progress=False)
    assert np.array_equal(again.points, model.points)
    assert all(np.array_equal(a.world_from_camera, b.world_from_camera) for a, b in zip(again.cameras, model.cameras))


def test_of_many_photographs_only_those_that_look_alike_are_matched(capture, tmp_path):
    photographs, _, _ = capture
    model = colmap.reconstruct(photographs, tmp_path / "work", exhaustive=5, alike=2, progress=False)
    true = cameras(12)
    similarity = umeyama(np.array([c.centre for c in model.cameras]), np.array([c.centre for c in true]))
    mm, degrees = camera_errors(model, similarity, true)
    assert model.registered == 12
    assert np.median(mm) < 5 and np.median(degrees) < 0.3


def test_a_bent_lens_is_straightened_and_large_pictures_are_scaled(tmp_path):
    faces = world()
    for i, camera in enumerate(cameras(8, 360, 270)):
        wide = Camera(camera.K + [[0, 0, 40], [0, 0, 30], [0, 0, 0]], camera.world_from_camera, 440, 330)
        pixels = camera.pixel_centres()
        centred = (pixels - camera.K[:2, 2]) / camera.K[0, 0]
        straight = centred * (1 + 0.12 * (centred**2).sum(-1, keepdims=True))  # the inverse of a lens with k near -0.12
        sources = (straight * wide.K[0, 0] + wide.K[:2, 2] - 0.5).astype(np.float32)
        picture = cv2.remap(render(faces, wide), sources[..., 0], sources[..., 1], cv2.INTER_CUBIC)
        dataset.save_image(tmp_path / "photographs" / f"{i}.png", picture)
    photographs = album.load_photographs(tmp_path / "photographs")
    model = colmap.reconstruct(photographs, tmp_path, max_size=320, progress=False)
    assert model.registered >= 7 and model.views()[0].image.shape == (240, 320, 3)
    assert all(view.image.min(axis=-1)[[0, -1]].any() for view in model.views())
    true = [camera for i, camera in enumerate(cameras(8, 360, 270)) if str(i) in model.names]
    similarity = umeyama(np.array([c.centre for c in model.cameras]), np.array([c.centre for c in true]))
    assert np.median(camera_errors(model, similarity, true)[0]) < 5
    for view in model.views()[:3]:  # the straightened picture is what a pinhole there would have taken
        pinhole = render(faces, similarity.move(view.camera))
        inner = np.s_[30:-30, 30:-30]
        assert np.corrcoef(view.image[inner].ravel(), pinhole[inner].ravel())[0, 1] > 0.9


def test_cameras_of_two_folders_one_of_them_turned_get_lenses_of_their_own(tmp_path):
    faces, true = world(), {}
    for i, camera in enumerate(cameras(12)):
        folder, shape = [("tele", (320, 240, 55)), ("wide", (400, 300, 70)), ("wide", (300, 400, 55))][i % 3]
        true[f"{folder}_{i:02d}"] = Camera.from_fov(camera.world_from_camera, *shape)
        dataset.save_image(tmp_path / "photos" / folder / f"{i:02d}.png", render(faces, true[f"{folder}_{i:02d}"]))
    model = colmap.reconstruct(album.load_photographs(tmp_path / "photos"), tmp_path, progress=False)
    assert model.names == tuple(sorted(true)) and model.registered == 12
    true = [true[name] for name in model.names]
    similarity = umeyama(np.array([c.centre for c in model.cameras]), np.array([c.centre for c in true]))
    mm, degrees = camera_errors(model, similarity, true)
    assert np.median(mm) < 4 and np.median(degrees) < 0.3
    for found, wanted, view in zip(model.cameras, true, model.views(), strict=True):
        assert found.K[0, 0] == pytest.approx(wanted.K[0, 0], rel=0.02)
        assert view.image.shape == (wanted.height, wanted.width, 3)
    middle = {name: np.array([[c.width / 2, c.height / 2]]) for name, c in zip(model.names, model.cameras, strict=True)}
    for name, pixel in colmap.straighten(model, middle).items():
        np.testing.assert_allclose(pixel, middle[name], atol=1e-6)


def test_pictures_that_do_not_overlap_are_refused_with_advice(tmp_path):
    for i in range(5):
        dataset.save_image(tmp_path / "photographs" / f"{i}.png", texture(100 + i, 160, 120))
    with pytest.raises(colmap.ReconstructionFailed, match=r"only 0 of 5 .*0 of 10 pairs.*overlap by 60-80 %"):
        colmap.reconstruct(album.load_photographs(tmp_path / "photographs"), tmp_path, progress=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["photographs"]


@pytest.mark.slow
def test_of_two_scenes_in_one_folder_the_larger_is_kept_and_the_rest_named(tmp_path):
    for name, seed, count in (("desk", 0, 10), ("floor", 500, 6)):
        faces = world(tags=False, seed=seed)
        for i, camera in enumerate(cameras(count)):
            dataset.save_image(tmp_path / "photos" / f"{name}{i}.png", render(faces, camera))
    model = colmap.reconstruct(album.load_photographs(tmp_path / "photos"), tmp_path, progress=False)
    assert model.names == tuple(f"desk{i}" for i in range(10))
    assert model.unregistered == tuple(f"floor{i}" for i in range(6))


def test_groups_that_share_no_photograph_are_said():
    def found(names):
        images = {i: SimpleNamespace(name=name, has_pose=name != "x") for i, name in enumerate(names)}
        return SimpleNamespace(images=images)

    best = found("abcde")
    groups = mapping._groups(best, [best, found("fghix"), found("aklm"), found("nop")])
    assert groups == [4, 3]
    found_pairs = {"pairs": 0, "features": 900}
    assert "groups of 5, 4, 3 that show nothing in common" in mapping._advice(20, 5, found_pairs, groups)
    assert mapping._groups(None, []) == [] and "only 0 of 20" in mapping._advice(20, 0, found_pairs, [])


def test_pictures_without_texture_are_refused(tmp_path):
    for i in range(3):
        dataset.save_image(tmp_path / "photographs" / f"{i}.png", np.full((120, 160, 3), 90 + i, np.uint8))
    with pytest.raises(colmap.ReconstructionFailed, match="only 0 of 3.*0 of 3 pairs.*0 features.*texture on or around"):
        colmap.reconstruct(album.load_photographs(tmp_path / "photographs"), tmp_path, progress=False)


def test_near_duplicates_are_refused_as_taken_from_one_place(tmp_path):
    picture, rng = texture(5, 240, 180), np.random.default_rng(0)
    for i in range(5):
        noisy = np.clip(picture + rng.normal(0, 1, picture.shape), 0, 255).astype(np.uint8)
        dataset.save_image(tmp_path / "photographs" / f"{i}.png", noisy)
    with pytest.raises(colmap.ReconstructionFailed, match="only 0 of 5.*10 of 10 pairs.*walk around the scene"):
        colmap.reconstruct(album.load_photographs(tmp_path / "photographs"), tmp_path, progress=False)


def test_photographs_are_never_written_over(tmp_path):
    photographs = photograph(tmp_path / "images", 3)
    with pytest.raises(ValueError, match="where undistorted ones are written"):
        colmap.reconstruct(photographs, tmp_path, progress=False)


def test_exif_rotated_photographs_are_laid_out_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 8
    Image.fromarray(texture(0, 64, 48)).save(tmp_path / "a.jpg", exif=exif)
    colmap._lay_out(tmp_path / "a.jpg", tmp_path / "b.jpg")
    assert not dataset.is_rotated(tmp_path / "b.jpg")
    assert dataset.load_image(tmp_path / "b.jpg").shape == (64, 48, 3)


def alive(pid):
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rsplit(")")[1].split()[0] != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGKILL])
def test_a_killed_reconstruction_leaves_no_process_and_no_result(capture, tmp_path, signal_number):
    photographs, _, _ = capture
    code = """
import signal, sys, scene.colmap
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is born without it
scene.colmap.reconstruct(sys.argv[2:], sys.argv[1], progress=False)
"""
    parent = subprocess.Popen([sys.executable, "-c", code, tmp_path, *photographs], cwd=ROOT, stderr=subprocess.DEVNULL)
    children, deadline = [], time.monotonic() + 30
    while not (children and (tmp_path / ".colmap.part" / "database.db").exists()):
        assert time.monotonic() < deadline and parent.poll() is None
        time.sleep(0.05)
        children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
    os.kill(parent.pid, signal_number)
    parent.wait(timeout=20)
    while any(alive(child) for child in children):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert parent.returncode != 0 and not (tmp_path / "colmap").exists() and not (tmp_path / "images").exists()


ORDERS = {
    "scene_first": "import scene.colmap.process, numpy as np, cv2; scene.colmap.process.load_pycolmap()",
    "numpy_first": "import numpy as np, cv2, scene.colmap.process; scene.colmap.process.load_pycolmap()",
    "others_after": "import scene.colmap.process; scene.colmap.process.load_pycolmap(); import scipy.optimize, numpy as np, cv2",
    "unused": "import scene.colmap, numpy as np, cv2",
}


@pytest.mark.parametrize("order", ORDERS)
def test_compression_works_after_any_order_of_imports(tmp_path, order):
    code = ORDERS[order] + """
import io, zlib
assert zlib.decompress(zlib.compress(b"a" * 10000)) == b"a" * 10000
image = np.arange(30000, dtype=np.uint8).reshape(100, 100, 3)
np.savez_compressed("a.npz", image=image)
assert (np.load("a.npz")["image"] == image).all()
assert cv2.imwrite("a.png", image) and (cv2.imread("a.png") == image).all()
from PIL import Image
Image.fromarray(image).save("b.png")
"""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, check=True, timeout=60)


def test_importing_the_room_does_not_import_pycolmap():
    code = "import sys, json, scene.colmap, scene.frame.apriltag, scene.dataset; print(json.dumps(sorted(sys.modules)))"
    modules = json.loads(subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True).stdout)
    assert not {"pycolmap", "cv2", "torch", "scipy"} & set(modules)


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "photos" / "banana").exists(), reason="no photographs of the banana here")
def test_at_least_fifteen_of_the_sixteen_banana_photographs_register(tmp_path):
    (tmp_path / "photographs").mkdir()
    for path in sorted((DATA / "photos" / "banana").glob("*.JPG")):
        with Image.open(path) as image:
            half = image.resize((1504, 1000), Image.Resampling.LANCZOS)
            half.save(tmp_path / "photographs" / path.name, quality=95, exif=image.getexif())
    model = colmap.reconstruct(album.load_photographs(tmp_path / "photographs"), tmp_path, progress=False)
    assert model.registered >= 15 and model.reprojection_px < 1
    assert model.views()[0].image.shape == (681, 1024, 3)
    level = gravity.align(model)
    heights = [level.move(camera).centre[2] for camera in model.cameras]
    assert min(heights) > 0.1, "all photographs were taken from above the carpet"


def test_nothing_is_matched_where_masks_are_black(tmp_path):
    photographs = photograph(tmp_path / "photos", 12)
    shown = np.zeros((240, 320), bool)
    shown[40:200, 50:270] = True
    for path in photographs:
        dataset.save_mask(tmp_path / "masks" / f"{path.stem}.png", shown)
    model = colmap.reconstruct(photographs, tmp_path / "work", progress=False, masks=masks.find(photographs))
    pixels = [camera.project(model.points) for camera in model.cameras]
    inside = [((p > [48, 38]) & (p < [272, 202])).all(1) for p in pixels]
    assert len(model.points) > 30 and (np.sum(inside, axis=0) >= 2).all()
    assert all((view.mask == shown).mean() > 0.98 for view in model.views())
