"""Which views to sketch on, so that the motion is known best: optimal design (Pukelsheim 2006) for strokes.

Notation
    x(u)        a motion in the workspace [m] at even arc length u in [0, 1]; it may differ by (Phi x I) w, w ~ N(0, I)
    H_v         what view v sees of w: its Jacobian times Phi [px]
    E_v         covariance of its hand's fault [px^2]: offset, size, smooth deviation and trembling, as people's letters have
    g_v, L      derivative of the stroke by its arc length [px]; covariance of the lag between that arc length and u
    I_v         = H_v^T (E_v + g_v L g_v^T)^-1 H_v        information of a view about w
    Sigma       = (I + sum_v I_v)^-1

Which moments of two strokes are the same one is itself inferred from the strokes: what a stroke says along its own
tangent is blurred by the lag, and only what it says across counts in full. So a pair level with the motion, which runs
along the epipolar lines of both, is poor however wide its angle, and a third view from above mends it.

D-optimal views have the highest mean of log det Sigma^-1 over motions that may be meant: any in the workspace, or those
that a first sketch leaves open. The expected error is the root mean square of x across the motion (along itself a
curve does not change), the mean over those motions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from scene import paths
from scene.camera import Camera
from scene.viewpoints import coverage
from scene.viewpoints.motions import MODES, POINTS, left_open, motions_in, smooth_modes


@dataclass(frozen=True)
class Hand:
    """How inexactly a person draws, as fractions of the drawing's extent; defaults are those of people's letters.

    offset, size, smooth: RMS of the parts of a stroke's fault, the last with Matern's correlation of order 3/2 and length
    ``correlation``, of the stroke's. trembling: RMS of the rest. lag, lag_length: size and correlation length of what arc
    lengths of views differ by, of the length. strokes: how many are drawn on a view.
    """

    offset: float = 0.03
    size: float = 0.045
    smooth: float = 0.038
    correlation: float = 0.15
    trembling: float = 0.005
    lag: float = 0.08
    lag_length: float = 0.15
    strokes: int = 3


@dataclass(frozen=True, eq=False)
class Proposal:
    """Cameras to sketch on, the error to expect with them and those drawn before [mm], the mean log det of the
    information, and why, in a sentence. numbers: which of the candidates they are."""

    cameras: tuple[Camera, ...]
    numbers: tuple[int, ...]
    error_mm: float
    log_det: float
    why: str


def information(camera: Camera, motions, hand: Hand = Hand()) -> np.ndarray:
    """I (n, 3 MODES, 3 MODES) of a view about motions (n, POINTS, 3) [m] in front of it."""
    z = camera.project(motions)
    g = np.gradient(z, axis=1)
    g *= (_length(z) / np.maximum(np.linalg.norm(g, axis=2), 1e-9))[..., None]
    Phi = smooth_modes() * _extent(motions)[:, None, None]
    H = np.einsum("nuai,num->nuami", camera.jacobian(motions), Phi).reshape(len(z), 2 * POINTS, 3 * MODES)
    return H.swapaxes(1, 2) @ np.linalg.solve(_spread(z, g, hand), H)


def _spread(z, g, hand: Hand) -> np.ndarray:
    """E + g L g^T (n, 2 POINTS, 2 POINTS) [px^2] of strokes z (n, POINTS, 2) with derivatives g."""
    u = np.linspace(0, 1, POINTS)
    away, ends = np.abs(u[:, None] - u), [0, -1]
    lag, rough = np.exp(-(away**2) / (2 * hand.lag_length**2)), np.sqrt(3) * away / hand.correlation
    lag = hand.lag**2 * (lag - lag[:, ends] @ np.linalg.solve(lag[np.ix_(ends, ends)], lag[ends]))
    S = g[:, :, :, None, None] * lag[:, None, :, None] * g[:, None, None]
    arms, extent2 = z - z.mean(axis=1, keepdims=True), _extent(z)[:, None, None] ** 2
    common = (hand.offset**2 + hand.smooth**2 * (1 + rough) * np.exp(-rough)) * extent2 / 2
    rest = (hand.trembling**2 * extent2 + 0.1) * np.eye(POINTS)
    for axis in range(2):
        arm = arms[..., axis]
        S[:, :, axis, :, axis] += (common + hand.size**2 * arm[:, :, None] * arm[:, None] + rest) / hand.strokes
    return S.reshape(len(z), 2 * POINTS, 2 * POINTS)


def certainty(informations, motions) -> tuple[np.ndarray, np.ndarray]:
    """Errors (..., n) [m] across motions (n, POINTS, 3) [m], and log det Sigma^-1 (..., n), of I (..., n, 3 MODES, 3
    MODES) added up over the views."""
    Sigma = np.linalg.inv(np.eye(3 * MODES) + informations)
    weight = _across(motions)
    variance = np.einsum("...nab,nab->...n", Sigma, weight)
    return np.sqrt(variance), -np.linalg.slogdet(Sigma)[1]


def _across(motions) -> np.ndarray:
    """(n, 3 MODES, 3 MODES) [m^2]: the quadratic form of w that is the mean square of x across the motion."""
    Phi = smooth_modes() * _extent(motions)[:, None, None]
    tangent = np.gradient(motions, axis=1)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=2, keepdims=True), 1e-12)
    P = np.eye(3) - tangent[..., :, None] * tangent[..., None, :]
    form = np.einsum("num,nuij,nuk->nmikj", Phi, P, Phi) / POINTS
    return form.reshape(len(motions), 3 * MODES, 3 * MODES)


def _extent(curves) -> np.ndarray:
    """Longest side (n,) of the bounding boxes of curves (n, N, D)."""
    return np.maximum(np.ptp(curves, axis=1).max(axis=-1), 1e-9)


def _length(curves) -> np.ndarray:
    """(n, 1) length of curves (n, N, D)."""
    return np.linalg.norm(np.diff(curves, axis=1), axis=2).sum(axis=1)[:, None]


def suggest(
    photographed: Sequence[Camera],
    drawn: Sequence[Camera] = (),
    strokes: Sequence[np.ndarray] = (),
    *,
    field=None,
    workspace=None,
    width: int = 640,
    height: int = 480,
    count: int = 24,
    seed: int = 0,
    hand: Hand = Hand(),
    limits: coverage.Limits = coverage.Limits(),
) -> Proposal:
    """The pair of views to sketch a motion on, or the next one after those ``drawn`` on.

    strokes: of each drawn view one stroke (N, 2) [px], or none where nothing is known of the motion. field: what is
    looked at (``transmittance``); None: photographs are chosen among. workspace: lower and upper corner (3,) [m] within
    which motions are meant; None: about what the photographs look at. count: motions looked at. limits: of the views.
    ValueError where photographs cover no two views of the workspace.
    """
    if len(strokes) not in (0, len(drawn)):
        raise ValueError(f"there are {len(drawn)} views and {len(strokes)} strokes: give one stroke for each view, or none")
    box = coverage.common_box(photographed, *(_looked_at(photographed) if workspace is None else workspace))
    motions = left_open(drawn, strokes, *box, count, seed) if len(strokes) else motions_in(*box, count, seed)
    views = coverage.candidates(photographed, motions, field, width=width, height=height, limits=limits)
    return propose_next(views, drawn, motions, hand) if len(drawn) else propose_pair(views, motions, hand)


def _looked_at(photographed) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a cube about the photographs' focus, a third of their distance to each side."""
    middle = paths.focus(photographed)
    reach = np.median([np.linalg.norm(camera.centre - middle) for camera in photographed]) / 3
    return middle - reach, middle + reach


