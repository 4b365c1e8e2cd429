"""The training pictures as rays with colours, at one scale, drawn in small patches."""

from dataclasses import dataclass

import cv2
import numpy as np

from scene.field import Rays


@dataclass(frozen=True, eq=False)
class Photographs:
    """For each picture: pixels (h, w, 3) uint8, direction (3, 3) = R K^-1 (pixel to ray), origin (3,), normalised."""

    pixels: list
    directions: list
    origins: list
    near: float

    @classmethod
    def of(cls, views, centre, half: float, near: float, scale: int) -> "Photographs":
        """Pictures ``scale`` times smaller, averaged over areas; the box of interest gives the normalised frame."""
        pixels, directions, origins = [], [], []
        for view in views:
            width, height = (max(n // scale, 1) for n in (view.camera.width, view.camera.height))
            camera = view.camera.resized(width, height)
            pixels.append(cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA))
            directions.append((camera.world_from_camera[:3, :3] @ np.linalg.inv(camera.K)).astype(np.float32))
            origins.append(((camera.centre - centre) / half).astype(np.float32))
        return cls(pixels, directions, origins, near)

    def draw(self, rng: np.random.Generator, count: int, size: int) -> tuple[Rays, np.ndarray]:
        """``count`` rays in patches of size x size neighbouring pixels, and their colours (count, 3) in [0, 1]."""
        patches = count // size**2
        areas = np.array([p.shape[0] * p.shape[1] for p in self.pixels], float)
        which = np.sort(rng.choice(len(self.pixels), patches, p=areas / areas.sum()))
        corners = rng.random((patches, 2))
        drawn = [self._patches(k, corners[which == k], size) for k in np.unique(which)]
        origins, directions, colours = (np.concatenate(part) for part in zip(*drawn))
        return Rays(origins, directions, np.full(len(origins), self.near, np.float32)), colours

    def _patches(self, k: int, corners: np.ndarray, size: int):
        dy, dx = np.mgrid[:size, :size].reshape(2, -1)
        height, width = self.pixels[k].shape[:2]
        y = (corners[:, :1] * (height - size + 1)).astype(np.int64) + dy
        x = (corners[:, 1:] * (width - size + 1)).astype(np.int64) + dx
        x, y = np.clip(x.ravel(), 0, width - 1), np.clip(y.ravel(), 0, height - 1)
        pixels = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], -1).astype(np.float32)
        directions = pixels @ self.directions[k].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = np.repeat(self.origins[k][None], len(x), 0)
        return origins, directions, self.pixels[k][y, x].astype(np.float32) / 255
