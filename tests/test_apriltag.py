import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from similarities import random_similarity, unscaled

from scene.camera import Camera, look_at
from scene.frame import apriltag
from scene.frame.apriltag import TagLayout
from scene.model import ReconstructionFailed

TAGS = Path(__file__).parents[2] / "shared" / "data" / "tags"
SIZE = 0.12


def pose(x=0.0, y=0.0, z=0.0, yaw_deg=0.0, tilt_deg=0.0):
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    a, b = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [[1, 0, 0], [0, a, -b], [0, b, a]]
    matrix[:3, 3] = x, y, z
    return matrix


POSES = {3: pose(0.4, -0.3, 0, 20), 5: pose(0.9, 0.4, 0.1, 130), 8: pose(0.8, -0.4, 0.05, 0, 40), 11: pose(0.3, 0.4)}
LAYOUT = TagLayout(SIZE, POSES)


def cameras(count=8):
    angles = np.linspace(0, 5, count)
    eyes = [(0.6 + 1.2 * np.cos(a), 1.2 * np.sin(a), 0.9 + 0.1 * np.sin(3 * a)) for a in angles]
    return [Camera.from_fov(look_at(eye, (0.6, 0, 0)), 640, 480, 50) for eye in eyes]


def detections(layout=LAYOUT, noise_px=0.0, seed=0):
    rng = np.random.default_rng(seed)
    corners = layout.corners()
    return [{n: camera.project(corners[n]) + rng.normal(0, noise_px, (4, 2)) for n in corners} for camera in cameras()]


# Detection


@pytest.mark.skipif(not TAGS.exists(), reason="no official tag pictures here")
@pytest.mark.parametrize("number", range(8))
def test_corners_of_the_official_pictures_go_counter_clockwise_from_the_bottom_left(number):
    cells = np.array(Image.open(TAGS / f"tag36_11_{number:05d}.png").convert("L"))
    picture = np.pad(np.kron(cells, np.ones((20, 20), np.uint8)), 40, constant_values=255)
    found = apriltag.detect(picture)
    assert list(found) == [number]
    low, high = 40 + 20, 40 + 9 * 20  # the black square's edges: cells 1 to 9 of 10
    assert np.abs(found[number] - [[low, high], [high, high], [high, low], [low, low]]).max() < 0.6


