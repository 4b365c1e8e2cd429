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
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scene.camera import Camera
from scene.files import parse_json, replacing
from scene.frame.similarity import Similarity, umeyama, with_uncertainty
from scene.frame.triangulation import triangulate
from scene.model import Model, ReconstructionFailed

FAMILY, FAMILY_SIZE = "36h11", 587
OFFICIAL_FROM_OPENCV = [1, 0, 3, 2]
"""OpenCV goes clockwise from the top left corner of its own pictures, the official ones turned by 180 degrees."""
FROM_OPENCV_PX = 0.08
"""OpenCV's AprilTag refinement counts from the corner of a pixel, as we do, but for this (measured)."""
ENLARGED = 2
"""Tags are sought at twice the picture's size: on 640x480 that finds a sixth more, five times as exactly (0.05 px)."""
LEAST_NOISE_PX = 0.1
"""What a detected corner is off by at least, when the frame's uncertainty is told."""


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
        return parse_json(path, "tag layout", cls._parsed)

    @classmethod
    def _parsed(cls, content) -> "TagLayout":
        if content["family"] != FAMILY:
            raise ValueError(f"family must be {FAMILY}, not {content['family']}")
        tags = content["tags"]
        if not (isinstance(tags, dict) and all(isinstance(tag, dict) for tag in tags.values())):
            raise ValueError('tags must be like {"0": {"base_from_tag": [[...]]}}: each number with its 4 x 4 pose')
        poses = {int(n): np.array(tag["base_from_tag"], dtype=float) for n, tag in tags.items()}
        return cls(float(content["size"]), poses)

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
    numbered = f"tag{'s' if len(used) > 1 else ''} {', '.join(map(str, used))} of {1000 * layout.size:.0f} mm"
    similarity = replace(similarity, rests_on=numbered)
    similarity = _refine(similarity, {n: observations[n] for n in used}, corners, cameras)
    residuals = {n: 1000 * _tag_residual(similarity, triangulated[n], corners[n]) for n in sorted(triangulated)}
    total = float(np.sqrt(np.mean([residuals[n] ** 2 for n in used])))
    wrong = [f"tag {n} lies {mm:.0f} mm from where the layout says" for n, mm in residuals.items() if n not in used]
    left_out = (f"left out: {', '.join(wrong)}",) if wrong else ()
    return replace(
        similarity, residual_mm=total, residuals_mm=residuals, used=used, warnings=similarity.warnings + left_out
    )  # fmt: skip


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


def _refine(similarity: Similarity, observations, corners, cameras) -> Similarity:
    """Robust least squares on the reprojection [px] of the corners' true places in all pictures that saw them."""
    from scipy.optimize import least_squares

    found = [pair for n in observations for pair in zip(corners[n], observations[n]) if len(pair[1].views)]
    places = np.concatenate([np.broadcast_to(place, (len(corner.views), 3)) for place, corner in found])
    pixels = np.concatenate([corner.pixels for _, corner in found])
    P = np.array([camera.projection for camera in cameras])[np.concatenate([corner.views for _, corner in found])]

    def errors(x):
        moved = similarity.nudged(x, middle)
        in_model = (places - moved.translation) @ moved.rotation / moved.scale
        seen = np.einsum("vij,vj->vi", P[:, :, :3], in_model) + P[:, :, 3]
        return (seen[:, :2] / seen[:, 2:] - pixels).ravel()

    middle = places.mean(axis=0)
    best = least_squares(errors, np.zeros(7), loss="soft_l1", f_scale=0.5, x_scale="jac")
    noise = max(float(np.sqrt((errors(best.x) ** 2).mean())), LEAST_NOISE_PX)
    return with_uncertainty(similarity.nudged(best.x, middle), best.jac, noise, cameras, middle)
