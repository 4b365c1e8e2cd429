"""Camera paths for new views: around the scene, up and down around it, through the photographed views, or to the best ones.

Notation
    o_i, R_i    centre and rotation of camera i; focus: the point nearest to all optical axes
    d(a, b)     |o_a - o_b| / r + angle(R_a, R_b): how far two views are apart, r the distance they look from
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from scene.camera import Camera, look_at, nearest_to_rays
from scene.camera import orbit as circle

MOST_GAP_DEG = 60.0  # a path does not cross an arc wider than this that nobody photographed


@dataclass(frozen=True)
class CameraPath:
    """Named cameras in the order they are passed. fps: how many of them a second [1/s], where the path says so."""

    cameras: dict[str, Camera]
    fps: float | None = None

    @classmethod
    def through(cls, poses: Sequence[np.ndarray], like: Camera) -> "CameraPath":
        """The camera ``like`` put at poses (4, 4), named by their numbers."""
        return cls({f"{i:04d}": replace(like, world_from_camera=pose) for i, pose in enumerate(poses)})


def orbit(cameras: Sequence[Camera], *, frames: int = 60) -> CameraPath:
    """A circle around the photographs' focus at their median distance and elevation.

    Where the photographs leave an arc wider than ``MOST_GAP_DEG`` unseen, the path swings over the seen arc.
    """
    target, radius, elevations, start, sweep = _photographed(cameras)
    poses = circle(target, radius, np.degrees(np.median(elevations)), _checked(frames), start, sweep)
    return CameraPath.through(poses, cameras[0])


def spiral(cameras: Sequence[Camera], *, frames: int = 90, turns: float = 2.0, waves: float = 1.0) -> CameraPath:
    """``turns`` around the photographs' focus, up and down ``waves`` times between their elevations on the way.

    The elevations are those that nine of ten photographs keep within (5th to 95th percentile). Whole numbers of turns
    and waves close the path. Over an arc (see ``orbit``) the path swings to and fro ``turns`` times instead.
    """
    target, radius, elevations, start, sweep = _photographed(cameras)
    low, high = np.percentile(elevations, [5, 95])
    along = np.arange(_checked(frames)) / frames
    elevation = (low + high) / 2 + (high - low) / 2 * np.sin(2 * np.pi * waves * along)
    if sweep >= 360:
        azimuth = np.radians(start) + 2 * np.pi * turns * along
    else:
        azimuth = np.radians(start + sweep / 2 * (1 - np.cos(2 * np.pi * turns * along)))
    level = np.cos(elevation)
    sides = np.stack([np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)], axis=1)
    return CameraPath.through([look_at(target + radius * side, target) for side in sides], cameras[0])


def interpolate(cameras: Sequence[Camera], *, frames: int = 90, keys: int = 8) -> CameraPath:
    """A smooth path through ``keys`` photographed views that are far from each other (0: through all of them).

    They are passed in the order of a short tour; each is a frame of the path, exactly. Between them runs a centripetal
    Catmull-Rom spline: of the centres in space, of the rotations along great circles (Barry & Goldman 1988).
    """
    poses = np.stack([camera.world_from_camera for camera in cameras])
    apart = _distances(poses, np.median(np.linalg.norm(poses[:, :3, 3] - focus(cameras), axis=1)))
    chosen = _spread(apart, keys or len(cameras))
    if _checked(frames) < len(chosen):
        raise ValueError(f"{frames} frames cannot pass {len(chosen)} views: give more frames or fewer keys")
    order = chosen[_short_tour(apart[np.ix_(chosen, chosen)])]
    if len(order) == 1:
        return CameraPath.through(poses[order], cameras[0])
    gaps = apart[order[:-1], order[1:]]
    return CameraPath.through(_spline(poses[order], gaps, _shares(gaps, frames - 1)), cameras[0])


def best(cameras: Sequence[Camera], *, suggest: Callable, frames: int = 3, field=None, workspace=None) -> CameraPath:
    """The views to sketch on, one a second: the pair that ``suggest`` (`scene.viewpoints.suggest`) proposes, then each next
    one. field, workspace: as there."""
    ask = partial(suggest, cameras, field=field, workspace=workspace)
    views = list(ask().cameras)
    while len(views) < _checked(frames):
        views += ask(views).cameras
    return CameraPath({f"{i:04d}": view for i, view in enumerate(views[:frames])}, fps=1.0)


def load(cameras: Sequence[Camera], *, file: str) -> CameraPath:
    """The path in a file, see ``scene.pathfile``."""
    from scene.pathfile import read

    return read(file, cameras[0])


def focus(cameras: Sequence[Camera]) -> np.ndarray:
    """The point (3,) that is nearest to all optical axes: what the photographs look at."""
    return nearest_to_rays([camera.centre for camera in cameras], [camera.forward for camera in cameras])


def _photographed(cameras) -> tuple[np.ndarray, float, np.ndarray, float, float]:
    """Focus (3,), median distance [m], elevations (N,) [rad], and the arc seen: its start and sweep [deg]."""
    target = focus(cameras)
    offsets = np.stack([c.centre for c in cameras]) - target
    distances = np.linalg.norm(offsets, axis=1)
    azimuths = np.sort(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])))
    gaps = np.diff(azimuths, append=azimuths[0] + 360)
    widest = int(np.argmax(gaps))
    whole = gaps[widest] <= MOST_GAP_DEG
    start, sweep = (0.0, 360.0) if whole else (azimuths[(widest + 1) % len(azimuths)], 360 - gaps[widest])
    elevations = np.arcsin(offsets[:, 2] / np.maximum(distances, 1e-12))
    return target, float(np.median(distances)), elevations, float(start), float(sweep)


def _checked(frames: int) -> int:
    if frames < 1:
        raise ValueError(f"a path needs at least one frame, not {frames}")
    return frames


def _distances(poses, radius: float) -> np.ndarray:
    """d (N, N) between poses (N, 4, 4)."""
    centres, rotations = poses[:, :3, 3], poses[:, :3, :3]
    cosine = (np.einsum("aij,bij->ab", rotations, rotations) - 1) / 2
    return np.linalg.norm(centres[:, None] - centres, axis=-1) / max(radius, 1e-9) + np.arccos(np.clip(cosine, -1, 1))


def _spread(apart, count: int) -> np.ndarray:
    """Numbers of ``count`` views, each the farthest from those before it; fewer where views coincide."""
    chosen = [0]
    while len(chosen) < min(count, len(apart)):
        nearest = apart[chosen].min(axis=0)
        if nearest.max() < 1e-6:
            break
        chosen.append(int(np.argmax(nearest)))
    return np.array(chosen)


def _short_tour(apart) -> np.ndarray:
    """An order of N views that goes to each once and not far: nearest neighbours, then 2-opt, with open ends."""
    order = [int(np.argmax(apart.sum(axis=1)))]
    while len(order) < len(apart):
        order.append(min(set(range(len(apart))) - set(order), key=lambda i: (apart[order[-1], i], i)))
    length = lambda tour: apart[tour[:-1], tour[1:]].sum()
    tour, better = np.array(order), True
    while better:
        better = False
        for i in range(len(tour) - 1):
            for j in range(i + 2, len(tour) + 1):
                turned = np.concatenate([tour[:i], tour[i:j][::-1], tour[j:]])
                if length(turned) < length(tour) - 1e-9:
                    tour, better = turned, True
    return tour


def _shares(gaps, steps: int) -> np.ndarray:
    """Whole steps for each gap (G,), at least one, together ``steps``, nearly in the gaps' proportions."""
    shares = np.ones(len(gaps), dtype=int)
    for _ in range(steps - len(gaps)):
        shares[np.argmax(gaps / shares)] += 1
    return shares


