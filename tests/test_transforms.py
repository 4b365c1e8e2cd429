"""Cameras that are given: nerfstudio's and instant-ngp's files, and COLMAP's models, come out as they went in."""

import json

import numpy as np
import pycolmap
import pytest
from PIL import Image

from scene import colmap, dataset, inputs, transforms
from scene.camera import OPENCV_FROM_OPENGL, Camera, View, orbit

LENS = {"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 61.0, "cx": 31.0, "cy": 25.0}
BENT = {"k1": -0.08, "k2": 0.01, "p1": 0.001, "p2": -0.002}
POSES = orbit((0.1, 0.2, 0.3), 2.0, 30, 4)


def picture(seed):
    smooth = np.random.default_rng(seed).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    return np.array(Image.fromarray(smooth).resize((64, 48), Image.Resampling.BICUBIC))


def written(folder, edit=lambda meta: None, name="transforms.json", **lens):
    """A folder as nerfstudio writes it, changed by ``edit``."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for i in range(len(POSES)):
        Image.fromarray(picture(i)).save(folder / "images" / f"f{i}.png")
    poses = [(pose @ OPENCV_FROM_OPENGL).tolist() for pose in POSES]
    frames = [{"file_path": f"./images/f{i}.png", "transform_matrix": pose} for i, pose in enumerate(poses)]
    meta = {"camera_model": "OPENCV", **LENS, **lens, "frames": frames}
    edit(meta)
    (folder / name).write_text(json.dumps(meta))
    return folder


def adopted(folder, work):
    posed = transforms.read(inputs.recognise(folder).path)
    return posed, colmap.adopt(posed, posed.root, work, progress=False)


def test_cameras_of_nerfstudio_come_out_as_they_went_in(tmp_path):
    points, colours = np.random.default_rng(0).normal(size=(20, 3)), np.full((20, 3), 7, np.uint8)
    dataset.save_points(tmp_path / "points.ply", points, colours)
    applied = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]
    folder = written(tmp_path, lambda meta: meta.update(ply_file_path="points.ply", applied_transform=applied))
    posed, model = adopted(folder, tmp_path / "work")
    assert model.names == ("f0", "f1", "f2", "f3") and model.registered == 4
    for i, (view, pose) in enumerate(zip(model.views(), POSES, strict=True)):
        assert view.camera.world_from_camera == pytest.approx(pose, abs=1e-12)
        assert view.camera.K.tolist() == [[60, 0, 31], [0, 61, 25], [0, 0, 1]]
        assert np.array_equal(view.image, picture(i))
    assert model.points == pytest.approx(points, abs=1e-12) and (model.colours == 7).all()
    assert posed.original[:3].tolist() == applied and np.isnan(model.reprojection_px)


def test_colmap_opens_what_was_made_of_given_cameras_with_the_lens_as_it_was(tmp_path):
    _, model = adopted(written(tmp_path, **BENT), tmp_path / "work")
    theirs = pycolmap.Reconstruction(model.sparse)
    assert theirs.num_reg_images() == 4 and theirs.num_cameras() == 1
    assert theirs.cameras[1].model.name == "OPENCV"
    assert theirs.cameras[1].params.tolist() == [60, 61, 31, 25, -0.08, 0.01, 0.001, -0.002]
    for image, pose in zip(sorted(theirs.images.values(), key=lambda i: i.name), POSES, strict=True):
        assert image.cam_from_world().inverse().matrix() == pytest.approx(pose[:3])


def test_pictures_of_a_bent_lens_are_undistorted(tmp_path):
    """OpenCV's own undistortion to the same pinhole is the reference."""
    import cv2

    _, model = adopted(written(tmp_path, **BENT), tmp_path / "work")
    view = model.views()[0]
    assert not np.array_equal(view.image, picture(0))
    K, half = np.array([[60, 0, 31], [0, 61, 25], [0, 0, 1.0]]), np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    bent = np.array(list(BENT.values()))
    maps = cv2.initUndistortRectifyMap(K - half, bent, None, view.camera.K - half, (64, 48), cv2.CV_32FC1)
    theirs = cv2.remap(picture(0), *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    assert np.abs(theirs.astype(int) - view.image).max() <= 2


def test_what_is_saved_of_given_cameras_is_given_again_unchanged(tmp_path):
    """Out of a capture folder, and in again: frame, scale and intrinsics."""
    K = [[60, 0, 31], [0, 61, 25], [0, 0, 1]]
    views = [View(f"v{i}", Camera(K, pose, 64, 48), picture(i)) for i, pose in enumerate(POSES)]
    original = np.diag([2.0, 2, 2, 1])
    points = np.arange(9.0).reshape(3, 3)
    frame = {"name": "robot base", "unit": "m"}
    dataset.save_views(tmp_path / "a", views, points=points, frame=frame, original=original)
    posed, model = adopted(tmp_path / "a", tmp_path / "work")
    assert posed.frame == frame and np.array_equal(posed.original, original)
    for view, again in zip(views, model.views(), strict=True):
        assert again.name == view.name and np.array_equal(again.image, view.image)
        assert again.camera.world_from_camera == pytest.approx(view.camera.world_from_camera, abs=1e-12)
        assert np.array_equal(again.camera.K, view.camera.K)
    assert model.points == pytest.approx(points)


def test_instant_ngps_angle_gives_the_focal_length_and_the_picture_its_size(tmp_path):
    def edit(meta):
        for key in (*LENS, "camera_model"):
            del meta[key]
        meta["camera_angle_x"] = np.pi / 2
        for i, frame in enumerate(meta["frames"]):
            frame["file_path"] = f"images/f{i}"

    lens = transforms.read(written(tmp_path, edit) / "transforms.json").lenses[0]
    assert lens == {"model": "PINHOLE", "width": 64, "height": 48, "params": [pytest.approx(32), pytest.approx(32), 32, 24]}


def test_a_frames_own_lens_goes_before_the_files(tmp_path):
    def edit(meta):
        meta["frames"][1].update(fl_x=70.0, k1=0.1)
        meta["frames"][2].update(camera_model="OPENCV_FISHEYE", k4=0.01)

    posed, model = adopted(written(tmp_path, edit), tmp_path / "work")
    assert [lens["model"] for lens in posed.lenses] == ["PINHOLE", "OPENCV", "OPENCV_FISHEYE", "PINHOLE"]
    assert posed.lenses[1]["params"] == [70, 61, 31, 25, 0.1, 0, 0, 0]
    assert len(pycolmap.Reconstruction(model.sparse).cameras) == 3


def test_pictures_of_one_name_in_two_folders_are_told_apart(tmp_path):
    def edit(meta):
        (tmp_path / "more").mkdir()
        (tmp_path / "images" / "f1.png").rename(tmp_path / "more" / "f0.png")
        meta["frames"][1]["file_path"] = "more/f0.png"

    assert adopted(written(tmp_path, edit), tmp_path / "work")[1].names == ("images_f0", "images_f2", "images_f3", "more_f0")


def test_a_model_of_colmap_comes_out_as_it_went_in(tmp_path):
    _, first = adopted(written(tmp_path / "given", **BENT), tmp_path / "first")
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (tmp_path / "given" / "images").rename(theirs / "images")
    first.sparse.parent.rename(theirs / "sparse")
    source = inputs.recognise(theirs)
    assert source.kind == "colmap"
    model = colmap.adopt(source.path, source.images, tmp_path / "second", progress=False)
    for a, b in zip(first.cameras, model.cameras, strict=True):
        assert np.array_equal(a.K, b.K) and b.world_from_camera == pytest.approx(a.world_from_camera, abs=1e-12)
    before, after = (pycolmap.Reconstruction(path).cameras[1] for path in (source.path, model.sparse))
    assert before.model == after.model and np.array_equal(before.params, after.params)


def given_by_colmap(folder, *lenses):
    """A model of COLMAP whose pictures take turns to be of one lens or another."""
    model = pycolmap.Reconstruction()
    for number, (name, width, height, params) in enumerate(lenses, start=1):
        model.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=number, model=name, width=width, height=height, params=params))
    for i, pose in enumerate(POSES):
        number, name = 1 + i % len(lenses), f"lens{i % len(lenses)}/{i}.png"
        size = lenses[number - 1][1:3]
        dataset.save_image(folder / "images" / name, np.array(Image.fromarray(picture(i)).resize(size)))
        seen = pycolmap.Rigid3d(np.linalg.inv(pose)[:3])
        model.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=number, image_id=i + 1), seen)
    (folder / "sparse" / "0").mkdir(parents=True)
    model.write(folder / "sparse" / "0")
    return model


