from dataclasses import dataclass

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.bundle import BENDING, COUNT, PHI, Bundle
from teach.curve import resample
from teach.density import Flow
from teach.hand import Hand
from teach.metrics import frechet
from teach.parallel import FLAT, LEAST_TILT, Stretch, Surface, surfaces
from teach.rptl import fit
from teach.scripted import sketch, smooth_path

MIDDLE = np.array([0.5, 0.0, 0.4])
NORMAL = np.array([-1.0, 0.0, 0.0])
"""Of an upright board, 12 cm behind what is drawn before it."""
CAMERAS = {
    name: Camera.from_fov(look_at(eye, MIDDLE), 320, 240, 50)
    for name, eye in (("left", (-0.5, -0.7, 0.9)), ("right", (-0.4, 0.8, 0.7)))
}
FLAT_VIA = MIDDLE + np.array([[0, y, z] for y, z in ((-0.15, -0.1), (-0.05, 0.15), (0.02, -0.1), (0.08, 0.15), (0.15, -0.12))])
BENT_VIA = FLAT_VIA - np.outer([0.0, 0.1, 0.16, 0.1, 0.0], [1, 0, 0])


def board(camera, noise=0.0, seed=0):
    """Depth picture (h, w) [m] of the board; noise: as a share of depth, alike over some pixels."""
    rays = camera.rays(camera.pixel_centres())[1]
    along = ((MIDDLE - 0.12 * NORMAL - camera.centre) @ NORMAL) / (rays @ NORMAL)
    coarse = np.random.default_rng(seed).normal(size=(camera.height // 8, camera.width // 8))
    return along * (rays @ camera.forward) * (1 + noise * np.kron(coarse, np.ones((8, 8))))


QUICK = Flow(steps=120)
DEPTHS = {name: board(camera) for name, camera in CAMERAS.items()}


def drawn(via, seed):
    rng = np.random.default_rng(seed)
    return [sketch(name, camera, via, Hand(), rng)[0] for name, camera in CAMERAS.items()]


def off(via, skill):
    """Discrete Frechet distance [m] of the learned mean from the intended path."""
    mean = skill.distribution.mean_at(np.linspace(0, 1, 400))
    return float(frechet(resample(mean, 100), resample(smooth_path(via), 100)))


def test_what_is_written_before_a_board_is_held_parallel_to_it_and_is_nearer_to_what_was_meant():
    without, held = [], []
    for seed in range(2):
        skill = fit(drawn(FLAT_VIA, seed), seed=seed, depths=DEPTHS, density=QUICK)
        assert skill.report["parallel"]["gain"] > 8 and "parallel to a surface" in skill.report["sentence"]
        assert np.abs(skill.report["parallel"]["normal"] @ NORMAL) > 1 - 1e-5
        assert np.ptp(skill.distribution.mean_at(np.linspace(0.1, 0.9, 50)) @ NORMAL) < 0.008
        held.append(off(FLAT_VIA, skill))
        without.append(off(FLAT_VIA, fit(drawn(FLAT_VIA, seed), seed=seed, depths=DEPTHS, density=QUICK, parallel=False)))
    assert np.mean(held) < 0.9 * np.mean(without), (held, without)


def test_what_bends_away_from_the_board_is_left_as_it_was_drawn():
    for seed in range(2):
        sketches = drawn(BENT_VIA, seed)
        skill = fit(sketches, seed=seed, depths=DEPTHS, density=QUICK)
        assert "parallel" not in skill.report
        np.testing.assert_array_equal(skill.distribution.mean, fit(sketches, seed=seed, density=QUICK).distribution.mean)


def test_a_view_without_a_depth_picture_shows_no_surface():
    sketches = drawn(FLAT_VIA, 0)
    assert surfaces(sketches, {}) == []
    assert len(surfaces(sketches, {"left": DEPTHS["left"]})) == 1


def test_the_tilt_of_a_surface_is_what_its_depth_leaves_open():
    sketches = drawn(FLAT_VIA, 0)
    assert surfaces(sketches, DEPTHS)[0].tilt == LEAST_TILT
    off, tilt = [], []
    for seed in range(8):
        noisy = {name: board(camera, 0.002, seed) for name, camera in CAMERAS.items()}
        found = surfaces(sketches, noisy)[0]
        off.append(np.linalg.norm(np.cross(found.normal, NORMAL)))
        tilt.append(found.tilt)
    assert np.sqrt(np.mean(np.square(off))) < 2 * np.sqrt(2) * np.mean(tilt) and np.min(tilt) > 2 * LEAST_TILT


@dataclass(frozen=True)
class Seen:
    """Linear measurements y = H w + N(0, noise^2) of a curve's weights (3M,)."""

    H: np.ndarray
    y: np.ndarray
    noise: float

    def log_evidence(self, prior) -> float:
        """log p(y) for w ~ N(0, prior^-1)."""
        C = self.H @ np.linalg.inv(prior) @ self.H.T + self.noise**2 * np.eye(len(self.y))
        return -0.5 * (self.y @ np.linalg.solve(C, self.y) + np.linalg.slogdet(C)[1] + len(self.y) * np.log(2 * np.pi))

    def bundle(self, prior) -> Bundle:
        Q = np.kron(prior, np.eye(3))
        covariance = np.linalg.inv(Q + self.H.T @ self.H / self.noise**2)
        w = covariance @ self.H.T @ self.y / self.noise**2
        return Bundle(PHI @ w.reshape(-1, 3), np.zeros((2, COUNT)), 0.0, covariance, prior)


def seen(rng, prior):
    M = len(prior)
    H = np.kron(PHI[::4], np.eye(3))
    w = np.linalg.cholesky(np.linalg.inv(prior)) @ rng.normal(size=(M, 3))
    return Seen(H, H @ w.ravel() + 0.02 * rng.normal(size=len(H)), 0.02)


@pytest.mark.parametrize("tilt", [1e-6, 0.02])
def test_the_evidence_is_that_of_linear_gaussian_models(tilt):
    rng = np.random.default_rng(1)
    prior = BENDING / 25.0**2 + 1e-2 * np.eye(len(BENDING))
    data = seen(rng, prior)
    bundle = data.bundle(prior)
    normal = np.array([0.6, 0.0, 0.8])
    stretch = Stretch(Surface(normal, tilt), 0.2, 0.9)
    u = np.linspace(0, 1, COUNT)
    rows = (u >= 0.2) & (u <= 0.9)
    inside = PHI[rows] - PHI[rows].mean(axis=0)
    places = (bundle.points[rows] - bundle.points[rows].mean(axis=0)) @ np.array([[0.8, 0, -0.6], [0, 1, 0]]).T
    R = (FLAT * np.ptp(bundle.points, axis=0).max()) ** 2 * np.eye(rows.sum()) + tilt**2 * places @ places.T
    flat = np.kron(prior, np.eye(3)) + np.kron(inside.T @ np.linalg.inv(R) @ inside, np.outer(normal, normal))
    expected = data.log_evidence(flat) - data.log_evidence(np.kron(prior, np.eye(3)))
    assert stretch.evidence(bundle) == pytest.approx(expected, rel=1e-3, abs=1e-2)
    known, _ = stretch.held(bundle, bundle.points, list(CAMERAS.values()))
    covariance = np.linalg.inv(flat + data.H.T @ data.H / data.noise**2)
    w = covariance @ data.H.T @ data.y / data.noise**2
    np.testing.assert_allclose(known.points, PHI @ w.reshape(-1, 3), atol=1e-5)
    np.testing.assert_allclose(known.covariance, covariance, atol=1e-6 * covariance.max())
