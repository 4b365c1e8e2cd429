"""The scripted user: a careful person who knows the motion they mean, sees a picture, and has a hand (``teach.hand``).

    via points -> a path in space for each demonstration -> its projection, displaced as the picture is -> a stroke
                  half of the hand's variance                the other half, tremor, own speed

Everything is in the world frame [m] and pixels; the same ``rng`` gives the same strokes.
"""

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from scene.camera import Camera
from teach.curve import arc_length, extent, resample
from teach.hand import Hand, faults, own_speed, scaled, tremor
from teach.sketch import Event, Sketch, SketchError, Stroke

POINTS = 200
"""Points of a path and of its projection."""
CONTRAST = 40.0
"""Standard deviation [grey levels] of pictures of equal local contrast."""


def smooth_path(via, points: int = POINTS) -> np.ndarray:
    """(points, 3) smooth path through the via points (V, 3) [m], at equal arc length.

    A natural cubic spline over the square root of the chord (centripetal, Lee 1989), which neither loops nor overshoots
    where via points are unequally spaced. Two via points give a straight line.
    """
    via = np.asarray(via, dtype=float)
    if via.ndim != 2 or via.shape[1] != 3 or len(via) < 2 or not np.isfinite(via).all():
        raise ValueError(f"a motion has at least two via points [x, y, z] in metres, not an array {via.shape}")
    chords = np.linalg.norm(np.diff(via, axis=0), axis=1)
    if chords.min() <= 0:
        raise ValueError(f"via point {int(chords.argmin()) + 1} of the motion repeats the one before it: remove it")
    knots = np.concatenate([[0.0], np.cumsum(np.sqrt(chords))])
    return resample(CubicSpline(knots, via, bc_type="natural")(np.linspace(0, knots[-1], 20 * points)), points)


def intended_paths(via, count: int, hand: Hand, rng: np.random.Generator, camera: Camera | None = None) -> np.ndarray:
    """(count, POINTS, 3) [m]: for each demonstration the path the user means, at equal arc length.

    They deviate from the path through the via points (V, 3) by ``hand.intent_share`` of the hand's variance: in space,
    or, if ``camera`` is given, as seen in its picture, where a motion may be foreshortened but its deviations are not.
    """
    path = smooth_path(via)
    seen = 1.0 if camera is None else _magnification(path, camera)
    meant = path + faults(path, scaled(hand, np.sqrt(hand.intent_share) / seen), count, rng)
    return np.stack([resample(one, POINTS) for one in meant])


def draw(
    path,
    camera: Camera,
    hand: Hand,
    rng: np.random.Generator,
    flow=None,
    demonstration: int = 0,
    events=(),
) -> Stroke:
    """The stroke of someone who means ``path`` (T, 3) [m] and looks at a picture taken or rendered by ``camera``.

    flow: (H, W, 2) px from ``picture_flow``, where the picture shown differs from what the camera would see. events:
    (name, share of the path) of what happens on the way, marked where the stroke is by then. The hand adds the share of its faults that is not in the path. Raises SketchError unless the picture holds the whole motion.
    """
    pixels = camera.project(path)
    _require_inside(pixels, camera, "the motion")
    meant = resample(pixels, POINTS)
    line = meant + faults(meant, scaled(hand, np.sqrt(1.0 - hand.intent_share)), 1, rng)[0]
    if flow is not None:
        line = line + _bilinear(np.asarray(flow, dtype=float), line)
    duration = rng.uniform(*hand.duration)
    times = np.linspace(0, duration, max(int(round(duration * hand.rate)), 2) + 1)
    passed = duration * own_speed(POINTS, rng.uniform(*hand.speed), hand.speed_knots, rng)
    progress = np.interp(times, passed, np.linspace(0, 1, POINTS))
    along = arc_length(line)
    points = np.stack([np.interp(progress * along[-1], along, axis) for axis in line.T], axis=1)
    points = points + tremor(times, hand.tremor * camera.width, hand.tremor_time, rng)
    if hand.grid > 0:
        points = np.round(points / hand.grid) * hand.grid
    _require_inside(points, camera, "the stroke")
    marked = tuple(Event(name, float(np.interp(share, progress, times))) for name, share in events)
    return Stroke(points, times, demonstration=demonstration, events=marked, pointer="scripted")


def sketch(
    view: str,
    camera: Camera,
    via,
    hand: Hand,
    rng: np.random.Generator,
    count: int = 3,
    flow=None,
    first: int = 0,
    events=(),
) -> tuple[Sketch, np.ndarray]:
    """The demonstrations drawn on a view, numbered from ``first``, and the paths (count, POINTS, 3) [m] they mean.

    ``camera`` is where the picture was taken; fitting may use another (an estimated one): replace it in the Sketch.
    """
    paths = intended_paths(via, count, hand, rng, camera)
    strokes = [draw(path, camera, hand, rng, flow, first + number, events) for number, path in enumerate(paths)]
    return Sketch(view, camera, tuple(strokes)), paths


