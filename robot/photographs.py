"""Photographs of a world, as a person with a camera would walk around it and take them."""

import numpy as np

from scene.camera import Camera, look_at

GOLDEN = np.pi * (3 - np.sqrt(5))
AROUND = {"radius": (1.25, 1.75), "elevation_deg": (22.0, 68.0), "azimuth_deg": (0.0, 360.0)}


def sketch_views(world: dict, *, seed: int = 0, count=2, width=1280, height=960, fov_deg=None, jitter=0.02) -> list[Camera]:
    """Photographs to sketch on, taken from the first ``count`` of the world's sketch views by a hand that is off by ``jitter`` [m].

    fov_deg: of the lens; None: as the views say, which must then agree.
    """
    rng, views = np.random.default_rng(seed), world["sketch_views"][:count]
    if len(views) < count or (fov_deg is None and len({view["fov_deg"] for view in views}) > 1):
        raise ValueError(f"world {world['name']} has {len(views)} sketch views, and one lens is to take {count} photographs: set count or fov_deg")
    moved = lambda point: np.array(point, dtype=float) + rng.normal(0, jitter, 3)
    return [Camera.from_fov(look_at(moved(v["eye"]), moved(v["target"])), width, height, fov_deg or v["fov_deg"]) for v in views]


def hemisphere(world: dict, *, seed: int = 0, count=48, width=640, height=480, fov_deg=55.0, radius=None, elevation_deg=None,
               azimuth_deg=None, jitter=0.08) -> list[Camera]:  # fmt: skip
    """``count`` cameras evenly over a part of the hemisphere around the target (3,) [m] of the world's ``view``, all looking near it.

    They lie on a golden spiral between two elevations and two azimuths [deg] (0 is along x, 90 along y), at distances
    within ``radius`` [m], the higher the nearer. Where these are None, the world's ``view`` says them (into a box one
    sees from above, into a shelf from one side), or else they are AROUND. ``jitter`` [m] is the standard deviation of a
    hand's inaccuracy, in place and in what is looked at.
    """
    rng, view = np.random.default_rng(seed), world["view"]
    asked = {"radius": radius, "elevation_deg": elevation_deg, "azimuth_deg": azimuth_deg}
    where = AROUND | {key: view[key] for key in AROUND if key in view} | {key: pair for key, pair in asked.items() if pair is not None}
    (most, least), (low, high), (first, last) = (where[key] for key in ("radius", "elevation_deg", "azimuth_deg"))
    target = np.array(view["target"], dtype=float)
    share = (np.arange(count) + 0.5) / count
    low, high = np.sin(np.radians([low, high]))
    elevation = np.arcsin(low + share * (high - low))
    azimuth = np.radians(first + (GOLDEN * np.arange(count) / (2 * np.pi)) % 1 * (last - first))
    distance = least + share * (most - least)
    offsets = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1)
    eyes = target + distance[:, None] * offsets + rng.normal(0, jitter, (count, 3))
    aims = target + rng.normal(0, jitter, (count, 3))
    return [Camera.from_fov(look_at(eye, aim), width, height, fov_deg) for eye, aim in zip(eyes, aims)]
