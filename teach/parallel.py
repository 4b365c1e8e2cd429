"""Motions parallel to a surface: two views leave depth open, and what they show behind the strokes may say it.

Notation
    x(u)        the curve [m] of teach.bundle at moments u; its weights w ~ N(m, C) as strokes leave them, N(0, Q^-1) before
    n           unit normal of a surface that depth pictures show under the strokes; its direction is known to a tilt s [rad]
    h(u)        n . x(u), height over that surface, from its mean over I
    I = [a, b]  moments at which the motion may be parallel to it: h ~ N(0, R), R = (FLAT extent)^2 1 + s^2 sum_k g_k g_k^T,
                where g_k(u) are the curve's places, from their mean, along two axes of the surface
    F           h^T R^-1 h = w_n^T F w_n, with the weights w_n along n

That x is parallel has the prior precision Q + F along n. What it explains better (Kass & Raftery 1995) has a closed form:

    log p(strokes | parallel) / p(strokes | any) = 1/2 log |Q + F| / |Q| - 1/2 log |1 + C_n F| - 1/2 m_n^T F (1 + C_n F)^-1 m_n

A hand that writes on a board, wipes a table or slides along a wall draws so, and the strokes of one that does not contradict
it by far. The curve is conditioned on what the evidence says; what is too sharp for its basis (a corner whose moments differ
between views) is taken from the height with the information of the views at that moment.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from teach.bundle import COUNT, PHI, TO_WEIGHTS, Bundle
from teach.curve import extent
from teach.depth import surface_points
from teach.sketch import Sketch

FLAT = 0.004
"""Deviation of the height of what runs parallel, of the motion's extent."""
SHARP = 0.003
"""Deviation of what the bundle's basis does not express in a mean stroke, of the picture's width."""
SURFACES, SHARE, SAME = 3, 0.2, np.cos(np.radians(10))
"""Most surfaces that are looked at; each lies under this share of the strokes, its normals within 10 degrees."""
INDEPENDENT, LEAST_TILT = 4, 0.002
"""Normals that count as independent: those of places near each other err alike; least tilt [rad] of a surface."""
PIXELS = 100
"""Places of a view's strokes at which the surface under them is looked at."""
STEP, SHORTEST = 0.05, 0.4
"""Of the moments at which a stretch may begin and end; how long it is."""
RARE = 8.0
"""Log evidence that must be exceeded: few motions run parallel to anything, and strokes are no more than nearly Gaussian. Three of 120
that do not, on a table and in a shelf, reach 5 to 7.5; of letters on a board 39 in 40 exceed it."""
LIKELY = 2.0
"""Of stretches whose log evidence is this near to the highest, the longest is taken."""
MOMENTS = np.linspace(0, 1, COUNT)


