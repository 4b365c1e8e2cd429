"""Strokes on one view are laid on the surface that its depth picture shows; contacts touch it."""

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.align import common_times
from teach.basis import SquaredExponential
from teach.contact import contacts, touch, warnings
from teach.depth import surface_points
from teach.sketch import Event, Sketch, SketchError, Stroke
from teach.surface import fit_surface, lift
from teach.trajectory import TrajectoryDistribution

CAMERA = Camera.from_fov(look_at((-0.4, -0.6, 0.8), (0.5, 0.0, 0.0)), 640, 480, 55)
OTHER = Camera.from_fov(look_at((-0.3, 0.8, 0.7), (0.5, 0.0, 0.0)), 640, 480, 55)
UP = np.array([0.0, 0.0, 1.0])
TILTED = np.array([-0.3, -0.2, 1.0]) / np.linalg.norm([-0.3, -0.2, 1.0])
T = np.linspace(0, 1, 100)
HOW = {"count": 100, "covariance": "coherent", "smoothness": 1e-10, "strength": 20.0}


def rays(camera):
    origins, directions = camera.rays(camera.pixel_centres())
    return origins, directions / (directions @ camera.forward)[..., None]  # of unit depth


def plane(n, height=0.0, camera=CAMERA):
    """Depth of the plane with normal n through (0.5, 0, height)."""
    origins, directions = rays(camera)
    z = (([0.5, 0.0, height] - origins) @ n) / (directions @ n)
    return np.where(z > 0, z, np.nan)


def sphere(centre, radius, camera=CAMERA):
    origins, directions = rays(camera)
    away, square = origins - centre, (directions**2).sum(-1)
    half = (directions * away).sum(-1)
    inside = half**2 - square * ((away**2).sum(-1) - radius**2)
    return np.where(inside > 0, (-half - np.sqrt(np.maximum(inside, 0))) / square, np.nan)


def noise(depth, metres=0.003, seed=0):
    return depth + metres * np.random.default_rng(seed).standard_normal(depth.shape)


def met(pixels, n=UP, camera=CAMERA):
    """Where the rays of pixels (N, 2) meet the plane with normal n through (0.5, 0, 0)."""
    origins, directions = camera.rays(pixels)
    return origins + ((([0.5, 0, 0] - origins) @ n) / (directions @ n))[:, None] * directions


def sketch(*lines, camera=CAMERA, events=(), view="v"):
    """Strokes (N, 3) [m] as the camera sees them, each drawn in 3 s."""
    strokes = [Stroke(camera.project(x), np.linspace(0, 3, len(x)), events=tuple(events)) for x in lines]
    return Sketch(view, camera, tuple(strokes))


def straight(y=0.0, count=200):
    s = np.linspace(-0.2, 0.2, count)
    return np.stack([0.5 + 0.3 * s, s + y, 0 * s], axis=1)


def loop(n=UP):
    """A letter-like line on the plane with normal n, that turns back."""
    s = np.linspace(0, 1, 150)
    x, y = 0.5 + 0.1 * np.sin(6 * s), 0.3 * s - 0.15
    return np.stack([x, y, -(n[0] * (x - 0.5) + n[1] * y) / n[2]], axis=1)


def laid(drawn, depth, offset=0.0):
    return lift(drawn, depth, common_times([drawn], "arc_length", "uniform").times[0], 100, offset)


def shielded(depth, drawn, width, away=0.3, at=50):
    """Something ``width`` [px] wide that stands ``away`` [m] before the surface across the middle of the stroke."""
    u = CAMERA.project(laid(drawn, depth).points[0, at])[0]
    columns = np.abs(CAMERA.pixel_centres()[..., 0] - u) < width / 2
    return np.where(columns, depth - away, depth)


