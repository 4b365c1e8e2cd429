from dataclasses import dataclass

import numpy as np
import pytest

from scene.camera import Camera, look_at, ray_distance
from teach.raytrace import Algorithm1, ExactRays, information_form

TARGET = np.array([0.5, 0.0, 0.4])
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in ((-0.3, -0.9, 0.9), (-0.3, 0.9, 0.9))]


@dataclass(frozen=True)
class Spot:
    """A round Gaussian [px] around the projection of a point that moves along x with t; shift [px] displaces it."""

    camera: Camera
    spread: float = 3.0
    shift: tuple = (0.0, 0.0)

    def centre(self, t):
        return self.camera.project(point(t)) + self.shift

    def log_prob(self, t, points):
        return -((points - self.centre(t)) ** 2).sum(-1) / (2 * self.spread**2)

    def sample(self, n, t, rng):
        return self.centre(t)[:, None] + self.spread * rng.standard_normal((len(t), n, 2))


def point(t):
    return TARGET + np.stack([0.2 * (np.asarray(t) - 0.5), 0 * np.asarray(t), 0 * np.asarray(t)], axis=-1)


def centred(met):
    """Weighted mean of the points at each time that has some (T, 3)."""
    at = [met.times == t for t in met.grid]
    return np.stack([np.average(met.points[now], axis=0, weights=met.weights[now]) for now in at])


SETTINGS = {
    "closed form": Algorithm1(times=7),
    "sampled": Algorithm1(times=7, samples=300, delta=0.01),
    "thresholds given": Algorithm1(times=7, delta=0.01, near=0.5, far=3.0),
}


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
def test_rays_of_two_views_meet_at_the_known_point(settings):
    met = settings([Spot(camera) for camera in CAMERAS], CAMERAS)
    assert (met.counts > 20).all()
    assert np.abs(centred(met) - point(met.grid)).max() < 2e-3


def test_the_papers_fixed_grid_finds_a_wide_density_and_misses_a_thin_one():
    paper = Algorithm1(times=5, grid=100, adaptive=False)
    met = paper([Spot(camera, 12.0) for camera in CAMERAS], CAMERAS)
    assert np.abs(centred(met) - point(met.grid)).max() < 0.01


def test_points_spread_as_the_product_of_the_densities():
    fine = Algorithm1(times=3, grid=60, epsilon=1e-3, delta=0.002, pixels=1500, points=20_000)
    met = fine([Spot(camera) for camera in CAMERAS], CAMERAS)
    at = met.times == met.grid[1]
    spread = np.sqrt(np.average((met.points[at] - point(0.5)) ** 2, axis=0, weights=met.weights[at]))
    distance = np.linalg.norm(CAMERAS[0].centre - TARGET)
    one_view = 3.0 * distance / CAMERAS[0].K[0, 0]  # metres across a ray
    assert one_view / 2 < spread[0] < 1.5 * one_view and one_view / 2 < spread[1] < 1.5 * one_view


def test_views_that_disagree_meet_half_way_unless_delta_forbids():
    off = [Spot(CAMERAS[0], shift=(0, 15)), Spot(CAMERAS[1], shift=(0, -15))]
    met = Algorithm1(times=5)(off, CAMERAS)
    (oa, da), (ob, db) = (camera.rays(spot.centre(met.grid)) for camera, spot in zip(CAMERAS, off))
    along_a, along_b, gap = ray_distance(oa, da, ob, db)
    half_way = (oa + along_a[:, None] * da + ob + along_b[:, None] * db) / 2
    assert gap.min() > 0.03 and (met.counts > 0).all()
    assert np.linalg.norm(centred(met) - half_way, axis=1).max() < 0.005
    strict = Algorithm1(times=5, delta=0.001)(off, CAMERAS)
    assert strict.counts.tolist() == [0] * 5 and len(strict.points) == 0  # counted, not dropped


def test_nothing_is_kept_outside_of_near_and_far():
    spots = [Spot(camera) for camera in CAMERAS]
    assert Algorithm1(times=3, near=3.0, far=6.0)(spots, CAMERAS).counts.sum() == 0
    assert Algorithm1(times=3, near=0.1, far=0.5)(spots, CAMERAS).counts.sum() == 0


def test_weights_are_products_of_densities_over_the_highest():
    met = Algorithm1(times=3, epsilon=0.5)([Spot(camera) for camera in CAMERAS], CAMERAS)
    assert met.weights.min() >= 0.25 and met.weights.max() <= 1


