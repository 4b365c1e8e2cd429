"""The training pictures as rays with colours, at one scale, and those that show nothing."""

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