def angle(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


@pytest.mark.parametrize("n", [UP, TILTED])
def test_on_a_plane_points_are_where_rays_meet_it_and_normals_are_its_own(n):
    pixels = np.random.default_rng(0).uniform([20, 200], [620, 470], (50, 2))
    points, normals, seen = surface_points(CAMERA, plane(n), pixels)
    assert seen.all() and np.abs(points - met(pixels, n)).max() < 1e-12
    assert np.abs(normals - n).max() < 1e-9


def test_a_plane_seen_from_below_has_its_normal_below():
    below = Camera.from_fov(look_at((-0.4, -0.6, -0.8), (0.5, 0.0, 0.0)), 640, 480, 55)
    _, normals, _ = surface_points(below, plane(UP, camera=below), [[320, 240]])
    assert normals[0] == pytest.approx(-UP)


@pytest.mark.parametrize("metres, degrees", [(0.0, 2.0), (0.003, 3.0)])
def test_the_normals_of_a_sphere_point_away_from_its_middle(metres, degrees):
    centre, radius = np.array([0.5, 0.0, 0.1]), 0.12
    s, turn = np.sqrt(np.random.default_rng(0).uniform(0, 0.6, 60)), np.linspace(0, 6.28, 60)
    reach = radius * CAMERA.K[0, 0] / CAMERA.depth(centre)
    pixels = CAMERA.project(centre) + reach * (s * np.array([np.cos(turn), np.sin(turn)])).T
    points, normals, seen = surface_points(CAMERA, noise(sphere(centre, radius), metres), pixels)
    distance = np.linalg.norm(points - centre, axis=1)
    assert seen.all() and angle(normals, (points - centre) / distance[:, None]).max() < degrees
    assert np.abs(distance - radius).max() < 0.0015


def test_near_an_edge_the_normal_is_that_of_one_surface():
    box = plane(UP, 0.1)
    columns = CAMERA.pixel_centres()[..., 0]
    depth = np.where(columns < 320, box, plane(TILTED))
    for u, n in ((316, UP), (324, TILTED)):
        points, normals, _ = surface_points(CAMERA, depth, [[u, 300.0]])
        assert angle(normals, n).max() < 0.01
    assert points[0] == pytest.approx(met(np.array([[324, 300.0]]), TILTED)[0])


def test_depth_of_another_resolution_is_the_same_surface():
    half = CAMERA.resized(320, 240)
    points, normals, _ = surface_points(CAMERA, plane(TILTED, camera=half), [[401.3, 350.2]])
    assert np.abs(points - met([[401.3, 350.2]], TILTED)).max() < 1e-12 and normals[0] == pytest.approx(TILTED)


@pytest.mark.parametrize("shape", [(640, 480), (480, 600), (480, 640, 1)])
def test_the_depth_of_another_picture_is_refused_in_words(shape):
    with pytest.raises(SketchError, match="does not show a view of 480 x 640"):
        surface_points(CAMERA, np.ones(shape), [[1, 1]])


def test_what_is_outside_or_without_depth_is_unseen():
    depth = plane(UP)
    depth[:, 400:] = np.nan
    points, normals, seen = surface_points(CAMERA, depth, [[300, 400], [-3, 400], [500, 400], [np.nan, 3]])
    assert seen.tolist() == [True, False, False, False]
    assert np.isnan(points[1:]).all() and np.isnan(normals[1:]).all()
    nothing = np.full((480, 640), np.nan)
    assert not surface_points(CAMERA, nothing, [[300, 400]])[2].any()


@pytest.mark.parametrize("offset", [0.0, 0.05, -0.01])
def test_a_stroke_is_laid_at_the_offset_from_where_its_rays_meet_the_surface(offset):
    drawn = sketch(loop(TILTED))
    lifted = laid(drawn, plane(TILTED), offset)
    expected = met(drawn.strokes[0].at(T), TILTED) + offset * TILTED
    furthest = np.linalg.norm(lifted.points[0][:, None] - expected, axis=2).min(axis=1).max()
    assert furthest < 0.003 and np.abs((lifted.points[0] - [0.5, 0, 0]) @ TILTED - offset).max() < 1e-9
    assert lifted.bridged == [0] and lifted.jumps == [0]


def test_noise_of_millimetres_moves_a_stroke_by_less_than_one():
    lifted = laid(sketch(loop()), noise(plane(UP)))
    assert np.abs(lifted.points[..., 2]).max() < 0.001 and lifted.bridged.max() == 0


@pytest.mark.parametrize("width", [3, 6, 10])
def test_a_thin_leg_before_the_surface_is_bridged(width):
    drawn = sketch(straight())
    lifted = laid(drawn, shielded(noise(plane(UP)), drawn, width), 0.02)
    assert np.abs(lifted.points[..., 2] - 0.02).max() < 0.002
    assert lifted.bridged[0] < 0.1 and lifted.jumps[0] == 0


def test_a_leg_before_the_end_of_a_stroke_is_bridged_too():
    drawn = sketch(straight())
    lifted = laid(drawn, shielded(plane(UP), drawn, 10, at=97))
    assert np.abs(lifted.points[..., 2]).max() < 0.002


def test_a_hole_is_bridged_and_a_large_one_refused_with_how_much_and_where():
    drawn, depth = sketch(straight()), plane(UP)
    columns = CAMERA.pixel_centres()[..., 0]
    u, v = CAMERA.project(straight()[100])
    hole = np.where(np.abs(columns - u) < 14, np.nan, depth)
    lifted = laid(drawn, hole)
    assert np.abs(lifted.points[..., 2]).max() < 1e-9 and 0 < lifted.bridged[0] < 0.1
    with pytest.raises(SketchError, match=rf"stroke 0 on view 'v' has no surface under \d\d% .*around pixel {u:.0f}, "):
        laid(drawn, np.where(np.abs(columns - u) < 60, np.nan, depth))
    with pytest.raises(SketchError, match="under 100%"):
        laid(drawn, np.full_like(depth, np.nan))


def test_a_stroke_that_leaves_the_picture_is_refused():
    with pytest.raises(SketchError, match="draw it where the depth picture shows a surface"):
        laid(sketch(straight() * [1, 4, 1]), plane(UP))


def test_a_surface_that_is_all_jumps_is_refused():
    drawn, columns = sketch(straight()), CAMERA.pixel_centres()[..., 0]
    with pytest.raises(SketchError, match="no smooth surface under"):
        laid(drawn, np.where(columns % 24 < 12, plane(UP), 0.5 * plane(UP)) * (1 + 0.03 * (columns // 7 % 3)))


def test_a_box_on_the_table_is_climbed_and_its_far_edge_reported():
    depth = plane(UP)
    height = np.where(np.isfinite(plane(UP, 0.1)), plane(UP, 0.1), np.inf)
    u = CAMERA.project([0.5, 0.0, 0.05])[0]
    box = np.where(CAMERA.pixel_centres()[..., 0] < u, height, depth)
    lifted = laid(sketch(straight()), box)
    z = lifted.points[0, :, 2]
    assert min(np.abs(z[:35] - 0.1).max(), np.abs(z[-35:] - 0.1).max()) < 1e-6
    assert min(np.abs(z[:35]).max(), np.abs(z[-35:]).max()) < 1e-6
    assert ((np.abs(z) < 1e-6) | (np.abs(z - 0.1) < 1e-6)).mean() > 0.93 and lifted.jumps[0] > 0.05


def fitted(depth, lines, offset=0.0, **how):
    drawn = sketch(*lines)
    mean, S, report = fit_surface(drawn, depth, common_times([drawn], "arc_length", "uniform").times[0], SquaredExponential(),
                                  offset=offset, **HOW | how)  # fmt: skip
    return TrajectoryDistribution(SquaredExponential(), mean, S), report


def test_samples_stay_along_the_surface_as_near_as_depth_is_known():
    lines = [loop(TILTED) + d * np.cross(TILTED, [1.0, 0, 0]) for d in (-0.02, 0.0, 0.02)]
    distribution, _ = fitted(noise(plane(TILTED)), lines)
    samples = distribution.sample(300, T, np.random.default_rng(0))
    off = (samples - [0.5, 0, 0]) @ TILTED
    along = samples.std(axis=0)
    assert off.std() < 0.004 and np.abs(off.mean()) < 0.001
    assert np.sqrt((along**2).sum(-1) - off.var(axis=0)).min() > 0.01


def test_a_motion_that_starts_above_the_surface_comes_down_to_it_and_stays():
    distribution, _ = fitted(noise(plane(UP)), [loop(), loop() + [0.01, 0, 0]])
    mean = distribution.condition(0.0, loop()[0] + [0, 0, 0.3]).mean_at(T)
    assert np.abs(mean[50:, 2]).max() < 0.005 and mean[:, 2].max() < 0.303 and mean[:, 2].min() > -0.005
    assert np.linalg.norm(mean - distribution.mean_at(T), axis=1).max() < 0.31


def test_independent_weights_are_fitted_too():
    distribution, _ = fitted(plane(UP), [loop(), loop() + [0.02, 0, 0]], covariance="diagonal")
    deviation = distribution.sample(300, T, np.random.default_rng(0)).std(axis=0)
    assert 0.003 < deviation[:, 0].mean() < 0.02 and deviation[:, 2].max() < 0.005


def test_the_report_says_that_the_motion_runs_on_a_surface():
    _, report = fitted(plane(UP), [loop()], offset=0.02)
    assert report["surface"]["view"] == "v" and report["surface"]["offset_m"] == 0.02
    assert report["surface"]["miss_mm"] < 1 and report["reprojection_px"]["v"] < 0.5
    assert "20 mm off the surface" in report["warnings"][0] and "has one stroke" in report["warnings"][-1]


def test_an_offset_is_a_number():
    with pytest.raises(ValueError, match="offset"):
        fitted(plane(UP), [loop()], offset=np.nan)


# Contacts


def marked(line, *times, camera=CAMERA, view="v"):
    return sketch(line, camera=camera, events=[Event("contact", t) for t in times], view=view)


def found(sketches, depths):
    return contacts(sketches, common_times(sketches, "drawn").times, depths)


def test_a_contact_is_where_the_ray_of_its_pixel_meets_the_surface():
    (contact,) = found([marked(straight(), 3.0)], {"v": plane(UP)})
    assert contact.time == 1 and np.abs(contact.point - straight()[-1]).max() < 1e-9
    # Across the ray as wide as a single stroke's hand, along it as deep as depth is uncertain
    n, z = UP, CAMERA.depth(contact.point)
    ray = (contact.point - CAMERA.centre) / z
    assert np.sqrt(n @ contact.covariance @ n) == pytest.approx(0.002 * z * abs(n @ ray))
    P = CAMERA.projection
    J = (P[:2, :3] - np.outer(CAMERA.project(contact.point), P[2, :3])) / z
    assert J @ contact.covariance @ J.T == pytest.approx(6.4**2 * np.eye(2))


def test_views_that_mark_the_same_moment_are_combined_by_information():
    a, b = marked(straight(), 3.0), marked(straight() + [0.0, 0.01, 0.0], 2.9, camera=OTHER, view="w")
    depths = {"v": plane(UP), "w": plane(UP, camera=OTHER)}
    (both,) = found([a, b], depths)
    (one,), (two,) = found([a], depths), found([b], depths)
    A, B = np.linalg.inv(one.covariance), np.linalg.inv(two.covariance)
    assert np.linalg.inv(both.covariance) == pytest.approx(A + B)
    assert (A + B) @ both.point == pytest.approx(A @ one.point + B @ two.point)
    assert sorted(both.views) == ["v", "w"]


def test_strokes_of_a_view_agree_the_better_the_more_they_are():
    lines = [straight() + [d, 0.0, 0.0] for d in (-0.01, 0.0, 0.01)]
    (contact,) = found([sketch(*lines, events=[Event("contact", 3.0)])], {"v": plane(UP)})
    assert np.abs(contact.point - straight()[-1]).max() < 0.001
    ends = np.stack([CAMERA.project(line[-1]) for line in lines])
    spread = ((ends - ends.mean(axis=0)) ** 2).sum() / 4 / 3
    P, z = CAMERA.projection, CAMERA.depth(contact.point)
    J = (P[:2, :3] - np.outer(CAMERA.project(contact.point), P[2, :3])) / z
    assert J @ contact.covariance @ J.T == pytest.approx(spread * np.eye(2))


def test_contacts_at_clearly_different_times_are_different():
    first, last = found([marked(straight(), 0.0, 3.0)], {"v": plane(UP)})
    assert (first.time, last.time) == (0, 1) and np.abs(first.point - straight()[0]).max() < 1e-9


def test_the_mean_meets_contacts_even_where_the_motion_is_known_too_well():
    basis = SquaredExponential(20, 50.0)
    W = np.linalg.lstsq(basis(T), straight(count=100) + [0, 0, 0.01], rcond=1e-9)[0]
    at = found([marked(straight(), 0.0, 3.0)], {"v": plane(UP)})
    for variance in (1e-2, 1e-6, 1e-10):
        touching = touch(TrajectoryDistribution(basis, W, variance * np.eye(60)), at)
        assert np.abs(touching.mean_at([0, 1]) - straight()[[0, -1]]).max() < 1e-9
        spread = np.linalg.eigvalsh(touching.covariance_at([0, 1]))
        assert (spread <= np.linalg.eigvalsh(np.stack([c.covariance for c in at])) + 1e-12).all()


def test_without_contacts_nothing_changes():
    distribution = TrajectoryDistribution(SquaredExponential(20, 50.0), np.zeros((20, 3)), np.eye(60))
    assert touch(distribution, found([sketch(straight())], {"v": plane(UP)})) is distribution


def test_a_contact_without_a_surface_is_refused_and_one_without_depth_is_told():
    drawn = [marked(straight(), 3.0)]
    with pytest.raises(SketchError, match="contact marked on view 'v' .* has no surface"):
        found(drawn, {"v": np.full((480, 640), np.nan)})
    assert found(drawn, {}) == [] and "depth picture is missing" in warnings(drawn, [], {})[0]


def test_views_that_see_different_things_are_told():
    drawn = [marked(straight(), 3.0), marked(straight(), 3.0, camera=OTHER, view="w")]
    agree, differ = ({"v": plane(UP), "w": plane(UP, h, camera=OTHER)} for h in (0.0, 0.2))
    assert warnings(drawn, found(drawn, agree), agree) == []
    assert "mark it where both see the same thing" in warnings(drawn, found(drawn, differ), differ)[0]
