"""How far away the surface is that a field shows at each pixel, and how sure that is.

Notation
    T(t)    transmittance: the light that gets from distance t of a ray to the camera
    d       median depth: T(d) = 1/2; what `Field.render` gives, measured along the optical axis
    w       a tolerance, a share of d

    confidence = T(d - w) - T(d + w)

is the share of the ray's light that comes from within w of the median: 1 for a clean opaque surface, exp(-s)-like
little in fog, 0 where the ray meets nothing. Since T(d) = 1/2, it takes only the two short stretches beside d: T(d - w)
= 1/2 / T(d - w -> d) and T(d + w) = 1/2 T(d -> d + w). """

import numpy as np

from scene.camera import Camera
from scene.field import FAR, Field


def render(field: Field, camera: Camera, within: float = 0.01) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`Field.render`'s picture (h, w, 3) uint8 and median depth (h, w) [m along z], and the depth's confidence (h, w)
    in [0, 1].

    within: the tolerance w, as a share of the depth.
    """
    image, depth = field.render(camera)
    return image, depth, confidence(field, camera, depth, within)


def confidence(field: Field, camera: Camera, depth: np.ndarray, within: float = 0.01) -> np.ndarray:
    """(h, w) float32 in [0, 1] of a median depth (h, w) [m along z]; 0 where that is nan."""
    hit = np.isfinite(depth)
    origins, directions = camera.rays(camera.pixel_centres()[hit])
    along = depth[hit] / (directions @ camera.forward)
    before = _through(field, origins, directions, (1 - within) * along, along)
    after = _through(field, origins, directions, along, (1 + within) * along)
    found = np.zeros(depth.shape, np.float32)
    found[hit] = np.minimum(1, 0.5 / np.maximum(before, 1e-6)) - 0.5 * after
    return found


def passes(field: Field, camera: Camera, depth: np.ndarray) -> np.ndarray:
    """(h, w) float32: the share of light that passes the whole scene where no median depth (h, w) was found, elsewhere
    0."""
    lost = ~np.isfinite(depth)
    origins, directions = camera.rays(camera.pixel_centres()[lost])
    found = np.zeros(depth.shape, np.float32)
    found[lost] = _through(field, origins, directions, 0.0, np.inf)
    return found


def _through(field: Field, origins, directions, start, end) -> np.ndarray:
    """Transmittance (n,) of the stretch of each ray between two distances [m]."""
    rays = field.rays(origins, directions)
    rays.near = np.maximum(rays.near, start / field.half).astype(np.float32)
    far = np.minimum(FAR, np.broadcast_to(end, len(origins)) / field.half).astype(np.float32)
    return field.march(rays, far=np.ascontiguousarray(far)).through