def picture_flow(true_image, shown_image, smoothing: float = 12.0, largest: float = 10.0) -> np.ndarray:
    """(H, W, 2) px: what the true picture shows at a pixel p, the shown picture shows at p + flow(p).

    Both (H, W, 3) uint8. Dense inverse search (Kroeger et al. 2016) on pictures of equal local contrast. A flow counts
    only where it can be believed: where there is texture, where both pictures then look alike, where the flow back
    leads home, where it is below ``largest`` [px].
    Believed flows are averaged over ``smoothing`` [px]; where there are none, the median of the picture's believed ones
    takes over (0 if hardly any is). So a rendering's fog or floaters bend no stroke, and nothing exceeds ``largest``.
    """
    true, shown = (_local_contrast(image) for image in (true_image, shown_image))
    search = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    there, back = search.calc(true, shown, None), search.calc(shown, true, None)
    homing = np.linalg.norm(there + _bilinear(back, _pixel_centres(true) + there), axis=-1)
    unlike = (true - _bilinear(shown[..., None].astype(float), _pixel_centres(true) + there)[..., 0]) / CONTRAST
    alike = np.clip(1.0 - cv2.GaussianBlur(unlike**2, (0, 0), 3), 0.0, 1.0)  # unrelated pictures have 2 in place of 0
    belief = alike * np.exp(-0.5 * homing**2) * _texture(true) * _texture(shown)
    belief[np.linalg.norm(there, axis=-1) > largest] = 0.0
    believed = belief > 0.3
    typical = np.median(there[believed], axis=0) if believed.mean() > 0.02 else np.zeros(2)
    weight, weighted = (cv2.GaussianBlur(x, (0, 0), smoothing) for x in (belief, belief[..., None] * there))
    prior = 0.05  # how much belief the typical flow has everywhere
    return (weighted + prior * typical) / (weight + prior)[..., None]


def _require_inside(pixels, camera, what) -> None:
    outside = ~camera.contains(pixels)
    if outside.any():
        worst = pixels[np.argmax(outside)]
        where = f"at pixel ({worst[0]:.0f}, {worst[1]:.0f})" if np.isfinite(worst).all() else "behind the camera"
        raise SketchError(
            f"the view does not see the whole motion: {outside.mean():.0%} of {what} lies outside its "
            f"{camera.width}x{camera.height} picture, first {where}; "
            "move the camera back, widen its field of view, or choose another view"
        )


def _magnification(path, camera) -> float:
    """How much larger deviations of a path (T, 3) are in this picture, as fractions of its extent there, than in space.

    1 for a motion seen square from its side. RMS of the projection's Jacobian along a path in front of the camera.
    """
    _require_inside(camera.project(path), camera, "the motion")
    x, y, z = camera.camera_from_world[:3, :3] @ (path - camera.centre).T  # (3, T)
    focal2 = camera.K[0, 0] ** 2 * (1 + (x / z) ** 2) + camera.K[1, 1] ** 2 * (1 + (y / z) ** 2)  # z^2 |J|^2
    return float(np.sqrt((focal2 / z**2).mean() / 2) * extent(path) / extent(camera.project(path)))


def _local_contrast(image) -> np.ndarray:
    """(H, W) uint8 grey picture whose brightness and contrast are equal everywhere, so that exposure moves nothing."""
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    centred = grey - cv2.GaussianBlur(grey, (0, 0), 15)
    deviation = np.sqrt(cv2.GaussianBlur(centred**2, (0, 0), 15))
    return np.clip(128 + CONTRAST * centred / (deviation + 4.0), 0, 255).astype(np.uint8)


def _texture(grey) -> np.ndarray:
    """(H, W) in [0, 1]: how well a neighbourhood's shift is seen, by the smaller eigenvalue of its structure tensor."""
    weakest = cv2.cornerMinEigenVal(grey.astype(np.float32) / 255, blockSize=9, ksize=3)
    return weakest / (weakest + 1e-3)


def _pixel_centres(image) -> np.ndarray:
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.stack([u + 0.5, v + 0.5], axis=-1)


def _bilinear(field, pixels) -> np.ndarray:
    """Values (..., C) of a field (H, W, C) at pixels (..., 2); beyond the outermost pixel centres it stays constant."""
    height, width = field.shape[:2]
    x, y = (np.clip(pixels[..., k] - 0.5, 0, size - 1) for k, size in ((0, width), (1, height)))
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    a, b = (x - left)[..., None], (y - top)[..., None]
    upper = (1 - a) * field[top, left] + a * field[top, right]
    lower = (1 - a) * field[bottom, left] + a * field[bottom, right]
    return (1 - b) * upper + b * lower
