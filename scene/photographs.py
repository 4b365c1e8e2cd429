"""The training pictures as rays with colours, at one scale, and the backdrop they were taken before."""

from dataclasses import dataclass

import cv2
import numpy as np

from scene.field import Rays


@dataclass(frozen=True, eq=False)
class Photographs:
    """For each picture: pixels (h, w, 3) uint8, direction (3, 3) = R K^-1 (pixel to ray), origin (3,), normalised; shown: numbers
    of the pixels that may be looked at, None for all."""

    pixels: list
    directions: list
    origins: list
    shown: list

    @classmethod
    def of(cls, views, centre, half: float, scale: int) -> "Photographs":
        """Pictures ``scale`` times smaller, averaged over areas; the box of interest gives the normalised frame."""
        pixels, directions, origins, shown = [], [], [], []
        for view in views:
            width, height = (max(n // scale, 1) for n in (view.camera.width, view.camera.height))
            camera = view.camera.resized(width, height)
            pixels.append(cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA))
            directions.append((camera.world_from_camera[:3, :3] @ np.linalg.inv(camera.K)).astype(np.float32))
            origins.append(((camera.centre - centre) / half).astype(np.float32))
            mask = None if view.mask is None else 255 * view.mask.astype(np.uint8)
            whole = None if mask is None else cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA) == 255
            shown.append(None if mask is None else np.flatnonzero(whole))
        return cls(pixels, directions, origins, shown)

    def draw(self, rng: np.random.Generator, count: int, near: float) -> tuple[Rays, np.ndarray, np.ndarray]:
        """Rays from the distance ``near`` on through ``count`` random pixels, their colours (count, 3) in [0, 1], and the numbers of their pictures (count,).

        No two of them are neighbours on purpose: pixels side by side teach the same voxels the same thing.
        """
        areas = np.array([p.shape[0] * p.shape[1] if s is None else len(s) for p, s in zip(self.pixels, self.shown)], float)
        which = np.sort(rng.choice(len(self.pixels), count, p=areas / areas.sum()))
        places = rng.random((count, 2))
        drawn = [self._rays(k, places[which == k]) for k in np.unique(which)]
        origins, directions, colours = (np.concatenate(part) for part in zip(*drawn))
        return Rays(origins, directions, np.full(len(origins), near, np.float32)), colours, which

    def _rays(self, k: int, places: np.ndarray):
        height, width = self.pixels[k].shape[:2]
        if self.shown[k] is None:
            x, y = (places * (width, height)).astype(np.int64).T
        else:
            y, x = np.divmod(self.shown[k][(places[:, 0] * len(self.shown[k])).astype(np.int64)], width)
        pixels = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], -1).astype(np.float32)
        directions = pixels @ self.directions[k].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = np.repeat(self.origins[k][None], len(x), 0)
        return origins, directions, self.pixels[k][y, x].astype(np.float32) / 255


def spoilt(views, more: float = 0.5) -> list[str]:
    """Names of pictures so dark or so overexposed that they show little: the share of their pixels that are black or white
    in every channel is larger by ``more`` than that of the median picture, so that a white scene spoils none."""
    blank = []
    for view in views:
        image = view.image[::2, ::2]
        blank.append(((image.min(-1) >= 250) | (image.max(-1) <= 16)).mean())
    return [view.name for view, share in zip(views, blank, strict=True) if share > np.median(blank) + more]


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


def backdrop(views, least: float = 0.03, tolerance: int = 3) -> np.ndarray:
    """The plain colour (3,) in [0, 1] before which the pictures were taken, or (0,) if they show no such thing.

    It is the commonest colour of pixels that look like all around them, if at least the share ``least`` of all have it:
    white paper, a clear sky, a simulator's empty space.
    """
    flat = []
    for view in views:
        image = view.image[::2, ::2]
        spread = cv2.dilate(image, np.ones((7, 7))) - cv2.erode(image, np.ones((7, 7)))
        flat.append(image[spread.max(-1) <= 2])
    colours = np.concatenate(flat).astype(np.int32)
    pixels = sum(view.image[::2, ::2, 0].size for view in views)
    if len(colours) < least * pixels:
        return np.zeros(0, np.float32)
    coarse, count = np.unique(colours // 4 @ np.array([1, 64, 4096]), return_counts=True)
    commonest = coarse[count.argmax()] // np.array([1, 64, 4096]) % 64 * 4 + 2
    alike = colours[np.abs(colours - commonest).max(-1) <= tolerance + 2]
    if len(alike) < least * pixels:
        return np.zeros(0, np.float32)
    return np.median(alike, axis=0).astype(np.float32) / 255
