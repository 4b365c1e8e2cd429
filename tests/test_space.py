import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.camera import Camera, look_at
from scene.surface.space import FREE, OCCUPIED, UNSEEN, Space, carve

CAMERAS = [Camera.from_fov(look_at(eye, (0, 0, 0)), 80, 60, 60) for eye in ((0.1, 0, 2), (-0.1, 0.1, 2), (0, -0.1, 2.1))]


def floor(camera, height=0.0):
    """Depth of the plane z = height."""
    _, directions = camera.rays(camera.pixel_centres())
    return (height - camera.centre[2]) / directions[..., 2] * (directions @ camera.forward)


def test_above_what_is_seen_space_is_free_and_below_unseen():
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 60)] * 2), -1).reshape(-1, 2)
    surface = np.column_stack([grid, np.zeros(len(grid))])
    space = carve(CAMERAS, [floor(c) for c in CAMERAS], surface, [-0.4, -0.4, -0.31], [0.4, 0.4, 0.49], 0.05)
    x = np.random.default_rng(0).uniform([-0.3, -0.3, -0.3], [0.3, 0.3, 0.4], (500, 3))
    assert (space.status(x[x[:, 2] > 0.06]) == FREE).all() and (space.status(x[x[:, 2] < -0.06]) == UNSEEN).all()
    assert (space.status(surface[np.abs(surface).max(1) < 0.39]) == OCCUPIED).all()
    assert space.status([[9.0, 0, 0], [0, 0, -5.0]]).tolist() == [UNSEEN, UNSEEN]


def test_one_camera_is_not_believed_unknown_depth_frees_nothing_and_the_sky_does():
    x, box = np.array([[0.0, 0, 0.3]]), ([-0.4] * 3, [0.4] * 3, 0.05)
    none = np.empty((0, 3))
    depth = [floor(c) for c in CAMERAS]
    unknown, sky = (np.full_like(depth[0], value) for value in (np.nan, np.inf))
    assert carve(CAMERAS, [depth[0], unknown, unknown], none, *box).status(x) == UNSEEN
    assert carve(CAMERAS, [depth[0], depth[1], unknown], none, *box).status(x) == FREE
    assert carve(CAMERAS, [sky, unknown, sky], none, *box).status(-x) == FREE
    assert carve(CAMERAS, [sky, unknown, sky], none, *box, least=3).status(-x) == UNSEEN


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 0.95))
def test_boxes_fill_the_chosen_voxels_and_no_others(seed, share):
    rng = np.random.default_rng(seed)
    space = Space(rng.normal(size=3), 0.1, np.zeros((5, 6, 7), np.uint8))
    chosen = rng.random((5, 6, 7)) < share
    boxes = space.boxes(chosen)
    inside = ((space.centres()[..., None, :] > boxes[:, 0]) & (space.centres()[..., None, :] < boxes[:, 1])).all(-1)
    np.testing.assert_array_equal(inside.sum(-1), chosen)


def test_what_is_saved_is_read_and_other_files_are_refused(tmp_path):
    space = Space(np.array([0.1, 0.2, 0.3]), 0.02, np.random.default_rng(0).integers(0, 3, (4, 5, 6)).astype(np.uint8))
    space.save(tmp_path / "space.npz")
    again = Space.load(tmp_path / "space.npz")
    np.testing.assert_array_equal(again.labels, space.labels)
    assert (again.lower == space.lower).all() and again.voxel == space.voxel
    with pytest.raises(FileNotFoundError, match="scene.mesh makes it"):
        Space.load(tmp_path / "other.npz")
    for labels in (np.full((2, 2, 2), 7, np.uint8), np.zeros((2, 2), np.uint8), np.array([{"a": 1}], dtype=object)):
        np.savez(tmp_path / "bad.npz", lower=np.zeros(3), voxel=0.1, labels=labels)
        with pytest.raises(ValueError, match="does not say what is free"):
            Space.load(tmp_path / "bad.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "space.npz").read_bytes()[:100])
    with pytest.raises(ValueError, match="does not say what is free"):
        Space.load(tmp_path / "cut.npz")


def test_too_many_voxels_are_refused():
    with pytest.raises(ValueError, match="too many: choose larger ones"):
        carve([], [], np.empty((0, 3)), [0, 0, 0], [1, 1, 1], 0.001)
