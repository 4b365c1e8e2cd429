"""How differently pictures of one scene are exposed, and the plain backdrop they were taken before.

    picture = gain * colour, channel by channel          gains (pictures, 3), their geometric mean 1

    before training    exposed    by the points of the reconstruction to some per cent, by a backdrop to a level
    while training     ratios ─ gains    by what the field has become, where neither said anything
"""

import cv2
import numpy as np

UNEQUAL, LEVEL = 0.08, 0.02
"""RMS of the gains' log from which on points are believed, and pixels of a backdrop: pictures exposed alike have up to 0.04 and 0.000."""
MOST = 4000
"""Points that are asked, at most."""
LEAST = 0.03
"""Share of all pixels that show a backdrop, at least."""
NEAR, FLAT = 0.3, 0.005
"""A picture's own backdrop is within this share of the colour expected of it, and this share of its pixels."""
SATURATED = 250
"""A backdrop this bright does not say how bright it is."""


def exposed(views, points=None) -> tuple[np.ndarray, np.ndarray]:
    """The backdrop (3,) in [0, 1] as an average picture shows it, (0,) if there is none, and the pictures' gains.

    points: (n, 3) [m], the reconstruction's. Where nothing says that the pictures differ, all gains are 1.
    """
    flat, equal = [_flat(view.image) for view in views], np.ones((len(views), 3), np.float32)
    rough = equal if points is None or not len(points) else by_points(views, points)
    colour = _backdrop(views, flat, rough)
    found = _by_backdrop(views, flat, rough, colour) if len(colour) else None
    if found is None:
        found = rough if _spread(rough) > UNEQUAL else equal
    return _backdrop(views, flat, found), found


def _by_backdrop(views, flat, rough, colour) -> np.ndarray | None:
    """The pictures' gains by how bright each shows the backdrop, those that show none ``rough``; None where no picture says."""
    own = np.stack([_own_backdrop(*one, colour * gain) for *one, gain in zip(views, flat, rough, strict=True)])
    shown = np.isfinite(own[:, 0])
    if not shown.any():
        return None
    found = rough / _mean(rough[shown])
    found[shown] = own[shown] / _mean(own[shown])
    return found / _mean(found) if _spread(found[shown]) > LEVEL else np.ones_like(rough)


