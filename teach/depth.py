"""What a depth picture says of the scene's surface at a pixel: its point and its normal.

Notation
    depth[v, u]                  [m] along the optical axis at the pixel's centre (u + 0.5, v + 0.5), nan where unseen
    q(u, v) = 1 / z              inverse depth [1/m] at a pixel. In the picture of a plane it is affine: with
    q = l^T (u, v, 1)            the plane's points have (K^T l)^T x_camera = 1, so that its normal towards the camera
    n ~ -K^T l                   is this

A depth picture of a field is noisy by millimetres, has holes, and shows what stands in front. So a plane is fitted to
those pixels around a point that lie on one surface, scored as by MSAC (Torr and Zisserman 2000).
"""

import numpy as np

from scene.camera import Camera
from teach.sketch import SketchError

WINDOW = 0.02
"""Half the window to which a plane is fitted, of the picture's width."""
SAME = 0.015
"""Pixels are of one surface if their depth differs by less than this share from that of its plane."""
ERROR = 0.002
"""Standard deviation of a surface's depth, as a share of it: what a field of photographs has over a window."""
ENOUGH = 0.2
"""A pixel is seen if this share of its window has a depth: small holes are filled by the plane around them."""


def surface_points(camera: Camera, depth, pixels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The surface's points (N, 3) [m] at pixels (N, 2), unit normals (N, 3) towards the camera, which are seen (N,).

    camera: of the picture that the pixels are of. depth: (h, w) [m], of the same picture at any resolution. Points and
    normals are nan where the surface is unseen. Raises SketchError for another picture's depth.
    """
    pixels = np.asarray(pixels, dtype=float)
    small = _camera_of(camera, depth)
    centres = pixels * [small.width / camera.width, small.height / camera.height]
    radius = max(3, round(WINDOW * small.width))
    q, places = _windows(np.asarray(depth, dtype=float), np.nan_to_num(centres), radius)
    coefficients = _planes(q, places)
    at_centre = coefficients[:, 0] + _bulge(q, places, coefficients)
    slopes = coefficients[:, 1:] / radius
    line = np.column_stack([slopes, coefficients[:, 0] - (slopes * centres).sum(1)])
    seen = camera.contains(pixels) & ((q > 0).mean(axis=1) >= ENOUGH) & (at_centre > 0)
    normals = -line @ small.K @ small.world_from_camera[:3, :3].T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-300)
    origins, directions = camera.rays(pixels)
    along = 1 / (np.where(seen, at_centre, np.nan) * (directions @ camera.forward))
    return origins + along[:, None] * directions, np.where(seen[:, None], normals, np.nan), seen


def _camera_of(camera: Camera, depth) -> Camera:
    """The camera at the depth picture's resolution."""
    shape = np.shape(depth)
    if len(shape) != 2 or min(shape) < 2 or abs(shape[0] - shape[1] * camera.height / camera.width) > 1:
        raise SketchError(
            f"a depth picture of {' x '.join(map(str, shape))} does not show a view of {camera.height} x {camera.width}"
            " (rows x columns): give the depth of that view, at its size or a constant factor of it"
        )
    return camera.resized(shape[1], shape[0])


def _windows(depth, centres, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth (N, P) of the pixels around centres (N, 2) [px], 0 where unseen, and their places (N, P, 3):
    (1, u, v) with u and v from the centre in units of the radius."""
    h, w = depth.shape
    steps = np.arange(-radius, radius + 1, -(-radius // 13))  # at most 27 x 27 pixels of a large picture
    dv, du = (d.ravel() for d in np.meshgrid(steps, steps, indexing="ij"))
    middle = np.floor(centres.clip(-radius, [w + radius, h + radius])).astype(int)
    u, v = middle[:, [0]] + du, middle[:, [1]] + dv
    inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
    z = np.where(inside, depth[v.clip(0, h - 1), u.clip(0, w - 1)], np.nan)
    q = np.where(np.isfinite(z) & (z > 0), 1 / np.where(z > 0, z, 1), 0)
    away = (np.stack([u, v], axis=-1) + 0.5 - centres[:, None]) / radius
    return q, np.concatenate([np.ones_like(away[..., :1]), away], axis=-1)


def _planes(q, places) -> np.ndarray:
    """Coefficients (N, 3) of q over (1, u, v) for the surface that fills most of each window, its middle counting most.

    Candidates are planes through the window and nine overlapping quarters of it: at an edge one of these shows one
    surface alone.
    """
    seen, best, most = q > 0, np.zeros((len(q), 3)), np.full(len(q), -1.0)
    for mask in _quarters(places):
        candidate = _fitted(q, places, seen * mask)
        score = _mass(q, places, candidate, 0.5)
        better = score > most
        best[better], most[better] = candidate[better], score[better]
    for _ in range(5):
        best = _fitted(q, places, _centrality(places, 0.5) * _same(q, places, best))
    return best


def _quarters(places) -> list[np.ndarray]:
    middles = [(u, v) for u in (-0.5, 0.0, 0.5) for v in (-0.5, 0.0, 0.5)]
    return [np.ones(places.shape[:2])] + [(np.abs(places[..., 1:] - m) <= 0.52).all(axis=-1) for m in middles]


def _fitted(q, places, weights) -> np.ndarray:
    """Least squares (N, 3), with a ridge at the level of roundoff."""
    weighted = places * weights[..., None]
    A = np.swapaxes(weighted, 1, 2) @ places + 1e-12 * np.eye(3)
    return np.linalg.solve(A, (np.swapaxes(weighted, 1, 2) @ q[..., None]))[..., 0]


def _values(places, coefficients) -> np.ndarray:
    return (places @ coefficients[..., None])[..., 0]


def _same(q, places, coefficients) -> np.ndarray:
    """How well pixels lie on the plane, 1 to 0 (N, P)."""
    miss = (q - _values(places, coefficients)) / np.where(q > 0, SAME * q, 1)
    return np.where(q > 0, np.clip(1 - miss**2, 0, None), 0)


def _bulge(q, places, coefficients) -> np.ndarray:
    """How far (N,) [1/m] a curved surface is from its plane in the window's middle; 0 where the middle is unseen."""
    weights = _centrality(places, 0.2) * _same(q, places, coefficients)
    return ((q - _values(places, coefficients)) * weights).sum(axis=1) / (1e-3 + weights.sum(axis=1))


def _centrality(places, spread: float) -> np.ndarray:
    return np.exp(-(places[..., 1:] ** 2).sum(-1) / (2 * spread**2))


def _mass(q, places, coefficients, spread: float) -> np.ndarray:
    return (_centrality(places, spread) * _same(q, places, coefficients)).sum(axis=1)