def expected_error(cameras: Sequence[Camera], motions, hand: Hand = Hand()) -> float:
    """Error [mm] to expect, the mean over motions (n, POINTS, 3) [m], if all cameras' views are sketched on."""
    return float(1e3 * certainty(sum(information(camera, motions, hand) for camera in cameras), motions)[0].mean())


def propose_pair(candidates: Sequence[Camera], motions, hand: Hand = Hand()) -> Proposal:
    """The two views that make motions (n, POINTS, 3) [m] most certain. ValueError for fewer than two candidates."""
    if len(candidates) < 2:
        raise ValueError(f"a pair is chosen among two views or more, not {len(candidates)}")
    each = np.stack([information(camera, motions, hand) for camera in candidates])
    pairs = list(combinations(range(len(candidates)), 2))
    rated = [certainty(each[a] + each[a + 1 :], motions) for a in range(len(candidates) - 1)]
    errors, log_dets = (np.concatenate(part).mean(axis=1) for part in zip(*rated, strict=True))
    best = int(np.argmax(log_dets))
    first, second = (candidates[k] for k in pairs[best])
    where = _beside(first, second, motions)
    why = (
        f"Two views, the second {where}: expected {1e3 * errors[best]:.0f} mm instead of "
        f"{1e3 * np.median(errors):.0f} mm with the median of {len(pairs)} pairs."
    )
    return Proposal((first, second), pairs[best], float(1e3 * errors[best]), float(log_dets[best]), why)


def propose_next(candidates: Sequence[Camera], drawn: Sequence[Camera], motions, hand: Hand = Hand()) -> Proposal:
    """The view that, with those ``drawn`` on, makes motions (n, POINTS, 3) [m] most certain. ValueError for none."""
    if not (len(candidates) and len(drawn)):
        raise ValueError(f"a next view needs candidates and views drawn before, not {len(candidates)} and {len(drawn)}")
    known = sum(information(camera, motions, hand) for camera in drawn)
    each = np.stack([known + information(camera, motions, hand) for camera in candidates])
    errors, log_dets = (part.mean(axis=1) for part in certainty(each, motions))
    best = int(np.argmax(log_dets))
    before = 1e3 * certainty(known, motions)[0].mean()
    where = _beside(drawn[0], candidates[best], motions)
    why = f"A view {where}: expected {1e3 * errors[best]:.0f} mm instead of {before:.0f} mm without it."
    return Proposal((candidates[best],), (best,), float(1e3 * errors[best]), float(log_dets[best]), why)


def _beside(first: Camera, second: Camera, motions) -> str:
    """Where the second camera stands as seen by somebody at the first who looks at the motions (n, POINTS, 3) [m]."""
    middle = np.asarray(motions).reshape(-1, 3).mean(axis=0)
    a, b = (camera.centre - middle for camera in (first, second))
    unit = lambda v: v / np.linalg.norm(v)
    angle = np.degrees(np.arccos(np.clip(unit(a) @ unit(b), -1, 1)))
    higher = np.degrees(np.arcsin(unit(b)[2]) - np.arcsin(unit(a)[2]))
    side = "right" if (b - a) @ first.world_from_camera[:3, 0] > 0 else "left"
    turn = f"{angle:.0f} degrees to the {side} of the first"
    if abs(higher) < 5:
        return turn
    return f"{turn} and {abs(higher):.0f} degrees {'higher' if higher > 0 else 'lower'}"
