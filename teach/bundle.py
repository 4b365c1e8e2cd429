"""One curve in space and the time of every view, jointly: bundle adjustment (Triggs et al. 2000) of whole strokes.

Notation
    z_v(s)      mean stroke of view v [px] at arc length s in [0, 1]
    x(u)        the curve [m], x = Phi(u) w with N(w; 0, Q^-1): integrated squared jerk and acceleration of the size ``bend``^2
    l_v(u)      lag of a view: z_v(u + l_v(u)) shows x(u); a Gaussian process of the size ``lag``, 0 at both ends
    e_v(u)      fault of the view's hand: offset, size and smooth deviation [px], covariance k^2 E_v, and trembling
    k           how sloppy the hands are, of what people's are: about 1, or nearly 0 for strokes that were not drawn by one

    z_v(u + l_v(u)) = pi_v(x(u)) + e_v(u)

A line that runs towards one camera is short in its view and long in the other's, so equal arc length is not the same
moment; the lag is what geometry says it is, and where a stroke runs along epipolar lines, what makes the curve smooth.
Gauss-Newton with the lags marginalised: with g = z_v' and H = J_v Phi, y = H w + e - g l has covariance E + g L g^T, so
that the views' information adds up, for any number of them, in the size of w alone. Lag and bend are those of the
highest evidence (Laplace's approximation), from the best of several starts that dynamic programming finds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.ndimage import gaussian_filter1d

from scene.camera import Camera, nearest_to_rays
from teach.basis import SquaredExponential
from teach.curve import extent
from teach.epipolar import fundamental, lag_between
from teach.lag import at
from teach.likelihood import OFFSET, SIZE, SMOOTH, correlation, hand_correlation, projection, smoothness_penalty

COUNT = 100
"""Points at which a view is compared with the curve."""
BASIS = SquaredExponential(24, 64.0)
PHI = BASIS(np.linspace(0, 1, COUNT))
BENDING = smoothness_penalty(BASIS, order=3) + smoothness_penalty(BASIS)
TO_WEIGHTS = projection(BASIS, np.linspace(0, 1, COUNT), np.ones(COUNT), 1e-7)
STARTS = (None, 0.06, 0.12, 0.25, 0.5)
"""Sizes of the lag with which dynamic programming looks for starts; None: no lag."""
LAG_LENGTHS, LAGS, BENDS = (0.15, 0.3), (0.03, 0.08, 0.16), (5.0, 12.0, 25.0, 60.0)
"""Correlation lengths and sizes of the lag, of the arc length, and sizes of the bend, of the curve's extent, to choose
from."""
TREMBLING, SMOOTHING = 0.002, 1.5
"""Least deviation of what is not smooth in a mean stroke, of the drawing's extent; how far it is smoothed [points]."""
SLOPPINESS = (1.0, 0.3, 0.1, 0.03)
"""Values of k, in the order in which they are tried until the evidence falls."""
EVIDENCE = attrgetter("evidence")
EVEN = 3.0
"""Log evidence that says little (Kass & Raftery 1995): within it strokes are taken for exact, since strokes of a hand taken
so lose little, and exact ones taken for a hand's a lot."""
BELIEF = 0.2
"""Power of the evidence by which other curves than the best widen its covariance: a hand is only a model of one."""