def test_a_model_of_several_lenses_comes_out_as_it_went_in_and_straight_pictures_are_kept(tmp_path):
    lenses = ("OPENCV_FISHEYE", 64, 48, [50, 51, 31, 25, 0.02, -0.01, 0.001, 0]), ("PINHOLE", 48, 64, [60, 61, 25, 31])
    theirs = given_by_colmap(tmp_path, *lenses)
    model = colmap.adopt(tmp_path / "sparse" / "0", tmp_path / "images", tmp_path / "work", progress=False)
    assert model.names == ("lens0_0", "lens0_2", "lens1_1", "lens1_3")
    ours = pycolmap.Reconstruction(model.sparse)
    for number, (name, *_, params) in enumerate(lenses, start=1):
        assert ours.cameras[number].model.name == name and ours.cameras[number].params.tolist() == params
    for number, image in theirs.images.items():
        assert np.array_equal(ours.images[number].cam_from_world().matrix(), image.cam_from_world().matrix())
    assert model.cameras[2].K.tolist() == [[60, 0, 25], [0, 61, 31], [0, 0, 1]]
    assert model.images[2].read_bytes() == (tmp_path / "images" / "lens1" / "1.png").read_bytes()
    assert model.views()[0].image.shape == (48, 64, 3) and model.cameras[0].K[0, 0] != 50
    dataset.save_views(tmp_path / "capture", model.views())
    for given, again in zip(model.views(), dataset.load_views(tmp_path / "capture"), strict=True):
        assert np.array_equal(given.camera.K, again.camera.K) and np.array_equal(given.image, again.image)


