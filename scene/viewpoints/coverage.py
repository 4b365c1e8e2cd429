"""Where a scene can be looked at from: what its photographs cover, and what the field lets one see there.

Notation
    c           middle of the motions that may be sketched [m]
    T(o, x)     transmittance: how much light gets from x to o, by the field

A field is sharp where photographs were taken and guesses elsewhere, so a new view stands at the distance of the
photographs around it, seen from c, and no wider angle from the nearest of them than `Limits` say. A view that shows
little of what photographs see of the motions' places, since something stands before them, is refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scene.camera import Camera, look_at

CLEAR = 0.5
"""A point is seen if more than this share of its light arrives."""
WITNESSES = 3
"""Where so many photographs see a point, it lies in the open: the others lie inside of something."""
GOLDEN = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class Limits:
    """What a view must keep to.

    spacing_deg: between viewpoints that are tried; farthest_deg: from the nearest photograph, both seen from c.
    widest_fov_deg: a view is as wide as it must be, up to this. least_seen: share of the motions' places in the open
    that must be seen.
    """

    spacing_deg: float = 12.0
    farthest_deg: float = 12.0
    widest_fov_deg: float = 80.0
    least_seen: float = 0.7


def common_box(photographed: Sequence[Camera], lower, upper, least: float = 0.9, seed: int = 0):
    """Corners (3,), (3,) [m] of the part of a box that nearly all photographs hold: what can be sketched on most views.

    least: share of the photographs. Without such a part, ValueError.
    """
    points = np.random.default_rng(seed).uniform(lower, upper, (4000, 3))
    held = np.mean([camera.contains(camera.project(points)) for camera in photographed], axis=0)
    if (held >= least).sum() < 8:
        raise ValueError(
            f"no part of the workspace {_corner(lower)} to {_corner(upper)} lies in {least:.0%} of the "
            f"{len(photographed)} photographs (the best point is in {held.max():.0%}): photograph it, or give "
            "scene.viewpoints.workspace where they look"
        )
    low, high = np.percentile(points[held >= least], [5, 95], axis=0)
    return low, high


def _corner(x) -> str:
    return "(" + ", ".join(f"{v:.2f}" for v in x) + ")"


def candidates(
    photographed: Sequence[Camera],
    motions,
    field=None,
    *,
    width: int = 640,
    height: int = 480,
    limits: Limits = Limits(),
) -> list[Camera]:
    """Cameras from which the motions (n, N, 3) [m] can be sketched, seen well and whole.

    With a ``field``, new viewpoints; without one, the photographs' own. ValueError if fewer than two are left.
    """
    points = np.asarray(motions, dtype=float).reshape(-1, 3)
    if field is None:
        cameras = [camera.cropped(width, height) for camera in photographed]
    else:
        poses = around(photographed, points.mean(axis=0), limits.spacing_deg, limits.farthest_deg)
        cameras = [holding(pose, points, width, height, limits.widest_fov_deg) for pose in poses]
    whole = [camera for camera in cameras if camera.contains(camera.project(points)).mean() > 0.95]
    shares = np.ones(len(whole)) if field is None else shares_seen(field, whole, points, photographed)
    found = [camera for camera, share in zip(whole, shares, strict=True) if share >= limits.least_seen]
    if len(found) < 2:
        raise ValueError(
            f"of {len(cameras)} views {len(whole)} hold the motions' places, and {len(found)} of these see them unhidden; "
            "two are needed: take photographs around the workspace, or make scene.viewpoints.workspace smaller"
        )
    return found


def around(photographed: Sequence[Camera], target, spacing_deg: float, farthest_deg: float) -> list[np.ndarray]:
    """Poses (4, 4) about ``spacing_deg`` apart that look at ``target`` (3,) [m] from where photographs look.

    They stand on a golden spiral over the sphere, at the mean distance of the three nearest photographs.
    """
    offsets = np.stack([camera.centre for camera in photographed]) - target
    distances = np.linalg.norm(offsets, axis=1)
    count = int(np.ceil(4 * np.pi / np.radians(spacing_deg) ** 2))
    z = 1 - (2 * np.arange(count) + 1) / count
    side, azimuth = np.sqrt(1 - z**2), GOLDEN * np.arange(count)
    directions = np.stack([side * np.cos(azimuth), side * np.sin(azimuth), z], axis=1)
    apart = np.degrees(np.arccos(np.clip(directions @ (offsets / distances[:, None]).T, -1, 1)))
    nearest = np.argsort(apart, axis=1)[:, :3]
    near = apart.min(axis=1) <= farthest_deg
    eyes = target + distances[nearest].mean(axis=1, keepdims=True) * directions
    return [look_at(eye, target) for eye in eyes[near]]


def holding(pose, points, width: int, height: int, widest_fov_deg: float = 80.0) -> Camera:
    """The camera at ``pose`` (4, 4) whose picture is just wide enough for the points (N, 3) [m], up to a limit."""
    unit = Camera.from_fov(pose, width, height, 60)
    reach = np.abs(unit.project(points) / [width / 2, height / 2] - 1).max()
    needed = 1.1 * np.nan_to_num(reach, nan=np.inf) * np.tan(np.radians(30))
    fov = 2 * np.arctan(min(needed, np.tan(np.radians(widest_fov_deg) / 2)))
    return Camera.from_fov(pose, width, height, np.degrees(fov))


def shares_seen(field, cameras: Sequence[Camera], points, photographed: Sequence[Camera]) -> np.ndarray:
    """(C,) share of the points (N, 3) [m] in the open that each camera sees unhidden, in its picture or beside it."""
    seen = lambda camera: field.transmittance(camera.centre, points) > CLEAR
    witnesses = sum((seen(c) & c.contains(c.project(points))).astype(int) for c in photographed)
    open_ = witnesses >= min(WITNESSES, len(photographed))
    return np.array([seen(camera)[open_].mean() if open_.any() else 0.0 for camera in cameras])
