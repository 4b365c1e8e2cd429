import json

import numpy as np
import pytest

from scene import masks
from scene.camera import Camera, View, look_at
from scene.colmap import adopt
from scene.dataset import load_views, read_mask, save_image, save_mask, save_views
from scene.photographs import Photographs
from scene.transforms import read

CAMERA = Camera.from_fov(look_at((1, 0, 0.5), (0, 0, 0)), 60, 40, 50)
LEFT = np.arange(60)[None] < 30 + 0 * np.arange(40)[:, None]


def picture(seed=0):
    return np.random.default_rng(seed).integers(0, 255, (40, 60, 3)).astype(np.uint8)


@pytest.fixture
def photographs(tmp_path):
    files = [tmp_path / "photos" / f"{i}.png" for i in range(3)]
    for i, file in enumerate(files):
        save_image(file, picture(i))
    return files


@pytest.mark.parametrize("name", ["1.png", "1.png.png", "1.jpg"])
def test_masks_lie_beside_or_in_the_folder_and_are_named_like_photographs(photographs, name):
    for folder in (photographs[0].parent, photographs[0].parent.parent):
        path = folder / "masks" / name
        save_mask(path, LEFT)
        assert masks.find(photographs) == {"1": path}
        np.testing.assert_array_equal(read_mask(path), LEFT)
        path.unlink()
        path.parent.rmdir()
    assert masks.find(photographs) == {}


def test_masks_that_cannot_be_meant_are_refused(photographs):
    folder = photographs[0].parent / "masks"
    save_mask(folder / "7.png", LEFT)
    with pytest.raises(ValueError, match="masks of no photograph: 7.png"):
        masks.find(photographs)
    (folder / "7.png").rename(folder / "1.png")
    save_mask(folder / "2.png", LEFT.T)
    with pytest.raises(ValueError, match=r"2.png is 40x60, its photograph \(upright\) 60x40"):
        masks.find(photographs)
    save_mask(folder / "2.png", LEFT & False)
    with pytest.raises(ValueError, match="2.png is all black"):
        masks.find(photographs)


def test_views_keep_their_masks_in_a_capture_folder(tmp_path):
    save_views(tmp_path, [View("a", CAMERA, picture(), LEFT), View("b", CAMERA, picture(1))])
    a, b = load_views(tmp_path)
    np.testing.assert_array_equal(a.mask, LEFT)
    assert b.mask is None
    frames = json.loads((tmp_path / "transforms.json").read_text())["frames"]
    assert frames[0]["mask_path"] == "colmap/masks/a.png" and "mask_path" not in frames[1]


def test_masks_of_a_transforms_json_come_through_and_are_undistorted_with_their_pictures(tmp_path):
    given = tmp_path / "given"
    save_views(given, [View(str(i), CAMERA, picture(i), LEFT) for i in range(3)])
    meta = json.loads((given / "transforms.json").read_text())
    (given / "transforms.json").write_text(json.dumps(meta | {"k1": -0.3}))
    posed = read(given / "transforms.json")
    model = adopt(posed, posed.root, tmp_path / "work", progress=False)
    for view in model.views():
        edge = view.mask.argmin(axis=1)
        assert view.image.shape[:2] == view.mask.shape and (np.abs(edge - 30) <= 1).all()


def test_no_ray_is_drawn_through_what_is_masked():
    views = [View("a", CAMERA, np.where(LEFT[..., None], 200, 10).astype(np.uint8).repeat(3, 2), LEFT), View("b", CAMERA, picture())]
    drawn = Photographs.of(views, np.zeros(3), 1.0, 2)
    rays, colours, _ = drawn.draw(np.random.default_rng(0), 3000, 0.0)
    of_a = (rays.origins == drawn.origins[0]).all(1) & (colours == colours[:, :1]).all(1)
    assert np.abs(colours[of_a] - 200 / 255).max() < 1e-6 and 0.2 < of_a.mean() < 0.5