def test_a_panorama_is_refused_as_no_pinhole(tmp_path):
    given_by_colmap(tmp_path, ("EQUIRECTANGULAR", 64, 32, [64, 32]))
    with pytest.raises(colmap.ReconstructionFailed, match="EQUIRECTANGULAR see all around"):
        colmap.adopt(tmp_path / "sparse" / "0", tmp_path / "images", tmp_path / "work", progress=False)


def turned(meta):
    meta["frames"][2]["transform_matrix"][0][0] = 3.0


BAD = {
    "missing fl_x": lambda meta: meta.pop("fl_x"),
    "frame 1: missing transform_matrix": lambda meta: meta["frames"][1].pop("transform_matrix"),
    r"frame 2 \(./images/f2.png\): .*orthonormal": turned,
    "outside": lambda meta: meta["frames"][0].update(file_path="/etc/hostname"),
    "lies outside the": lambda meta: meta["frames"][0].update(file_path="../x.png"),
    "no such file: images/f9.png": lambda meta: meta["frames"][0].update(file_path="images/f9.png"),
    "no such file: points.ply": lambda meta: meta.update(ply_file_path="points.ply"),
    "must be positive": lambda meta: meta.update(fl_y=-3),
    "must be numbers": lambda meta: meta.update(cx="left"),
    "finite": lambda meta: meta.update(cx=float("nan")),
    "EQUIRECTANGULAR": lambda meta: meta.update(camera_model="EQUIRECTANGULAR"),
    "0 0 0 1": lambda meta: meta["frames"][0].update(transform_matrix=[[1, 2], [3, 4]]),
    "at least one frame": lambda meta: meta.update(frames=[]),
    "only 2 pictures": lambda meta: meta.update(frames=meta["frames"][:2]),
    "64x48, but its camera says 99x48": lambda meta: meta.update(w=99),
    "more than one picture is called f0": lambda meta: meta["frames"][1].update(file_path="images/f0.png"),
}


@pytest.mark.parametrize("message", BAD)
def test_a_bad_file_says_what_is_wrong(tmp_path, message):
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        adopted(written(tmp_path, BAD[message]), tmp_path / "work")
    assert not (tmp_path / "work" / "images").exists()


def test_a_picture_that_exif_turns_is_refused_with_given_cameras(tmp_path):
    folder, exif = written(tmp_path), Image.Exif()
    exif[0x0112] = 3
    Image.fromarray(picture(0)).save(folder / "images" / "f0.png", exif=exif)
    with pytest.raises(colmap.ReconstructionFailed, match="f0.png is turned"):
        adopted(folder, tmp_path / "work")


def test_a_damaged_model_of_colmap_is_refused(tmp_path):
    _, model = adopted(written(tmp_path / "given"), tmp_path / "work")
    (model.sparse / "points3D.bin").write_bytes(b"ab")
    with pytest.raises(colmap.ReconstructionFailed, match="not a readable COLMAP model"):
        colmap.adopt(model.sparse, tmp_path / "given" / "images", tmp_path / "again", progress=False)
    (tmp_path / "given" / "images" / "f1.png").unlink()
    adopted(written(tmp_path / "other"), tmp_path / "whole")
    with pytest.raises(colmap.ReconstructionFailed, match="no such file: f1.png"):
        sparse = tmp_path / "whole" / "colmap" / "sparse" / "0"
        colmap.adopt(sparse, tmp_path / "given" / "images", tmp_path / "again", progress=False)