@dataclass(frozen=True, eq=False)
class ViewedStroke:
    """The mean stroke of a view. mean: (COUNT, 2) [px] at even arc lengths. faults: (2, COUNT, COUNT) [px^2], the
    covariance E of its smooth fault along each axis of the picture. trembling: [px^2], variance of what is not smooth."""

    camera: Camera
    mean: Float[np.ndarray, "N 2"]
    faults: Float[np.ndarray, "2 N N"]
    trembling: float

    @classmethod
    def of(cls, camera: Camera, strokes) -> "ViewedStroke":
        """strokes: (S, COUNT, 2) [px] at even arc lengths. Their spread scales the faults of people's letters, which
        count as much as one stroke."""
        strokes = np.asarray(strokes, dtype=float)
        mean, count = strokes.mean(axis=0), len(strokes)
        smooth = _smoothed(mean)
        faults = hand_faults(smooth)
        if count > 1:
            seen = ((strokes - mean) ** 2).sum() / (count - 1)
            faults = faults * ((count - 1) * seen / np.trace(faults, axis1=1, axis2=2).sum() + 1) / count
        least = max((TREMBLING * extent(smooth)) ** 2, 0.01)
        return cls(camera, smooth, faults / count, max(2 * ((mean - PHI @ TO_WEIGHTS @ smooth) ** 2).mean(), least))

    def sloppy(self, k: float) -> "ViewedStroke":
        """The same stroke, of a hand with k times its smooth faults."""
        return replace(self, faults=k**2 * self.faults)

    @property
    def covariance(self) -> np.ndarray:
        """(2, COUNT, COUNT) [px^2] of all that is wrong, along each axis."""
        return self.faults + self.trembling * np.eye(COUNT)

    @property
    def sigma(self) -> float:
        """RMS fault [px] along one axis."""
        return float(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2).mean()))


@dataclass(frozen=True, eq=False)
class Bundle:
    """points: (COUNT, 3) [m], the curve at even u. lags: (V, COUNT). evidence: log p(strokes | lag, bend). covariance:
    (3M, 3M) [m^2], of the curve's weights in BASIS, basis-major: what strokes and lags leave open. prior: (M, M) [1/m^2], the
    precision Q of these weights along each axis before anything was drawn."""

    points: Float[np.ndarray, "N 3"]
    lags: Float[np.ndarray, "V N"]
    evidence: float
    covariance: Float[np.ndarray, "3*M 3*M"]
    prior: Float[np.ndarray, "M M"]


def hand_faults(stroke) -> np.ndarray:
    """(2, N, N) [px^2] covariance of the faults of a hand that draws ``stroke`` (N, 2) [px], as ``teach.hand`` has
    them."""
    u, size = np.linspace(0, 1, len(stroke)), max(extent(stroke), 1.0)
    arms = stroke - stroke.mean(axis=0)
    smooth = SMOOTH**2 * hand_correlation(u)
    common = (OFFSET**2 + smooth) * size**2 / 2
    return np.stack([common + SIZE**2 * np.outer(arm, arm) for arm in arms.T])


def adjust(views: Sequence[ViewedStroke], start=None) -> Bundle:
    """The most probable curve and lags; its covariance covers the others that were nearly as probable. start: lags (V,
    COUNT) to begin with; None: several are tried, for two views."""
    begin = starts if start is None else lambda *_: [np.asarray(start, dtype=float)]
    tried: list[list[Bundle]] = []
    best: list[Bundle] = []
    for k in SLOPPINESS:
        tried.append(_adjusted([view.sloppy(k) for view in views], begin))
        best.append(max(tried[-1], key=EVIDENCE))
        if best[-1].evidence < max(map(EVIDENCE, best)) - EVEN:
            break
    least = max(map(EVIDENCE, best)) - EVEN
    return _widened([bundle for bundle in best if bundle.evidence >= least][-1], tried)


def _adjusted(views, begin) -> list[Bundle]:
    """Curves for each size of the bend, and each size and length of the lag, by hands as sloppy as the views say."""
    begun = [solve(views, lags, LAGS[1], BENDS[2]) for lags in begin(*views)]
    bends = [solve(views, max(begun, key=EVIDENCE).lags, LAGS[1], bend) for bend in BENDS]
    best, bend = max(zip(bends, BENDS, strict=True), key=lambda option: option[0].evidence)
    return [*begun, *bends, *(solve(views, best.lags, lag, bend, length) for length, lag in product(LAG_LENGTHS, LAGS))]