def test_points_are_bounded_however_wide_the_densities_are():
    met = Algorithm1(times=3, grid=100, epsilon=0.01, points=500)([Spot(c, 60.0) for c in CAMERAS], CAMERAS)
    assert met.counts.min() > 3000 and len(met.points) <= 3 * 500
    assert np.abs(centred(met) - point(met.grid)).max() < 0.03


THREE = [*CAMERAS, Camera.from_fov(look_at((1.2, 0.1, 1.2), TARGET), 640, 480, 55)]


@pytest.mark.parametrize("cameras", [CAMERAS, THREE], ids=["two views", "three views"])
def test_exact_rays_meet_at_the_known_point_with_any_number_of_views(cameras):
    met = ExactRays(times=7)([Spot(camera) for camera in cameras], cameras)
    assert np.abs(centred(met) - point(met.grid)).max() < 2e-3
    assert met.counts.min() == 256 and met.weights.max() == 1


@pytest.mark.parametrize("spread", [0.3, 3.0, 12.0])
def test_weighted_points_have_the_covariance_of_the_product_of_gaussian_densities(spread):
    """In closed form: the views' information adds up, Sigma^-1 = sum J^T J / spread^2."""
    met = ExactRays(times=3, points=4000, draws=2000)([Spot(camera, spread) for camera in THREE], THREE)
    at = met.times == 0.5
    Sigma = np.cov(met.points[at].T, aweights=met.weights[at])
    information = sum(J.T @ J for J in (camera.jacobian(point(0.5)) for camera in THREE)) / spread**2
    assert np.allclose(Sigma @ information, np.eye(3), atol=0.12)


def test_the_mean_is_that_of_the_product_whatever_the_seed():
    """Skewed densities, so that weights matter: 512 random points tell it to some millimetres only."""

    class Skewed(Spot):
        def log_prob(self, t, points):
            return super().log_prob(t, points) + np.log1p(np.tanh((points - CAMERAS[0].project(point(t)))[..., 0] / 12.0))

    views = [Skewed(CAMERAS[0], 12.0), Spot(CAMERAS[1], 12.0)]
    means = [centred(ExactRays(times=3)(views, CAMERAS, seed=seed)) for seed in range(8)]
    assert np.std(means, axis=0).max() < 5e-4


def test_weights_correct_what_the_gaussian_of_the_moments_gets_wrong():
    """A density of two spots, one of them where no ray of the other view passes: only the true one counts."""

    class TwoSpots(Spot):
        def log_prob(self, t, points):
            other = super().log_prob(t, points - [0, 60])
            return np.logaddexp(super().log_prob(t, points), other)

        def sample(self, n, t, rng):
            draws = super().sample(n, t, rng)
            draws[:, ::2] += [0, 60]
            return draws

    met = ExactRays(times=3, points=4000)([TwoSpots(CAMERAS[0], 6.0), Spot(CAMERAS[1], 6.0)], CAMERAS)
    assert np.abs(centred(met) - point(met.grid)).max() < 0.012  # the moments alone are 30 px, or 5 cm, off


def test_the_information_form_is_the_weighted_least_squares_solution():
    rng, t = np.random.default_rng(0), np.linspace(0, 1, 4)
    R = [np.array([[4.0, 1], [1, 9]]), np.eye(2), np.diag([100.0, 1])]
    means = [camera.project(point(t)) + rng.multivariate_normal([0, 0], C, 4) for camera, C in zip(THREE, R)]
    X, information = information_form([(m, np.tile(C, (4, 1, 1))) for m, C in zip(means, R)], THREE)
    cost = lambda x: sum(np.einsum("ta,ab,tb->t", m - c.project(x), np.linalg.inv(C), m - c.project(x)) for m, c, C in zip(means, THREE, R))
    for step in 1e-4 * np.vstack([np.eye(3), -np.eye(3)]):
        assert (cost(X + step) > cost(X)).all()
    h = 1e-3
    curvature = (cost(X + [h, 0, 0]) - 2 * cost(X) + cost(X - [h, 0, 0])) / (2 * h**2)
    assert np.allclose(information[:, 0, 0], curvature, rtol=0.05)


def test_points_behind_a_camera_do_not_count():
    behind = Camera(CAMERAS[1].K, look_at(2 * CAMERAS[1].centre - TARGET, 4 * CAMERAS[1].centre), 640, 480)
    met = ExactRays(times=3)([Spot(CAMERAS[0]), Spot(CAMERAS[1])], [CAMERAS[0], behind])
    assert np.isfinite(met.points).all() and (met.counts <= 512).all()
