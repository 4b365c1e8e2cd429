"""Visual hulls against their definition and against solids that cast the silhouettes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_silhouette import distance, winding

from scene.camera import Camera, look_at
from teach.hull import Region, visual_hull
from teach.sketch import Sketch, SketchError, Stroke

TARGET = np.array([0.5, 0.0, 0.4])
EYES = TARGET + np.array([[-0.8, -0.9, 0.5], [-0.8, 0.9, 0.3], [0.3, 0.2, 1.3], [1.2, -0.1, 0.2], [0.1, -1.3, 0.1],
                          [0.2, 1.2, 0.6], [-1.3, 0.1, 0.1], [0.9, 0.8, 0.4]])  # fmt: skip
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in EYES]
RADIUS = 0.1
L_SHAPE = np.array([[0, 0], [120, 0], [120, 40], [40, 40], [40, 150], [0, 150], [0, 0]])


def outline(pixels, number=0):
    return Stroke(pixels, np.arange(len(pixels)), number, "keep_out")


def outlined(camera, *outlines, name=None):
    strokes = tuple(outline(pixels, number) for number, pixels in enumerate(outlines))
    return Sketch(name or f"v{camera.centre[0]:.1f}{camera.centre[1]:.1f}", camera, strokes)


def contour(camera, centre=TARGET, radius=RADIUS, count=400):
    """Where rays touch a ball, seen by the camera (count, 2) [px]."""
    away = camera.centre - centre
    distance = np.linalg.norm(away)
    away = away / distance
    across = np.cross(away, [0.3, 0.2, 1.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, count)[:, None]
    ring = np.cos(angle) * across + np.sin(angle) * np.cross(away, across)
    return camera.project(centre + radius**2 / distance * away + radius * np.sqrt(1 - (radius / distance) ** 2) * ring)


def silhouette_of(camera, corners):
    """The outline of a convex solid with corners (V, 3)."""
    from scipy.spatial import ConvexHull

    pixels = camera.project(corners)
    around = ConvexHull(pixels).vertices
    return pixels[[*around, around[0]]]


@pytest.mark.parametrize("views", [2, 3, 5, 8])
def test_the_hull_contains_the_ball_that_was_outlined(views):
    (region,) = visual_hull([outlined(camera, contour(camera)) for camera in CAMERAS[:views]])
    directions = np.random.default_rng(0).normal(size=(3000, 3))
    assert region.contains(TARGET + RADIUS * directions / np.linalg.norm(directions, axis=1, keepdims=True)).all()


def test_more_views_shrink_the_hull_towards_the_ball():
    ball = 4 / 3 * np.pi * RADIUS**3
    volumes = [visual_hull([outlined(c, contour(c)) for c in CAMERAS[:n]])[0].volume / ball for n in (2, 3, 5, 8)]
    assert all(a > b > 1 for a, b in zip(volumes, volumes[1:])) and volumes[0] > 1.3 and volumes[-1] < 1.1


def test_a_box_seen_square_on_from_afar_is_recovered():
    size = np.array([0.2, 0.3, 0.16])
    corners = TARGET + size / 2 * (np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T)
    far = [Camera.from_fov(look_at(TARGET + offset, TARGET), 640, 480, 0.5) for offset in ([100, 0, 0], [0, 100, 0.0])]
    (region,) = visual_hull([outlined(camera, silhouette_of(camera, corners)) for camera in far])
    assert region.contains(corners).all()
    assert region.volume == pytest.approx(size.prod(), rel=0.06)  # a pixel is 1.4 mm here
    assert np.ptp(np.concatenate([v for v, _ in region.pieces]), axis=0) == pytest.approx(size, abs=0.005)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
def test_a_point_is_in_the_hull_if_and_only_if_every_view_sees_it_inside_its_silhouette(seed, views):
    rng = np.random.default_rng(seed)
    polygons = [240 + rng.uniform(-150, 150, (rng.integers(3, 7), 2)) for _ in range(views)]
    sketches = [outlined(c, np.vstack([p, p[:1]])) for c, p in zip(CAMERAS, polygons)]
    points = TARGET + np.vstack([rng.uniform(-0.5, 0.5, (2000, 3)), rng.uniform(-5, 5, (2000, 3))])
    try:
        regions = visual_hull(sketches, filled=0)
    except SketchError as error:
        assert "do not meet" in str(error) or "nothing" in str(error)
        regions = (Region("none", ()),)
    seen = [np.nan_to_num(camera.project(points), nan=1e6) for camera in CAMERAS[:views]]  # nan: behind it
    truth = np.all([winding(polygon, pixels) != 0 for polygon, pixels in zip(polygons, seen)], axis=0)
    near = np.any([distance(polygon, pixels) < 1.2 for polygon, pixels in zip(polygons, seen)], axis=0)
    assert (regions[0].contains(points) == truth)[~near].all()


def test_what_is_filled_is_only_ever_more():
    outlines = [L_SHAPE * scale + shift for scale, shift in ((1.3, (200, 150)), (1.5, (220, 120)))]
    sketches = [outlined(c, pixels) for c, pixels in zip(CAMERAS, outlines)]
    exact, filled = (visual_hull(sketches, filled=share)[0] for share in (0, 0.05))
    points = TARGET + np.random.default_rng(0).uniform(-0.4, 0.4, (5000, 3))
    assert filled.contains(points)[exact.contains(points)].all()
    assert len(filled.pieces) < len(exact.pieces) and filled.volume > exact.volume


def test_pieces_are_convex_closed_and_look_outwards():
    sketches = [outlined(c, 1.3 * L_SHAPE + (220, 150)) for c in CAMERAS[:2]]
    (region,) = visual_hull(sketches)
    assert len(region.pieces) > 1
    for vertices, faces in region.pieces:
        a, b, c = vertices[faces].swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        assert ((vertices[None] - a[:, None]) * normals[:, None]).sum(-1).max() < 1e-6
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert region.contains(region.edges.mean(axis=1)).all()


def test_numbers_tell_regions_apart_whatever_the_order():
    centres = TARGET + [[0, 0, 0], [0, 0.25, 0.1]]
    first = outlined(CAMERAS[0], *(contour(CAMERAS[0], centre, 0.05) for centre in centres))
    second = outlined(CAMERAS[2], *(contour(CAMERAS[2], centre, 0.05) for centre in centres))
    second = Sketch(second.view, second.camera, second.strokes[::-1])
    one, two = visual_hull([first, second])
    assert (one.name, two.name) == ("keep-out region 1", "keep-out region 2")
    assert np.array([r.contains(centres) for r in (one, two)]).tolist() == [[True, False], [False, True]]


def test_a_single_region_needs_no_numbers():
    views = [Sketch(f"v{k}", c, (outline(contour(c), number=3 - k),)) for k, c in enumerate(CAMERAS[:2])]
    (region,) = visual_hull(views)
    assert region.name == "keep-out region" and region.contains(TARGET)


def test_strokes_of_the_motion_bound_nothing():
    assert visual_hull([Sketch("a", CAMERAS[0], (Stroke([[0, 0], [9, 9]], [0, 1]),))]) == ()
    assert visual_hull([]) == ()


def displaced(*offsets):
    """Each view outlines the ball, but at another place."""
    return [outlined(c, contour(c, TARGET + x), name=f"v{k}") for k, (c, x) in enumerate(zip(CAMERAS, offsets))]


@pytest.mark.parametrize(
    "sketches, words",
    [
        ([outlined(CAMERAS[0], contour(CAMERAS[0]), name="left")], "only on view 'left'"),
        ([outlined(c, contour(c)[:250], name=f"v{k}") for k, c in enumerate(CAMERAS[:2])], "view 'v0' is not closed"),
        (displaced([0, 0, 0], [0, 0, 0.4]), "views 'v0' and 'v1' do not meet"),
        (displaced([0, 0, 0], [0, 0, 0], [0.4, -0.4, 0]), "views 'v0' and 'v2' do not meet"),
        ([outlined(CAMERAS[0], contour(CAMERAS[0]), name=name) for name in "ab"], "same side"),
        ([outlined(CAMERAS[0], contour(CAMERAS[0]), name="a")] * 2, "put all strokes of a view in one sketch"),
        ([outlined(CAMERAS[0], *[contour(CAMERAS[0])] * 2, name="a"), outlined(CAMERAS[1], contour(CAMERAS[1]))],
         "keep-out region 2 is outlined only on view 'a'"),
    ],
)  # fmt: skip
def test_outlines_that_bound_no_region_are_refused_in_words(sketches, words):
    with pytest.raises(SketchError, match=words):
        visual_hull(sketches)


def test_views_from_nearly_the_same_side_bound_nothing():
    beside = Camera.from_fov(look_at(EYES[0] + [0.01, 0, 0], TARGET), 640, 480, 55)
    with pytest.raises(SketchError, match="same side"):
        visual_hull([outlined(c, contour(c), name=name) for c, name in ((CAMERAS[0], "a"), (beside, "b"))])