def _widened(best: Bundle, tried: list[list[Bundle]]) -> Bundle:
    """The best of the curves, as uncertain as a person's strokes leave them, however well these meet: the hand may have strayed
    in all views alike. Added is the mean square of all curves around the best."""
    off = np.stack([(TO_WEIGHTS @ (_evenly(bundle) - _evenly(best))).ravel() for found in tried for bundle in found])
    around = np.einsum("k,ki,kj->ij", _shares([bundle for found in tried for bundle in found]), off, off)
    hands = np.einsum("k,kij->ij", _shares(tried[0]), [bundle.covariance for bundle in tried[0]])
    return replace(best, covariance=hands + around)


def _shares(bundles) -> np.ndarray:
    evidence = np.array([bundle.evidence for bundle in bundles])
    share = np.exp(BELIEF * (evidence - evidence.max()))
    return share / share.sum()


def _evenly(bundle: Bundle) -> np.ndarray:
    """The curve's points (COUNT, 3) where the mean of the views' arc lengths is even, as for all that are compared."""
    u = np.linspace(0, 1, COUNT)
    at_even = np.interp(u, np.maximum.accumulate(u + bundle.lags.mean(axis=0)), u)
    return at(bundle.points, at_even)


def starts(a: ViewedStroke, b: ViewedStroke) -> list[np.ndarray]:
    """Lags (2, COUNT) of two views from which to begin."""
    F, sigma = fundamental(a.camera, b.camera), np.hypot(a.sigma, b.sigma) / np.sqrt(2)
    lags = [np.zeros(COUNT) if size is None else lag_between(a.mean, b.mean, F, sigma, size)[0] for size in STARTS]
    return [np.stack([-lag / 2, lag / 2]) for lag in lags]


def solve(
    views: Sequence[ViewedStroke], lags, lag: float, bend: float, length: float = LAG_LENGTHS[0], steps: int = 24
) -> Bundle:
    """The most probable curve and lags near ``lags`` (V, COUNT) for a size and a length of the lag and a size of the
    bend."""
    problem = _Problem(views, lags, lag, bend, length)
    w, lags = problem.start(lags), np.asarray(lags, dtype=float)
    cost, damping = problem.cost(w, lags), 1.0
    for _ in range(steps):
        w_new, lags_new, evidence, covariance = problem.step(w, lags)
        while (gain := cost - problem.cost(w + damping * (w_new - w), lags + damping * (lags_new - lags))) <= 0:
            damping /= 2
            if damping < 0.02:
                return problem.solved(w, lags, evidence, covariance)
        w, lags, cost = w + damping * (w_new - w), lags + damping * (lags_new - lags), cost - gain
        damping = min(1.0, 2 * damping)
        if gain < 1e-2:
            break
    return problem.solved(w, lags, *problem.step(w, lags)[2:])