def _spline(poses, gaps, steps) -> list[np.ndarray]:
    """Poses (4, 4) along a spline through ``poses`` (N, 4, 4), with ``steps`` (N - 1,) from each to the next."""
    quaternions, centres = _quat_wxyz(poses[:, :3, :3]), poses[:, :3, 3]
    knots = np.concatenate([[0], np.cumsum(np.sqrt(gaps))])
    knots = np.concatenate([[-knots[1]], knots, [2 * knots[-1] - knots[-2]]])
    centres = np.stack([2 * centres[0] - centres[1], *centres, 2 * centres[-1] - centres[-2]])
    quaternions = np.stack([_slerp(*quaternions[[1, 0]], 2), *quaternions, _slerp(*quaternions[[-2, -1]], 2)])
    path = []
    for i, count in enumerate(steps):
        for t in np.linspace(knots[i + 1], knots[i + 2], count, endpoint=False)[1:]:
            pose = np.eye(4)
            pose[:3, :3] = _rotation(_pyramid(_slerp, quaternions[i : i + 4], knots[i : i + 4], t))
            pose[:3, 3] = _pyramid(_lerp, centres[i : i + 4], knots[i : i + 4], t)
            path.append(pose)
        path.append(poses[i + 1])
    return [poses[0], *path]


def _pyramid(mix, points, knots, t: float) -> np.ndarray:
    """Barry & Goldman's recursion for a Catmull-Rom segment: ``points`` at four ``knots``, t between the middle two."""
    between = lambda a, b, i, j: mix(a, b, (t - knots[i]) / (knots[j] - knots[i]))
    first, middle, last = (between(points[i], points[i + 1], i, i + 1) for i in range(3))
    return between(between(first, middle, 0, 2), between(middle, last, 1, 3), 1, 2)


def _lerp(a, b, s: float) -> np.ndarray:
    return (1 - s) * a + s * b


def _slerp(a, b, s: float) -> np.ndarray:
    """The unit quaternion at s of the shorter great circle from a (s = 0) to b (s = 1), also beyond them."""
    b = b if a @ b >= 0 else -b
    angle = np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)) * 2
    if angle < 1e-9:
        return a
    return (np.sin((1 - s) * angle) * a + np.sin(s * angle) * b) / np.sin(angle)


def _quat_wxyz(rotations) -> np.ndarray:
    """Unit quaternions (N, 4) of rotations (N, 3, 3): the largest eigenvector of Bar-Itzhack's matrix (2000)."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = rotations.reshape(-1, 9).T
    rows = [[xx + yy + zz, zy - yz, xz - zx, yx - xy], [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy], [yx - xy, xz + zx, yz + zy, zz - xx - yy]]  # fmt: skip
    return np.linalg.eigh(np.moveaxis(np.array(rows), -1, 0))[1][:, :, -1]


def _rotation(quat_wxyz) -> np.ndarray:
    """The rotation (3, 3) of a quaternion."""
    w, x, y, z = quat_wxyz / np.linalg.norm(quat_wxyz)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])  # fmt: skip
