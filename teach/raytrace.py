"""Where rays of high density meet: the paper's Algorithm 1 (Zhi et al. 2023, Section IV-B), and its exact form.

Notation
    f_r(d, x, y) = o + d omega(x, y)    the ray through pixel (x, y): o the camera's centre, omega of length 1; eq. (7)
    p_j(t)                              density of a pixel of view j at time t over the highest at that time: in [0, 1]
    R_j(t) = {f_r(d, x, y) : d_near <= d <= d_far, p_j(t) >= epsilon}           eq. (8)
    S = {(t, X)}                          points X where R_1(t) and R_2(t) come closer than delta; each weighs p_1 p_2
    p(X | t) ~ prod_v p_v(pi_v(X) | t)    exact: rays of zero width meet at X with the product of their densities
    Sigma^-1 = sum_v J_v^T R_v^-1 J_v     information of the views at X: J_v Jacobian of pi_v, R_v [px^2] of the density
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.stats.qmc import Halton, MultivariateNormalQMC

from scene.camera import Camera, ray_distance
from teach.bundle import triangulate


@dataclass(frozen=True, eq=False)
class Intersections:
    """Points where rays meet.

    grid: (T,) the times that were looked at, in [0, 1]. counts: (T,) intersections found at each, 0 included. times:
    (N,) of the points kept, points: (N, 3) [m], weights: (N,) in (0, 1].
    """

    grid: Float[np.ndarray, " T"]
    counts: Int[np.ndarray, " T"]
    times: Float[np.ndarray, " N"]
    points: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, " N"]


@dataclass(frozen=True)
class ExactRays:
    """The product of the views' densities, by importance sampling; any number of views, no grid and no thresholds.

    Points are drawn from the Gaussian that the densities' moments give in information form, a little wider, and weigh
    the product over it; quasi-randomly, by a scrambled Halton sequence: the mean of 256 is off by a fifth of what that of
    512 random ones is. times: number of times, evenly in [0, 1]: fewer than the strokes' points round corners off. points:
    at each. draws: of each density, for its moments. widen: deviation of the points over that of the Gaussian.
    """

    times: int = 100
    points: int = 256
    draws: int = 1000
    widen: float = 1.3

    def __call__(self, densities, cameras: Sequence[Camera], *, seed: int = 0) -> Intersections:
        """densities: objects with log_prob(t, px) and sample(n, t, rng), one for each camera."""
        t, rng = np.linspace(0, 1, self.times), np.random.default_rng(seed)
        moments = [_moments(density.sample(self.draws, t, rng)) for density in densities]
        centre, information = information_form(moments, cameras)
        root = self.widen * np.linalg.inv(np.linalg.cholesky(information)).swapaxes(1, 2)  # root root^T = widen^2 Sigma
        z = _evenly_normal(self.points, rng)  # the same at all times, so that the mean over time is smooth
        X = centre[:, None] + z @ root.swapaxes(1, 2)  # (T, points, 3)
        log_weight = np.broadcast_to(0.5 * (z**2).sum(-1), X.shape[:2]).copy()
        for density, camera in zip(densities, cameras, strict=True):
            pixels = camera.project(X)
            seen = np.isfinite(pixels).all(axis=-1)
            log_prob = density.log_prob(t[:, None], np.where(seen[..., None], pixels, 0.0))
            log_weight += np.where(seen, log_prob, -np.inf)
        met = np.isfinite(log_weight)
        weights = np.exp(log_weight - np.max(log_weight, axis=1, initial=-1e300, keepdims=True))
        return Intersections(t, met.sum(axis=1), np.repeat(t, met.sum(axis=1)), X[met], weights[met])


def _evenly_normal(count: int, rng) -> np.ndarray:
    """(count, 3) draws of N(0, I), spread more evenly than random ones."""
    return MultivariateNormalQMC(np.zeros(3), engine=Halton(3, rng=rng)).random(count)


def _moments(draws) -> tuple[np.ndarray, np.ndarray]:
    """Mean (T, 2) [px] and covariance (T, 2, 2) [px^2] of draws (T, n, 2)."""
    mean = draws.mean(axis=1)
    off = draws - mean[:, None]
    return mean, np.einsum("tna,tnb->tab", off, off) / draws.shape[1] + 1e-4 * np.eye(2)


def information_form(moments, cameras: Sequence[Camera], steps: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """The most probable points (T, 3) [m] and their information Sigma^-1 (T, 3, 3) [1/m^2], from the mean (T, 2) [px]
    and covariance (T, 2, 2) [px^2] of each view; Gauss-Newton."""
    X = triangulate([mean for mean, _ in moments], cameras)
    inverses = [np.linalg.inv(R) for _, R in moments]
    for _ in range(steps):
        information, pull = 1e-6 * np.eye(3), 0.0
        for (mean, _), inverse, camera in zip(moments, inverses, cameras, strict=True):
            J = camera.jacobian(X)
            JR = J.swapaxes(1, 2) @ inverse
            information, pull = information + JR @ J, pull + JR @ np.nan_to_num(mean - camera.project(X))[..., None]
        X = X + np.linalg.solve(information, pull)[..., 0]
    return X, information


@dataclass(frozen=True)
class Algorithm1:
    """The paper's Algorithm 1 for every pair of views. Called with densities and their cameras, returns Intersections.

    grid: points per side of the grid on which densities are evaluated. adaptive: the grid spans the support of the
    density at each time (a box around draws of it), so that a thin density is not missed; False: the whole picture, as
    in the paper. times: number of times, evenly in [0, 1]. samples: points along each ray between near and far, as in
    the paper; None: their limit of infinitely many, closest approaches of rays in closed form. epsilon: a pixel counts
    from this fraction of the time's highest density on. delta: largest distance of two rays that meet [m]; None: at
    each time the gap between the densest rays of the views and the width of a grid cell, added, so that views that
    disagree by that much still meet half-way. near, far: bounds of the distance along rays [m]; None: half and twice
    what the densest rays' closest approaches span. pixels: most pixels per view and time, points: most intersections
    kept per time; above it, they are thinned evenly.
    """

    grid: int = 32
    adaptive: bool = True
    times: int = 50
    samples: int | None = None
    epsilon: float = 0.25
    delta: float | None = None
    near: float | None = None
    far: float | None = None
    pixels: int = 400
    points: int = 1000

    def __call__(self, densities, cameras: Sequence[Camera], *, seed: int = 0) -> Intersections:
        """densities: objects with log_prob(t, px) and sample(n, t, rng), one for each camera. The seed is of the draws
        that place the grid."""
        t = np.linspace(0, 1, self.times)
        rng = np.random.default_rng(seed)
        seen = [(self._regions(density, camera, t, rng), camera) for density, camera in zip(densities, cameras, strict=True)]
        met = [self._pair(t, *zip(*pair, strict=True)) for pair in combinations(seen, 2)]
        join = lambda name: np.concatenate([getattr(m, name) for m in met])
        return Intersections(t, np.sum([m.counts for m in met], axis=0), join("times"), join("points"), join("weights"))

    def _pair(self, t, regions, cameras) -> Intersections:
        gaps, near, far = self._closest_approaches(regions, cameras)
        meet = self._closed_form if self.samples is None else self._sampled
        found = [meet(*pair, cameras, delta, near, far) for *pair, delta in zip(*regions, gaps, strict=True)]
        counts = np.array([len(weights) for _, weights in found])
        strides = [-(-count // self.points) or 1 for count in counts]
        points = [X[::stride] for (X, _), stride in zip(found, strides, strict=True)]
        weights = [w[::stride] for (_, w), stride in zip(found, strides, strict=True)]
        times = np.repeat(t, [len(w) for w in weights])
        return Intersections(t, counts, times, np.concatenate(points), np.concatenate(weights))

    def _regions(self, density, camera: Camera, t, rng) -> list[tuple[np.ndarray, np.ndarray, float]]:
        """At each time the pixels (K, 2) of density above epsilon, that density (K,), and the grid's spacing [px]."""
        unit = (np.stack(np.meshgrid(*[np.arange(self.grid) + 0.5] * 2), axis=-1) / self.grid).reshape(-1, 2)
        low, high = np.zeros((len(t), 2)), np.tile([float(camera.width), float(camera.height)], (len(t), 1))
        if self.adaptive:
            draws = density.sample(200, t, rng)
            low, high = draws.min(axis=1), draws.max(axis=1)
        pixels = low[:, None] + unit * (high - low)[:, None]  # (T, grid^2, 2)
        log_prob = density.log_prob(t[:, None], pixels)
        p = np.exp(log_prob - log_prob.max(axis=1, keepdims=True))
        spacing = (high - low).max(axis=1) / self.grid
        dense = p >= self.epsilon
        return [self._thin(pixels[i][dense[i]], p[i][dense[i]], spacing[i]) for i in range(len(t))]

    def _thin(self, pixels, p, spacing):
        """At most ``self.pixels`` of them, the densest always among them."""
        if len(p) <= self.pixels:
            return pixels, p, spacing
        keep = np.linspace(0, len(p) - 1, self.pixels).round().astype(int)
        keep = np.union1d(keep, [int(np.argmax(p))])
        return pixels[keep], p[keep], spacing

    def _closest_approaches(self, regions, cameras):
        """delta (T,) [m] at each time, near and far [m], from the rays through the densest pixels of both views."""
        peaks = [np.stack([pixels[np.argmax(p)] for pixels, p, _ in region]) for region in regions]
        (oa, da), (ob, db) = (camera.rays(peak) for camera, peak in zip(cameras, peaks, strict=True))
        along = ray_distance(oa, da, ob, db)
        distances = np.stack(along[:2])
        ahead = np.isfinite(distances).all(axis=0) & (distances > 0).all(axis=0)
        if not ahead.any():
            return np.zeros(self.times), self.near or 0.0, self.far or np.inf
        near = 0.5 * distances[:, ahead].min() if self.near is None else self.near
        far = 2.0 * distances[:, ahead].max() if self.far is None else self.far
        if self.delta is not None:
            return np.full(self.times, self.delta), near, far
        gap = np.where(ahead, along[2], np.nanmax(along[2][ahead]))
        cells = [  # width of a grid cell where the rays meet [m]
            np.where(ahead, distance, np.median(distance[ahead])) * np.array([s for *_, s in region]) / camera.K[0, 0]
            for distance, region, camera in zip(distances, regions, cameras, strict=True)
        ]
        return gap + np.maximum(*cells), near, far

    def _closed_form(self, a, b, cameras, delta, near, far):
        """Midpoints (N, 3) of the closest approaches of all pairs of rays within delta, and p_1 p_2 (N,)."""
        (oa, da), (ob, db) = cameras[0].rays(a[0][:, None]), cameras[1].rays(b[0][None])
        along_a, along_b, gap = ray_distance(oa, da, ob, db)  # all (Ka, Kb)
        between = (np.minimum(along_a, along_b) >= near) & (np.maximum(along_a, along_b) <= far)
        i, j = np.nonzero((gap < delta) & between)
        X = (oa[i, 0] + along_a[i, j, None] * da[i, 0] + ob[0, j] + along_b[i, j, None] * db[0, j]) / 2
        return X, a[1][i] * b[1][j]

    def _sampled(self, a, b, cameras, delta, near, far):
        """The paper's: samples along rays whose nearest sample of the other view is within delta, both kept; p_1
        p_2."""
        d = np.linspace(near, far, self.samples)
        X, p = [], []
        for camera, (pixels, density, _) in zip(cameras, (a, b), strict=True):
            origins, directions = camera.rays(pixels)
            X.append((origins[:, None] + d[:, None] * directions[:, None]).reshape(-1, 3))
            p.append(np.repeat(density, self.samples))
        kept, weights = [], []
        for one, other in ((0, 1), (1, 0)):
            distance, nearest = cKDTree(X[other]).query(X[one], distance_upper_bound=delta)
            meets = np.isfinite(distance)
            kept.append(X[one][meets])
            weights.append(p[one][meets] * p[other][nearest[meets]])
        return np.concatenate(kept), np.concatenate(weights)
