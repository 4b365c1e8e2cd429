"""Photographs of a world, as a person with a camera would walk around it and take them."""

import numpy as np

from scene.camera import Camera, look_at

GOLDEN = np.pi * (3 - np.sqrt(5))


def hemisphere(view: dict, *, seed: int = 0, count=48, width=640, height=480, fov_deg=55.0, radius=(1.25, 1.75), elevation_deg=(22.0, 68.0),
               jitter=0.08) -> list[Camera]:  # fmt: skip
    """``count`` cameras evenly over the hemisphere around ``view["target"]`` (3,) [m], all looking near it.

    They lie on a golden spiral between two elevations [deg], at distances within ``radius`` [m], the higher the nearer;
    ``jitter`` [m] is the standard deviation of a hand's inaccuracy, in place and in what is looked at.
    """
    rng = np.random.default_rng(seed)
    target = np.array(view["target"], dtype=float)
    share = (np.arange(count) + 0.5) / count
    low, high = np.sin(np.radians(elevation_deg))
    elevation = np.arcsin(low + share * (high - low))
    azimuth = GOLDEN * np.arange(count)
    distance = radius[1] + share * (radius[0] - radius[1])
    offsets = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1)
    eyes = target + distance[:, None] * offsets + rng.normal(0, jitter, (count, 3))
    aims = target + rng.normal(0, jitter, (count, 3))
    return [Camera.from_fov(look_at(eye, aim), width, height, fov_deg) for eye, aim in zip(eyes, aims)]
