"""AprilTags (36h11) at known places turn a model without scale into metres in the robot's base frame.

Tag frame, looking at the upright official picture: origin at the centre of the black square, x right, y up, z out of
the paper. Corners of the black square in the official library's order, counter-clockwise as one looks at the picture:

    3 ---- 2      0 bottom left (-s/2, -s/2, 0)      1 bottom right (s/2, -s/2, 0)
    |      |      2 top right   ( s/2,  s/2, 0)      3 top left    (-s/2, s/2, 0)
    0 ---- 1      s: edge of the black square [m], without the white border around it

Notation
    x_base = s R x_model + t     the Similarity (s, R, t) from the model's frame to the robot's base
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from scene.camera import Camera
from scene.colmap import Model, ReconstructionFailed
from scene.files import replacing

FAMILY, FAMILY_SIZE = "36h11", 587
OFFICIAL_FROM_OPENCV = [1, 0, 3, 2]
"""OpenCV goes clockwise from the top left corner of its own pictures, the official ones turned by 180 degrees."""
FROM_OPENCV_PX = 0.08
"""OpenCV's AprilTag refinement counts from the corner of a pixel, as we do, but for this (measured)."""
ENLARGED = 2
"""Tags are sought at twice the picture's size: on 640x480 that finds a sixth more, five times as exactly (0.05 px)."""
INLIER_PX = 2.0
"""A detected corner further than this from where all views together put it is an outlier."""