class _Problem:
    """The objective of ``solve`` and its Gauss-Newton step. w (3M,): weights, basis-major."""

    def __init__(self, views, lags, lag, bend, length):
        self.views, self.u = views, np.linspace(0, 1, COUNT)
        self.Phi = PHI
        self.Psi = np.kron(self.Phi, np.eye(3)).reshape(COUNT, 3, -1)
        self.L = lag**2 * (pinned(correlation(self.u, length)) + 1e-8 * np.eye(COUNT))
        self.L_inverse = np.linalg.inv(self.L)
        self.E_inverse = [np.linalg.inv(view.covariance) for view in views]
        self.x = triangulate([at(v.mean, self.u + l) for v, l in zip(views, lags, strict=True)], [v.camera for v in views])
        size = max(extent(self.x), 1e-6)
        self.prior = BENDING / (bend * size) ** 2 + 1e-7 / size**2 * np.eye(BASIS.count)
        self.Q = np.kron(self.prior, np.eye(3))

    def solved(self, w, lags, evidence, covariance) -> Bundle:
        return Bundle(self.Phi @ w.reshape(-1, 3), lags, evidence, covariance, self.prior)

    def start(self, lags):
        return (TO_WEIGHTS @ self.x).ravel()

    def residuals(self, w, lags):
        """z_v(u + l_v) - pi_v(x) (COUNT, 2) [px] of each view."""
        x = self.Phi @ w.reshape(-1, 3)
        return [at(v.mean, self.u + l) - v.camera.project(x) for v, l in zip(self.views, lags, strict=True)]

    def cost(self, w, lags) -> float:
        total = w @ self.Q @ w + sum(l @ self.L_inverse @ l for l in lags)
        for r, inverse in zip(self.residuals(w, lags), self.E_inverse, strict=True):
            if not np.isfinite(r).all():
                return np.inf  # behind a camera
            total += np.einsum("na,anm,ma->", r, inverse, r)
        return float(total)

    def step(self, w, lags):
        """The minimiser (w, lags) of the linearised objective, the log evidence there, and the covariance of w."""
        A, b, log_evidence, parts = self.Q.copy(), np.zeros(len(w)), 0.0, []
        x, h = self.Phi @ w.reshape(-1, 3), 1 / COUNT
        for view, lag, r in zip(self.views, lags, self.residuals(w, lags), strict=True):
            g = (at(view.mean, self.u + lag + h) - at(view.mean, self.u + lag - h)) / (2 * h)
            H = (view.camera.jacobian(x) @ self.Psi).reshape(2 * COUNT, -1)
            y = (r - g * lag[:, None]).ravel() + H @ w
            root = np.linalg.cholesky(self._spread(view.covariance, g))
            white = solve_triangular(root, np.column_stack([H, y]), lower=True, check_finite=False)
            A += white[:, :-1].T @ white[:, :-1]
            b += white[:, :-1].T @ white[:, -1]
            log_evidence -= np.log(np.diag(root)).sum() + 0.5 * white[:, -1] @ white[:, -1]
            parts.append((root, white, g))
        factor = cho_factor(A)
        w = cho_solve(factor, b)
        log_evidence += 0.5 * b @ w + 0.5 * np.linalg.slogdet(self.Q)[1] - np.log(np.diag(factor[0])).sum()
        lags = np.stack([self._lag(w, *part) for part in parts])
        return w, lags, float(log_evidence), cho_solve(factor, np.eye(len(w)))

    def _spread(self, faults, g):
        """(2 COUNT, 2 COUNT) covariance E + g L g^T [px^2] of a view's stroke around the curve's projection."""
        C = g[:, :, None, None] * self.L[:, None, :, None] * g[None, None]
        for axis in range(2):
            C[:, axis, :, axis] += faults[axis]
        return C.reshape(2 * COUNT, 2 * COUNT)

    def _lag(self, w, root, white, g):
        miss = solve_triangular(root, white[:, :-1] @ w - white[:, -1], lower=True, trans=1, check_finite=False)
        return self.L @ (g * miss.reshape(COUNT, 2)).sum(axis=1)


def triangulate(pixels, cameras) -> np.ndarray:
    """(N, 3) [m]: for each n the point nearest to the rays through pixels[v][n], least squares over any number of
    views."""
    rays = [camera.rays(px) for px, camera in zip(pixels, cameras, strict=True)]
    origins, directions = (np.stack(part, axis=1) for part in zip(*rays, strict=True))  # (N, V, 3)
    return nearest_to_rays(origins, directions)


def _smoothed(curve) -> np.ndarray:
    """curve (N, 2) smoothed, its ends kept: beyond them it goes on as its image in the end point."""
    reach = int(4 * SMOOTHING) + 1
    before, after = 2 * curve[0] - curve[reach:0:-1], 2 * curve[-1] - curve[-2 : -reach - 2 : -1]
    return gaussian_filter1d(np.concatenate([before, curve, after]), SMOOTHING, axis=0)[reach:-reach]


def pinned(K) -> np.ndarray:
    """The covariance K of a process given that it is 0 at its ends."""
    ends = [0, -1]
    return K - K[:, ends] @ np.linalg.solve(K[np.ix_(ends, ends)], K[ends])