def by_points(views, points, dark: float = 0.05, bright: float = 0.97, rounds: int = 10) -> np.ndarray:
    """The gains of pictures by the colours that points (n, 3) [m] have in them.

    log colour = log gain + point, fitted by medians in turn (median polish, Tukey 1977): a point that something hides in a
    picture has any colour there, but most are seen by most. Where a colour is nearly black or white it says nothing.
    """
    points = points[:: -(-len(points) // MOST)]
    colours = np.full((len(views), len(points), 3), np.nan, np.float32)
    for view, of_points in zip(views, colours, strict=True):
        pixels = view.camera.project(points)
        inside = np.flatnonzero(view.camera.contains(pixels))
        x, y = pixels[inside].astype(np.int64).T
        seen = cv2.blur(view.image, (5, 5))[y, x].astype(np.float32) / 255
        telling = ((seen > dark) & (seen < bright)).all(-1) & (True if view.mask is None else view.mask[y, x])
        of_points[inside[telling]] = np.log(seen[telling])
    colours = colours[:, np.isfinite(colours[..., 0]).sum(0) > 1]
    told = np.isfinite(colours[..., 0]).any(1)
    gains = np.zeros((len(views), 1, 3), np.float32)
    for _ in range(rounds if told.any() else 0):
        point = np.nanmedian((colours - gains)[told], axis=0)
        gains[told, 0] = np.nanmedian(colours[told] - point, axis=1)
        gains[told] -= gains[told].mean(0)
    return np.exp(gains[:, 0])


def ratios(view, pixels: np.ndarray, colour: np.ndarray, dark: float = 0.05) -> np.ndarray:
    """(2, 3) log of how much brighter the picture is at pixels (n, 2) than ``colour`` (n, 3) in [0, 1], by channel: the
    median in its left half and in its right half.

    Pixels that a mask hides and dark ones say nothing.
    """
    x, y = pixels.astype(np.int64).T
    shown = view.image[y, x].astype(np.float32) / 255
    telling = (shown > dark) & (colour > dark) & (True if view.mask is None else view.mask[y, x][:, None])
    halves = [telling & (left == (x < view.camera.width / 2))[:, None] for left in (True, False)]
    return np.array([[np.log(np.median(s[t] / c[t])) if t.any() else 0.0 for s, c, t in zip(shown.T, colour.T, half.T)] for half in halves])


def gains(logs: np.ndarray) -> np.ndarray:
    """(pictures, 3) how much brighter each picture is than the scene, their geometric mean 1, from ``ratios`` (pictures, 2, 3).

    What a picture happens to show, and what is not learned yet, makes one half differ from the other; exposure is what both
    have in common. Their covariance over pictures against the variance of their mean (split-half reliability) is the part kept.
    """
    logs = logs - logs.mean(0)
    mean, common = logs.mean(1), (logs[:, 0] * logs[:, 1]).mean()
    kept = np.clip(common / max((mean**2).mean(), 1e-12), 0, 1)
    return np.exp(kept * mean).astype(np.float32)


def backdrop(views) -> np.ndarray:
    """The plain colour (3,) in [0, 1] before which pictures that are exposed alike were taken, or (0,) if they show no such thing.

    It is the commonest colour of pixels that look like all around them, if at least the share LEAST of all have it:
    white paper, a clear sky, a simulator's empty space.
    """
    return _backdrop(views, [_flat(view.image) for view in views], np.ones((len(views), 3)))


def _backdrop(views, flat, gains) -> np.ndarray:
    """``backdrop`` of pictures with these gains, by what is ``_flat`` in each."""
    darkest = gains.min()
    alike = _commonest(np.concatenate([colours * (darkest / gain) for colours, gain in zip(flat, gains, strict=True)]))
    if len(alike) < max(LEAST * sum(_pixels(view) for view in views), 1):
        return np.zeros(0, np.float32)
    return (np.median(alike, axis=0) / (255 * darkest)).astype(np.float32)


def _own_backdrop(view, flat, colour) -> np.ndarray:
    """The plain colour (3,) near to ``colour`` that most flat pixels of a picture have; nan where few have, or it is saturated."""
    alike = _commonest(flat[(np.abs(flat / (255 * colour) - 1) < NEAR).all(-1)])
    found = np.median(alike, axis=0) if len(alike) >= max(FLAT * _pixels(view), 1) else np.full(3, np.nan)
    return found / 255 if found.max() < SATURATED else np.full(3, np.nan)


def _pixels(view) -> int:
    """Number of pixels that ``_flat`` looks at."""
    return view.image[::2, ::2, 0].size


def _flat(image) -> np.ndarray:
    """Colours (n, 3) of every other pixel that looks like all around it."""
    image = image[::2, ::2]
    spread = cv2.dilate(image, np.ones((7, 7))) - cv2.erode(image, np.ones((7, 7)))
    return image[spread.max(-1) <= 2]


def _commonest(colours, tolerance: int = 5) -> np.ndarray:
    """Those of colours (n, 3) in [0, 255] that are like the commonest of them."""
    if not len(colours):
        return colours
    colours = np.round(colours).astype(np.int32)
    coarse, count = np.unique(colours // 4 @ np.array([1, 64, 4096]), return_counts=True)
    commonest = coarse[count.argmax()] // np.array([1, 64, 4096]) % 64 * 4 + 2
    return colours[np.abs(colours - commonest).max(-1) <= tolerance]


def _mean(gains) -> np.ndarray:
    """The geometric mean (3,) of gains (n, 3)."""
    return np.exp(np.log(gains).mean(0))


def _spread(gains) -> float:
    return float(np.sqrt((np.log(gains) ** 2).mean()))