def tag_photograph(camera, number, world_from_tag, oversampling=4):
    """A tag on grey, rendered with area sampling."""
    large = camera.resized(camera.width * oversampling, camera.height * oversampling)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = cv2.rotate(cv2.aruco.generateImageMarker(dictionary, number, 8), cv2.ROTATE_180)
    picture = cv2.resize(np.pad(cells, 1, constant_values=255), (800, 800), interpolation=cv2.INTER_NEAREST)
    corners = TagLayout(SIZE * 10 / 8, {number: world_from_tag}).corners()[number][::-1]  # from the top left, clockwise
    source = np.array([[0, 0], [800, 0], [800, 800], [0, 800]], np.float32) - 0.5
    H = cv2.getPerspectiveTransform(source, (large.project(corners) - 0.5).astype(np.float32))
    canvas = cv2.warpPerspective(picture, H, (large.width, large.height), borderValue=140)
    return cv2.resize(canvas, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def test_detected_corners_are_unbiased_and_exact_to_a_tenth_of_a_pixel():
    rng, errors = np.random.default_rng(0), []
    for number in range(20, 50):
        eye = rng.normal(size=3) * [0.4, 0.4, 0] + [0, 0, rng.uniform(0.6, 1.3)]
        camera = Camera.from_fov(look_at(eye, rng.normal(size=3) * [0.1, 0.1, 0]), 640, 480, 50)
        world_from_tag = pose(yaw_deg=rng.uniform(0, 360))
        found = apriltag.detect(tag_photograph(camera, number, world_from_tag))
        true = camera.project(TagLayout(SIZE, {number: world_from_tag}).corners()[number])
        errors += [found[number] - true] if number in found else []
    errors = np.array(errors)
    assert len(errors) >= 25
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.03
    assert np.median(np.linalg.norm(errors, axis=-1)) < 0.1


def test_a_picture_without_tags_shows_none():
    assert apriltag.detect(np.full((100, 120, 3), 128, np.uint8)) == {}


# Layout


def test_corners_lie_half_the_size_from_the_tags_centre():
    corners = TagLayout(0.2, {7: pose(1, 2, 3)}).corners()[7]
    assert np.allclose(corners, [[0.9, 1.9, 3], [1.1, 1.9, 3], [1.1, 2.1, 3], [0.9, 2.1, 3]])


def test_a_layout_returns_exactly_as_saved(tmp_path):
    LAYOUT.save(tmp_path / "tags.json")
    loaded = TagLayout.load(tmp_path / "tags.json")
    assert loaded.size == LAYOUT.size and loaded.ids == LAYOUT.ids
    assert all(np.array_equal(loaded.base_from_tag[n], LAYOUT.base_from_tag[n]) for n in LAYOUT.ids)


BROKEN = {
    "missing size": lambda c: c.pop("size"),
    "missing base_from_tag": lambda c: c["tags"]["3"].clear(),
    "positive length": lambda c: c.update(size=-0.1),
    "family must be 36h11": lambda c: c.update(family="25h9"),
    "tag 900 is not in 36h11": lambda c: c["tags"].update({"900": c["tags"]["3"]}),
    "tag 3: .*rigid": lambda c: c["tags"]["3"]["base_from_tag"][0].__setitem__(0, 5.0),
    "at least one tag": lambda c: c.update(tags={}),
    "tags 3 and 4 lie in the same place": lambda c: c.update(tags={"3": c["tags"]["3"], "4": c["tags"]["3"]}),
    "tags must be like": lambda c: c.update(tags=[1]),
    "each number with its 4 x 4 pose": lambda c: c["tags"].update({"3": c["tags"]["3"]["base_from_tag"]}),
}


@pytest.mark.parametrize("message", BROKEN)
def test_a_broken_layout_says_what_is_wrong(tmp_path, message):
    LAYOUT.save(tmp_path / "tags.json")
    content = json.loads((tmp_path / "tags.json").read_text())
    BROKEN[message](content)
    (tmp_path / "tags.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=message):
        TagLayout.load(tmp_path / "tags.json")


def test_a_layout_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such tag layout"):
        TagLayout.load(tmp_path / "tags.json")


# The frame


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_exact_tags_return_the_exact_frame(seed):
    true = random_similarity(seed)
    found = apriltag.fit_frame(detections(), unscaled(true, cameras()), LAYOUT)
    assert np.allclose(found.matrix, true.matrix, atol=1e-6 * true.scale)
    assert found.residual_mm < 1e-3 and set(found.used) == set(LAYOUT.ids)


def test_noise_of_a_fifth_of_a_pixel_leaves_the_frame_within_a_millimetre():
    true = random_similarity(4)
    found = apriltag.fit_frame(detections(noise_px=0.2), unscaled(true, cameras()), LAYOUT)
    errors = [np.linalg.norm(found.move(c).centre - t.centre) for c, t in zip(unscaled(true, cameras()), cameras())]
    assert np.max(errors) < 1e-3
    assert 0.02 < found.residual_mm < 1


def test_a_tag_that_is_not_where_the_layout_says_is_left_out():
    moved = TagLayout(SIZE, LAYOUT.base_from_tag | {5: pose(0.9, 0.45, 0.1, 130)})
    true = random_similarity(5)
    found = apriltag.fit_frame(detections(moved, 0.2), unscaled(true, cameras()), LAYOUT)
    assert set(found.used) == {3, 8, 11} and found.residual_mm < 1
    assert found.residuals_mm[5] == pytest.approx(50, abs=2)
    assert "tag 5 lies 50 mm" in found.warnings[0] and "tags 3, 8, 11 of 120 mm" in found.rests_on
    assert np.allclose(found.matrix, true.matrix, atol=5e-3)


def test_a_wrong_detection_in_some_views_does_no_harm():
    seen = detections(noise_px=0.2)
    seen[0][3], seen[2][3] = seen[0][3] + 40, seen[2][3][[1, 2, 3, 0]]
    true = random_similarity(6)
    found = apriltag.fit_frame(seen, unscaled(true, cameras()), LAYOUT)
    assert set(found.used) == set(LAYOUT.ids) and found.residual_mm < 1


def test_a_layout_of_another_size_is_refused_or_shows_in_the_residual():
    wrong = TagLayout(SIZE, {n: pose(*(2 * p[:3, 3])) for n, p in LAYOUT.base_from_tag.items()})
    with pytest.raises(ReconstructionFailed, match="do not lie as the layout says.*of 4 tags"):
        apriltag.fit_frame(detections(), unscaled(random_similarity(1), cameras()), wrong)


def test_one_tag_alone_is_enough_for_a_frame():
    one = TagLayout(SIZE, {8: LAYOUT.base_from_tag[8]})
    true = random_similarity(7)
    found = apriltag.fit_frame(detections(one), unscaled(true, cameras()), one)
    assert np.allclose(found.matrix, true.matrix, atol=1e-5) and found.used == (8,)


def test_one_small_tag_far_away_is_said_to_be_unsure_and_a_tiny_one_refused():
    true = random_similarity(7)
    for size, outcome in ((0.03, "unsure"), (0.004, "refused")):
        one = TagLayout(size, {8: LAYOUT.base_from_tag[8]})
        seen = detections(one, 0.1)
        if outcome == "refused":
            with pytest.raises(ReconstructionFailed, match="tag 8 of 4 mm.*may be off|do not lie|leaves the frame open"):
                apriltag.fit_frame(seen, unscaled(true, cameras()), one)
        else:
            found = apriltag.fit_frame(seen, unscaled(true, cameras()), one)
            assert found.uncertainty_mm > 5 and "tag 8 of 30 mm" in found.warnings[0]


def test_tags_seen_once_or_foreign_tags_are_listed_in_the_refusal():
    seen = [{} for _ in cameras()]
    seen[0], seen[3] = {3: detections()[0][3], 99: detections()[0][5]}, {99: detections()[3][5]}
    with pytest.raises(ReconstructionFailed, match=r"\(3, 5, 8, 11\).*tag 3 in 1, tag 99 in 2"):
        apriltag.fit_frame(seen, cameras(), LAYOUT)
    with pytest.raises(ReconstructionFailed, match="no tag in any"):
        apriltag.fit_frame([{}] * 8, cameras(), LAYOUT)