@dataclass(frozen=True, eq=False)
class Surface:
    """normal: (3,), of length 1. tilt: [rad], its deviation along each axis."""

    normal: Float[np.ndarray, "3"]
    tilt: float


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch that runs parallel to a surface. begin, end: moments u. gain: log evidence that there is one."""

    surface: Surface
    begin: float
    end: float
    gain: float = np.nan

    def evidence(self, bundle: Bundle) -> float:
        """How much better this explains the strokes than any curve does [log]."""
        inside, n = self._centre @ PHI, self.surface.normal
        F = inside.T @ np.linalg.solve(self._allowed(bundle.points), inside)
        m, C = TO_WEIGHTS @ bundle.points @ n, np.einsum("iajb,a,b->ij", bundle.covariance.reshape(len(F), 3, len(F), 3), n, n)
        both = np.eye(len(F)) + C @ F
        occam = np.linalg.slogdet(bundle.prior + F)[1] - np.linalg.slogdet(bundle.prior)[1]
        return 0.5 * float(occam - np.linalg.slogdet(both)[1] - m @ F @ np.linalg.solve(both, m))

    def held(self, bundle: Bundle, x, cameras) -> tuple[Bundle, np.ndarray]:
        """The bundle's curve once the stretch is known, and the displacement (COUNT, 3) [m] that takes a mean x (COUNT, 3)
        [m], at even moments, to it. cameras: of the views."""
        H, R, C = np.kron(self._centre, self.surface.normal), self._allowed(x), bundle.covariance
        Psi, sharp, each = np.kron(PHI, np.eye(3)), np.zeros((COUNT, 3, COUNT, 3)), np.arange(COUNT)
        sharp[each, :, each, :] = np.linalg.inv(_information(x, cameras))
        HP = H @ Psi
        gain = np.linalg.solve(HP @ C @ HP.T + R, HP @ C).T
        off = (Psi @ gain @ H @ bundle.points.ravel()).reshape(-1, 3)
        known = replace(bundle, points=bundle.points - off, covariance=C - gain @ HP @ C)
        S = Psi @ C @ Psi.T + sharp.reshape(3 * COUNT, -1)
        return known, -(S @ H.T @ np.linalg.solve(H @ S @ H.T + R, H @ np.ravel(x))).reshape(-1, 3)

    def plain(self) -> dict:
        """What a report says of it."""
        return {"normal": self.surface.normal.tolist(), "begin": self.begin, "end": self.end, "gain": self.gain}

    @property
    def sentence(self) -> str:
        where = "all along" if self.end - self.begin > 0.99 else f"from {self.begin:.0%} to {self.end:.0%} of its length"
        return f"It runs parallel to a surface behind it {where}, and is held so."

    @property
    def _centre(self) -> np.ndarray:
        """(K, COUNT): takes what is at all moments to that of the stretch, from its mean."""
        inside = np.eye(COUNT)[(self.begin - 1e-9 <= MOMENTS) & (self.end + 1e-9 >= MOMENTS)]
        return inside - inside.mean(axis=0)

    def _allowed(self, x) -> np.ndarray:
        """R (K, K) [m^2] of the curve x (COUNT, 3) [m]."""
        places = self._centre @ x @ np.linalg.svd(self.surface.normal[None])[2][1:].T
        flat = FLAT * max(extent(x), 1e-6)
        return flat**2 * np.eye(len(places)) + self.surface.tilt**2 * places @ places.T


def parallel_stretch(drawn: Sequence[Sketch], bundle: Bundle, depths: Mapping[str, np.ndarray]) -> Stretch | None:
    """The stretch that most probably runs parallel to a surface seen under the strokes; None where the evidence, over all
    stretches and surfaces, does not say that any does. depths: by view, pictures (h, w) [m]."""
    marks = np.linspace(0, 1, round(1 / STEP) + 1)
    tried = [
        Stretch(surface, float(begin), float(end))
        for surface in surfaces(drawn, depths)
        for begin in marks
        for end in marks[marks > begin + SHORTEST - 1e-9]
    ]
    if not tried:
        return None
    gains = [stretch.evidence(bundle) for stretch in tried]
    gain = float(logsumexp(gains) - np.log(len(gains)))
    if gain <= RARE:
        return None
    likely = [stretch for stretch, each in zip(tried, gains, strict=True) if each > max(gains) - LIKELY]
    return replace(max(likely, key=lambda stretch: stretch.end - stretch.begin), gain=gain)


def surfaces(drawn: Sequence[Sketch], depths: Mapping[str, np.ndarray]) -> list[Surface]:
    """The surfaces that most of the strokes are drawn over, in all views that have a depth picture."""
    normals = [np.zeros((0, 3))]
    for sketch in drawn:
        if sketch.view in depths:
            pixels = np.concatenate([stroke.points for stroke in sketch.motions])
            _, each, seen = surface_points(sketch.camera, depths[sketch.view], pixels[:: -(-len(pixels) // PIXELS)])
            normals.append(each[seen])
    left, found = np.concatenate(normals), []
    least = SHARE * len(left)
    while len(left) and len(found) < SURFACES:
        alike = left @ left.T > SAME
        members = left[alike[alike.sum(axis=1).argmax()]]
        if len(members) < least:
            break
        normal = members.sum(axis=0) / np.linalg.norm(members.sum(axis=0))
        spread = np.sqrt((1 - (members @ normal) ** 2).clip(0).mean() / 2)
        found.append(Surface(normal, max(float(spread) / np.sqrt(INDEPENDENT), LEAST_TILT)))
        left = left[np.abs(left @ normal) < SAME]  # the other side of a wall is parallel to it
    return found


def _information(x, cameras) -> np.ndarray:
    """(COUNT, 3, 3) [1/m^2] of the views on what is sharp."""
    jacobians = [camera.jacobian(x) / (SHARP * camera.width) for camera in cameras]
    return sum(J.swapaxes(1, 2) @ J for J in jacobians)