@dataclass(frozen=True, eq=False)
class TagLayout:
    """Where tags are. size: edge of the black square [m]; base_from_tag: {number: (4, 4)} rigid transforms [m]."""

    size: float
    base_from_tag: Mapping[int, np.ndarray]

    def __post_init__(self):
        if not (np.isfinite(self.size) and self.size > 0):
            raise ValueError(f"tag size must be a positive length in metres, not {self.size}")
        if not self.base_from_tag:
            raise ValueError("a tag layout needs at least one tag")
        poses = {int(number): np.array(pose, dtype=float) for number, pose in self.base_from_tag.items()}
        for number, pose in poses.items():
            if not 0 <= number < FAMILY_SIZE:
                raise ValueError(f"tag {number} is not in {FAMILY}: numbers go from 0 to {FAMILY_SIZE - 1}")
            if pose.shape != (4, 4) or not _is_rigid(pose):
                raise ValueError(f"tag {number}: base_from_tag must be a rigid transform (4, 4)")
        _refuse_overlap(self.size, poses)
        object.__setattr__(self, "base_from_tag", poses)

    @property
    def ids(self) -> tuple[int, ...]:
        """The tags' numbers."""
        return tuple(self.base_from_tag)

    def corners(self) -> dict[int, np.ndarray]:
        """{number: (4, 3)} corners of the black squares in the robot's base frame [m], in the official order."""
        square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * self.size / 2
        return {number: square @ pose[:3, :3].T + pose[:3, 3] for number, pose in self.base_from_tag.items()}

    @classmethod
    def load(cls, path: str | Path) -> "TagLayout":
        """Read tags.json: {"family": "36h11", "size": [m], "tags": {number: {"base_from_tag": 4 x 4}}}."""
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"no such tag layout: {path}")
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["family"] != FAMILY:
                raise ValueError(f"family must be {FAMILY}, not {content['family']}")
            poses = {int(n): np.array(tag["base_from_tag"], dtype=float) for n, tag in content["tags"].items()}
            return cls(float(content["size"]), poses)
        except KeyError as error:
            raise ValueError(f"{path}: missing {error.args[0]}") from error
        except (TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from error

    def save(self, path: str | Path):
        """Write tags.json, whole or not at all."""
        tags = {str(number): {"base_from_tag": pose.tolist()} for number, pose in self.base_from_tag.items()}
        content = {"family": FAMILY, "size": float(self.size), "tags": tags}
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")


def _is_rigid(pose: np.ndarray) -> bool:
    R = pose[:3, :3]
    orthonormal = np.allclose(R.T @ R, np.eye(3), atol=1e-4) and np.linalg.det(R) > 0
    return bool(orthonormal and np.allclose(pose[3], [0, 0, 0, 1]))


def _refuse_overlap(size: float, poses: Mapping[int, np.ndarray]):
    for a, b in itertools.combinations(poses, 2):
        gap = np.linalg.norm(poses[a][:3, 3] - poses[b][:3, 3])
        if gap < size / 2:
            raise ValueError(f"tags {a} and {b} lie in the same place: their centres are {1000 * gap:.0f} mm apart")


@dataclass(frozen=True, eq=False)
class Similarity:
    """x_to = scale rotation x_from + translation, and what is known of the frame it leads to.

    frame: "robot base" [m] or "arbitrary". residual_mm: rms distance of the tags' corners to their places;
    tag_residuals_mm: the same for each tag seen twice; nan and empty for an arbitrary frame. tags: those it rests on.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    frame: str = "robot base"
    residual_mm: float = float("nan")
    tag_residuals_mm: Mapping[int, float] = field(default_factory=dict)
    tags: tuple[int, ...] = ()

    @property
    def matrix(self) -> np.ndarray:
        """to_from_from (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.scale * self.rotation, self.translation
        return matrix

    def apply(self, points) -> np.ndarray:
        """Points (..., 3) in the new frame."""
        return self.scale * np.asarray(points, dtype=float) @ self.rotation.T + self.translation

    def move(self, camera: Camera) -> Camera:
        """The camera in the new frame."""
        return camera.moved(self.matrix)

    def describe(self) -> dict:
        """The frame as transforms.json keeps it (scene.dataset.save_views)."""
        if self.frame == "arbitrary":
            return {"name": "arbitrary", "unit": "arbitrary"}
        residuals = {str(number): mm for number, mm in self.tag_residuals_mm.items()}
        return {
            "name": self.frame, "unit": "m", "residual_mm": self.residual_mm,
            "tags": list(self.tags), "tag_residuals_mm": residuals,
        }  # fmt: skip


def detect(image: np.ndarray) -> dict[int, np.ndarray]:
    """Tags in a picture (H, W, 3) or (H, W) uint8: {number: corners (4, 2) px}, in the official order."""
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    grey = cv2.resize(grey, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    if numbers is None:
        return {}
    found = (np.reshape(corners, (-1, 4, 2)).astype(float) + FROM_OPENCV_PX) / ENLARGED
    return {int(n): c[OFFICIAL_FROM_OPENCV] for n, c in zip(np.ravel(numbers), found, strict=True)}


def triangulate(
    pixels: np.ndarray, cameras: Sequence[Camera], threshold: float = INLIER_PX
) -> tuple[np.ndarray, np.ndarray]:
    """One point from its pixels (V, 2) in V cameras, some of which may be wrong.

    Every pair of views proposes a point; the one most views agree with, within ``threshold`` [px], is refined by them.
    Returns the point (3,) and which views agree (V,) bool; fewer than two, and a point of nan, if no two do.
    """
    P = np.array([camera.projection for camera in cameras]).reshape(-1, 3, 4)
    pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
    a, b = np.triu_indices(len(P), k=1)
    rows = pixels[..., None] * P[:, 2:] - P[:, :2]  # (V, 2, 4): u P3 - P1 and v P3 - P2 annihilate the point
    points = np.linalg.svd(np.concatenate([rows[a], rows[b]], axis=1))[2][:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = points[:, :3] / points[:, 3:]
        errors = _reprojection(P, points[:, None], pixels)  # (pairs, V)
    if not len(points) or not (errors < threshold).sum(axis=1).max() >= 2:
        return np.full(3, np.nan), np.zeros(len(P), dtype=bool)
    best = np.minimum(np.nan_to_num(errors, nan=np.inf), threshold).sum(axis=1).argmin()
    return _refine_point(P, pixels, points[best], errors[best] < threshold, threshold)


def _reprojection(P: np.ndarray, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Distance [px] between pixels (V, 2) and points (..., V or 1, 3) seen through P (V, 3, 4); nan behind a camera."""
    points = np.broadcast_to(points, (*points.shape[:-2], len(P), 3))
    seen = np.einsum("vij,...vj->...vi", P[:, :, :3], points) + P[:, :, 3]
    depth = np.where(seen[..., 2] > 1e-9, seen[..., 2], np.nan)
    return np.linalg.norm(seen[..., :2] / depth[..., None] - pixels, axis=-1)


def _refine_point(P, pixels, point, inside, threshold):
    """Least squares over the views that agree: the linear equations, each weighted by its inverse depth."""
    for _ in range(5):
        depth = point @ P[inside, 2, :3].T + P[inside, 2, 3]
        rows = (pixels[inside][..., None] * P[inside, 2:] - P[inside, :2]) / depth[:, None, None]
        rows = rows.reshape(-1, 4)
        point = np.linalg.lstsq(rows[:, :3], -rows[:, 3], rcond=None)[0]
        agree = _reprojection(P, point[None], pixels) < threshold
        if agree.sum() < 2:
            break
        inside = agree
    return point, inside


def align(model: Model, layout: TagLayout) -> Similarity:
    """The similarity from the model's frame to the robot's base, from the layout's tags in the model's pictures.

    Each corner is triangulated over all views; tags that agree on one similarity are chosen, and it is refined on the
    reprojection of their corners in all pictures. Raises ReconstructionFailed, saying what was seen.
    """
    seen = [detect(view.image) for view in model.views()]
    return fit_frame(seen, model.cameras, layout)


def fit_frame(seen: Sequence[Mapping[int, np.ndarray]], cameras: Sequence[Camera], layout: TagLayout) -> Similarity:
    """``align`` on what was detected: ``seen[i]`` is what ``detect`` found in the picture of ``cameras[i]``."""
    observations = _observations(seen, cameras, layout)
    corners = layout.corners()
    triangulated = {n: np.array([o.point for o in observations[n]]) for n in observations}
    triangulated = {n: points for n, points in triangulated.items() if np.isfinite(points).all(axis=1).sum() >= 3}
    if not triangulated:
        counts = {n: sum(n in found for found in seen) for n in sorted(set().union(*seen))}
        there = ", ".join(f"tag {n} in {count}" for n, count in counts.items()) or "no tag in any"
        raise ReconstructionFailed(
            f"no tag of the layout ({', '.join(map(str, layout.ids))}) was found by two of {len(cameras)} pictures: "
            f"seen {there}; check the numbers in tags.json and photograph the tags larger, from more sides"
        )
    similarity = _agreed(triangulated, corners, layout.size)
    used = _agreeing(similarity, triangulated, corners, layout.size)
    similarity = _refine(similarity, {n: observations[n] for n in used}, corners, cameras)
    residuals = {n: 1000 * _tag_residual(similarity, triangulated[n], corners[n]) for n in sorted(triangulated)}
    total = float(np.sqrt(np.mean([residuals[n] ** 2 for n in used])))
    return replace(similarity, residual_mm=total, tag_residuals_mm=residuals, tags=used)


@dataclass(frozen=True, eq=False)
class _Corner:
    """One corner of a tag: where it is in the model's frame, and the pixels of the views that agree on it."""

    point: np.ndarray
    views: np.ndarray
    pixels: np.ndarray


def _observations(seen, cameras, layout) -> dict[int, list[_Corner]]:
    """The four corners of every tag of the layout that two views have seen."""
    observations = {}
    for number in layout.ids:
        views = np.array([i for i, found in enumerate(seen) if number in found], dtype=int)
        if len(views) < 2:
            continue
        observations[number] = []
        for k in range(4):
            pixels = np.array([seen[i][number][k] for i in views])
            point, agree = triangulate(pixels, [cameras[i] for i in views])
            observations[number].append(_Corner(point, views[agree], pixels[agree]))
    return observations


def _tolerance(size: float) -> float:
    """How far [m] a tag's corners may lie from their places: a tenth of its edge."""
    return size / 10


def _tag_residual(similarity: Similarity, points: np.ndarray, places: np.ndarray) -> float:
    """Rms distance [m] of the triangulated corners of a tag from their places."""
    return float(np.sqrt(np.nanmean(((similarity.apply(points) - places) ** 2).sum(axis=1))))


def _agreeing(similarity, triangulated, corners, size) -> tuple[int, ...]:
    """The tags that lie where the layout says, within the tolerance."""
    return tuple(n for n in triangulated if _tag_residual(similarity, triangulated[n], corners[n]) < _tolerance(size))


def _agreed(triangulated, corners, size) -> Similarity:
    """The similarity that most tags agree on: every tag and pair of tags proposes one; all that agree are fitted."""
    numbers = list(triangulated)
    proposals = [[a] for a in numbers] + [[a, b] for i, a in enumerate(numbers) for b in numbers[:i]]
    candidates = [umeyama(*_stacked(triangulated, corners, chosen)) for chosen in proposals]

    def residuals(similarity):
        return np.array([_tag_residual(similarity, triangulated[n], corners[n]) for n in numbers])

    costs = [np.minimum(residuals(candidate), _tolerance(size)).sum() for candidate in candidates]
    agreeing = _agreeing(candidates[int(np.argmin(costs))], triangulated, corners, size)
    if 2 * len(agreeing) <= len(numbers) and len(numbers) > 1:
        raise ReconstructionFailed(
            f"the tags do not lie as the layout says: of {len(numbers)} tags ({', '.join(map(str, numbers))}) only "
            f"{len(agreeing)} agree within {1000 * _tolerance(size):.0f} mm; measure their places and their size "
            f"({size} m, black square) again"
        )
    return umeyama(*_stacked(triangulated, corners, agreeing))


def _stacked(triangulated, corners, numbers):
    points, places = (np.concatenate([table[n] for n in numbers]) for table in (triangulated, corners))
    known = np.isfinite(points).all(axis=1)
    return points[known], places[known]


def umeyama(points: np.ndarray, places: np.ndarray) -> Similarity:
    """The similarity that brings points (N, 3) closest to places (N, 3) (Umeyama 1991, eqs. 40-43)."""
    mean_x, mean_y = points.mean(axis=0), places.mean(axis=0)
    x, y = points - mean_x, places - mean_y
    spread = np.linalg.svd(x, compute_uv=False)
    if len(points) < 3 or spread[1] < 1e-3 * spread[0] or spread[0] < 1e-12:
        raise ReconstructionFailed(f"a frame needs three points that do not lie on one line; there are {len(points)}")
    U, D, Vt = np.linalg.svd(y.T @ x / len(x))
    S = np.diag([1, 1, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    rotation = U @ S @ Vt
    scale = np.trace(np.diag(D) @ S) / (x**2).sum() * len(x)
    return Similarity(float(scale), rotation, mean_y - scale * rotation @ mean_x)


def _refine(similarity: Similarity, observations, corners, cameras) -> Similarity:
    """Robust least squares on the reprojection [px] of the corners' true places in all pictures that saw them."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    found = [pair for n in observations for pair in zip(corners[n], observations[n]) if len(pair[1].views)]
    places = np.concatenate([np.broadcast_to(place, (len(corner.views), 3)) for place, corner in found])
    pixels = np.concatenate([corner.pixels for _, corner in found])
    P = np.array([camera.projection for camera in cameras])[np.concatenate([corner.views for _, corner in found])]

    def moved(x):  # a small similarity in the robot's frame, about the middle of the tags
        turn = Rotation.from_rotvec(x[:3]).as_matrix()
        return np.exp(x[3]) * turn, x[4:]

    def errors(x):
        turn, shift = moved(x)
        before = (places - middle - shift) @ np.linalg.inv(turn).T + middle
        in_model = (before - similarity.translation) @ similarity.rotation / similarity.scale
        seen = np.einsum("vij,vj->vi", P[:, :, :3], in_model) + P[:, :, 3]
        return (seen[:, :2] / seen[:, 2:] - pixels).ravel()

    middle = places.mean(axis=0)
    turn, shift = moved(least_squares(errors, np.zeros(7), loss="soft_l1", f_scale=0.5, x_scale="jac").x)
    growth = np.cbrt(np.linalg.det(turn))
    translation = turn @ (similarity.translation - middle) + middle + shift
    rotation = turn / growth @ similarity.rotation
    return replace(similarity, scale=float(similarity.scale * growth), rotation=rotation, translation=translation)


def gravity_frame(cameras: Sequence[Camera], points: np.ndarray) -> Similarity:
    """A frame for a scene without tags: z up, origin at the middle of the scene, the median camera at distance 1.

    Up is where upright cameras have it (their x axes are level), corrected to the normal of the plane most of the
    points lie on if that is within 20 degrees. x points right in the first photograph. The scale is arbitrary.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    poses = np.array([camera.world_from_camera for camera in cameras])
    up = _up_of_plane(points, _up_of_cameras(poses))
    middle = _middle(poses, points)
    right = poses[0][:3, 0] - up * (up @ poses[0][:3, 0])
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(poses[0][:3, 2], up)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(up, right), up])
    scale = 1 / np.median(np.linalg.norm(poses[:, :3, 3] - middle, axis=1))
    return Similarity(float(scale), rotation, -scale * rotation @ middle, frame="arbitrary")


def _up_of_cameras(poses: np.ndarray) -> np.ndarray:
    """The direction most perpendicular to all x axes, on the side of -y; the mean -y if cameras stand in a row."""
    mean = -poses[:, :3, 1].mean(axis=0)
    _, spread, axes = np.linalg.svd(poses[:, :3, 0])
    level = axes[-1] * np.sign(axes[-1] @ mean)
    up = level if len(poses) >= 3 and spread[1] > 0.2 * spread[0] and np.any(level) else mean
    return up / np.linalg.norm(up)


def _up_of_plane(points: np.ndarray, up: np.ndarray, trials: int = 500) -> np.ndarray:
    """The normal of the plane with most points, if near ``up`` and through a third of them; else ``up``."""
    if len(points) < 30:
        return up
    rng = np.random.default_rng(0)
    thickness = 0.01 * np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1))
    a, b, c = np.moveaxis(points[rng.integers(0, len(points), (trials, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(lengths > 1e-12, lengths, np.inf)
    upright = np.abs(normals @ up) > np.cos(np.radians(20))
    counts = [(np.abs((points - p) @ n) < thickness).sum() if ok else 0 for p, n, ok in zip(a, normals, upright)]
    best = int(np.argmax(counts))
    if counts[best] < len(points) / 3:
        return up
    plane = points[np.abs((points - a[best]) @ normals[best]) < thickness]
    normal = np.linalg.svd(plane - plane.mean(axis=0))[2][-1]
    return normal * np.sign(normal @ up)


def _middle(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The point (3,) closest to all optical axes; the median of the points where the axes are nearly parallel."""
    forward = poses[:, :3, 2]
    across = np.eye(3) - forward[:, :, None] * forward[:, None]
    A = across.sum(axis=0)
    if np.linalg.cond(A) < 100 or not len(points):
        return np.linalg.lstsq(A, np.einsum("vij,vj->i", across, poses[:, :3, 3]), rcond=None)[0]
    return np.median(points, axis=0)
