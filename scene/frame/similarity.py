"""From one frame to another that differs in scale, direction and place, and how sure that change is.

Notation
    x_to = s R x_from + t     the Similarity (s, R, t)
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from scene.camera import Camera
from scene.model import ReconstructionFailed

UNSURE_MM, USELESS_MM = 5.0, 50.0
"""A frame that may be off by more than this where the cameras stand is said to be unsure, or refused."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """x_to = scale rotation x_from + translation, and what is known of the frame it leads to.

    frame: "robot base" [m], "level" [m] (z up, but its origin and heading are not the robot's) or "arbitrary".
    residual_mm: rms distance of what the frame rests on from where it should be; residuals_mm: the same for each tag
    or photograph by name; used: the names of those that agree. rests_on: the same in words. uncertainty_mm: by how
    much [rms] the cameras may be off as a whole, if errors are independent. warnings: sentences.
    extra: what else was found, as JSON has it. nan and empty where a frame is arbitrary.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    frame: str = "robot base"
    residual_mm: float = float("nan")
    residuals_mm: Mapping[int | str, float] = field(default_factory=dict)
    used: tuple[int | str, ...] = ()
    rests_on: str = ""
    uncertainty_mm: float = float("nan")
    warnings: tuple[str, ...] = ()
    extra: Mapping[str, object] = field(default_factory=dict)

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

    def nudged(self, x: np.ndarray, about: np.ndarray) -> "Similarity":
        """After it, a small similarity about a point (3,): x (7,) is rotation vector [rad], log of scale, shift."""
        from scipy.spatial.transform import Rotation

        turn, growth = Rotation.from_rotvec(x[:3]).as_matrix(), np.exp(x[3])
        translation = growth * turn @ (self.translation - about) + about + x[4:7]
        return replace(self, scale=float(self.scale * growth), rotation=turn @ self.rotation, translation=translation)

    def describe(self) -> dict:
        """The frame as transforms.json keeps it (scene.dataset.save_views)."""
        if self.frame == "arbitrary":
            return {"name": "arbitrary", "unit": "arbitrary"}
        numbers = {"residual_mm": self.residual_mm, "uncertainty_mm": self.uncertainty_mm}
        return (
            {"name": self.frame, "unit": "m", "rests_on": self.rests_on}
            | {key: value for key, value in numbers.items() if np.isfinite(value)}
            | {"used": list(self.used), "residuals_mm": {str(n): mm for n, mm in self.residuals_mm.items()}}
            | {"warnings": list(self.warnings), **self.extra}
        )


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


def nearest_rotation(M: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) with the largest trace(R^T M): the mean of rotations whose sum is M (Kabsch 1976)."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1, 1, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt


def jacobian(points: np.ndarray, about: np.ndarray) -> np.ndarray:
    """How points (N, 3) move with ``Similarity.nudged``'s x: (N, 3, 7)."""
    r = np.asarray(points, dtype=float) - about
    J = np.zeros((len(r), 3, 7))
    J[:, :, :3] = np.cross(r[:, None], np.eye(3))
    J[:, :, 3], J[:, :, 4:] = r, np.eye(3)
    return J


def with_uncertainty(
    found: Similarity, J: np.ndarray, noise: float, cameras: Sequence[Camera], about: np.ndarray
) -> Similarity:
    """``found`` with how far the cameras may be off, and a warning or ReconstructionFailed where that is far.

    J: (M, 7 or more) derivative of M residuals by ``nudged``'s x, then by what else was estimated; noise: the standard
    deviation of each of the residuals, in their unit.
    """
    width = np.linalg.norm(J, axis=0)
    _, s, Vt = np.linalg.svd(J / np.where(width > 0, width, 1), full_matrices=False)
    deviations = (Vt / np.maximum(s, 1e-12)[:, None])[:, :7]  # (K, 7), independent of each other
    deviations = deviations / np.where(width > 0, width, 1e-12)[:7]
    moves = np.einsum("nij,kj->nki", jacobian([found.move(camera).centre for camera in cameras], about), deviations)
    return judged(found, 1000 * noise * float(np.sqrt((moves**2).sum(axis=(1, 2)).mean())))


def judged(found: Similarity, off_mm: float) -> Similarity:
    """``found`` with its uncertainty [mm]: said where it is large, ReconstructionFailed where it is useless."""
    by = f"the cameras may be off by {off_mm:.0f} mm" if off_mm < 1e4 else "that leaves the frame open"
    if not off_mm <= USELESS_MM:
        raise ReconstructionFailed(f"frame from {found.rests_on}: {by}; it needs more to rest on, spread wider")
    unsure = ()
    if off_mm > UNSURE_MM:
        unsure = (f"frame from {found.rests_on}: {by}; more to rest on, spread wider, would help",)
    return replace(found, uncertainty_mm=float(off_mm), warnings=(*found.warnings, *unsure))
