"""Camera poses that are known already (a tracked camera, a calibrated rig, an earlier reconstruction) give the frame.

    poses.json             nerfstudio's transforms.json, in metres and in the robot's frame, under another name
    poses/                 a folder with transforms.json, or with a COLMAP model (images.txt or images.bin)

Photographs are matched by name, without folder and extension. Not all of them need a pose.

Notation
    c_i, R_i     centre and rotation of camera i in the model, a_i, Q_i in the robot's base [m]
    a_i = s R c_i + t,   Q_i = R R_i
"""

import itertools
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from scene.camera import OPENCV_FROM_OPENGL, invert
from scene.frame.similarity import Similarity, jacobian, nearest_rotation, umeyama, with_uncertainty
from scene.model import Model, ReconstructionFailed

FEWEST = 3
STRAY_M = 2e-3
"""A pose that lies no further than this from where the others put it is never left out."""
ON_A_LINE = 0.03
"""Centres whose second extent is less than this part of their first lie on a line: rotations must help out."""
TRIALS = 300


def align(model: Model, base_from_camera: Mapping[str, np.ndarray]) -> Similarity:
    """The similarity from the model's frame to that of known poses, {name of the photograph: (4, 4) [m]}."""
    names = matched(model, base_from_camera, "poses")
    cameras = dict(zip(model.names, model.cameras, strict=True))
    model_poses = [cameras[n].world_from_camera for n in names]
    return fit_frame(names, model_poses, [base_from_camera[n] for n in names], model.cameras)


def matched(model: Model, poses: Mapping[str, np.ndarray], what: str, fewest: int = FEWEST) -> list[str]:
    """The names of the model's photographs that have a pose."""
    names = [name for name in model.names if name in poses]
    if len(names) < fewest:
        raise ReconstructionFailed(
            f"{what} name {len(names)} of the {len(model.names)} photographs of the model, and {fewest} are needed: "
            f"photographs are {_few(model.names)}, {what} are of {_few(list(poses))}"
        )
    return names


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "") if names else "none"


def fit_frame(names: Sequence[str], model_poses, base_poses, cameras) -> Similarity:
    """``align`` on matched poses (N, 4, 4) each. Centres on a line need the rotations, else centres alone decide.

    The proposal with the least median distance of all centres is chosen (Rousseeuw 1984), and all that agree with it
    are fitted. ``cameras``: those whose uncertainty is told.
    """
    model_poses, base_poses = np.asarray(model_poses, dtype=float), np.asarray(base_poses, dtype=float)
    c, a = model_poses[:, :3, 3], base_poses[:, :3, 3]
    if _extents(c)[0] < 1e-9 or _extents(a)[0] < 1e-6:
        raise ReconstructionFailed(f"{len(c)} known poses stand in one place, which gives no scale: move the camera")
    proposals = [_fit(model_poses[chosen], base_poses[chosen]) for chosen in _subsets(len(c))]
    distances = [np.linalg.norm(p.apply(c) - a, axis=1) for p in proposals if p is not None]
    if not distances:
        raise ReconstructionFailed("known poses: no three of them give a frame; are the same photographs meant?")
    inside = agreeing(min(distances, key=np.median))
    for _ in range(5):
        found = _fit(model_poses[inside], base_poses[inside])
        distance = np.linalg.norm(found.apply(c) - a, axis=1)
        inside = agreeing(distance)
    advice = "are they base_from_camera in metres, of these photographs?"
    refuse_strangers(distance, a, inside, "the known poses", advice)
    turns = base_poses[inside, :3, :3].transpose(0, 2, 1) @ found.rotation @ model_poses[inside, :3, :3]
    turns = np.degrees(angles(turns))
    warnings = list(left_out(names, distance, inside, "pose"))
    if np.median(turns) > 2:
        warnings.append(f"the known poses' rotations differ by {np.median(turns):.0f} degrees from the photographs'")
        if on_a_line(c[inside]):
            raise ReconstructionFailed(f"known poses on one line need right rotations: {warnings[-1]}")
    found = replace(
        found, rests_on=f"{inside.sum()} known camera poses", warnings=tuple(warnings),
        used=tuple(n for n, agrees in zip(names, inside) if agrees), residual_mm=1000 * _rms(distance[inside]),
        residuals_mm={n: 1000 * float(d) for n, d in zip(names, distance)},
    )  # fmt: skip
    middle = a[inside].mean(axis=0)
    J = jacobian(found.apply(c[inside]), middle).reshape(-1, 7)
    if on_a_line(c[inside]):  # a rotation counts like a marker at the arm's length of the whole arrangement
        turned = np.zeros((3, 7))
        turned[:, :3] = _extents(a[inside])[0] * np.sqrt(inside.sum()) * np.eye(3)
        J = np.concatenate([J, turned])
    return with_uncertainty(found, J, max(_rms(distance[inside]) / np.sqrt(3), 1e-4), cameras, middle)


def _subsets(n: int) -> list[list[int]]:
    """Every three of n, or many of them; two or three far apart in the list more often than neighbours."""
    if n <= 12:
        return [list(chosen) for chosen in itertools.combinations(range(n), 3)]
    rng = np.random.default_rng(0)
    return [rng.choice(n, 3, replace=False).tolist() for _ in range(TRIALS)]


def _fit(model_poses: np.ndarray, base_poses: np.ndarray) -> Similarity | None:
    """The least-squares similarity; None if it is undetermined."""
    c, a = model_poses[:, :3, 3], base_poses[:, :3, 3]
    if not on_a_line(c):
        return umeyama(c, a)
    R = nearest_rotation((base_poses[:, :3, :3] @ model_poses[:, :3, :3].transpose(0, 2, 1)).sum(axis=0))
    x, y = (c - c.mean(axis=0)) @ R.T, a - a.mean(axis=0)
    scale = (x * y).sum() / max((x * x).sum(), 1e-30)
    return Similarity(float(scale), R, a.mean(axis=0) - scale * R @ c.mean(axis=0)) if scale > 1e-9 else None


def _extents(points: np.ndarray) -> np.ndarray:
    """Standard deviations (3,) along the principal axes."""
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return np.pad(s, (0, 3 - len(s)))


def on_a_line(points: np.ndarray) -> bool:
    """Whether points (N, 3) lie so nearly on one line that they fix no turn about it."""
    first, second, _ = _extents(points)
    return len(points) < 3 or second < ON_A_LINE * first or first < 1e-12


def agreeing(distance: np.ndarray) -> np.ndarray:
    """Which of (N,) distances [m] from a fit are no outliers: within 4 robust standard deviations."""
    spread = 1.4826 * np.median(distance)
    return distance <= max(4 * spread, STRAY_M)


def refuse_strangers(distance: np.ndarray, places: np.ndarray, inside: np.ndarray, what: str, advice: str):
    """Refuse poses that hardly fit at all: the median distance beyond a twentieth of their extent."""
    extent = np.linalg.norm(_extents(places))
    if np.median(distance) > max(extent / 20, STRAY_M) or 2 * inside.sum() <= len(inside):
        raise ReconstructionFailed(
            f"{what} do not fit the photographs: half of {len(distance)} are further than "
            f"{1000 * np.median(distance):.0f} mm from where the others put them; {advice}"
        )


def left_out(names: Sequence[str], distance: np.ndarray, inside: np.ndarray, what: str) -> tuple[str, ...]:
    """The warning that names what does not fit, if anything."""
    wrong = [f"{n} ({1000 * d:.0f} mm)" for n, d, agrees in zip(names, distance, inside) if not agrees]
    return (f"left out, as the {what} does not fit the others: {', '.join(wrong)}",) if wrong else ()


def angles(turns: np.ndarray) -> np.ndarray:
    """Angles [rad] of rotations (N, 3, 3), exact for small ones too."""
    axis = turns[:, [2, 0, 1], [1, 2, 0]] - turns[:, [1, 2, 0], [2, 0, 1]]
    return np.arctan2(np.linalg.norm(axis, axis=1), np.trace(turns, axis1=1, axis2=2) - 1)


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def load(path: str | Path) -> dict[str, np.ndarray]:
    """{name: base_from_camera (4, 4)} with OpenCV's axes, from poses.json, transforms.json or a folder, see above."""
    path = Path(path)
    if path.is_dir():
        names = "transforms.json", "poses.json", "images.txt", "images.bin"
        there = [path / name for name in names if (path / name).exists()]
        if not there:
            raise FileNotFoundError(f"no transforms.json, images.txt or images.bin in {path}")
        path = there[0]
    if not path.is_file():
        raise FileNotFoundError(f"no such file of poses: {path}")
    readers = {".json": _read_transforms, ".txt": _read_images_txt, ".bin": _read_images_bin}
    if path.suffix not in readers:
        raise ValueError(f"{path}: poses are a .json file of nerfstudio, or images.txt or images.bin of COLMAP")
    try:
        poses = readers[path.suffix](path)
        for name, pose in poses.items():
            check_rigid(pose, name)
    except (KeyError, TypeError, AttributeError, IndexError, struct.error, ValueError) as error:
        raise ValueError(f"{path}: {f'missing {error.args[0]}' if isinstance(error, KeyError) else error}") from error
    if not poses:
        raise ValueError(f"{path}: no pose of any photograph")
    return poses


def check_rigid(pose: np.ndarray, name: str):
    """ValueError unless pose is a rigid transform (4, 4)."""
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.allclose(pose[3], [0, 0, 0, 1]):
        raise ValueError(f"{name}: the pose must be a (4, 4) matrix with 0 0 0 1 as its last row")
    R = pose[:3, :3]
    if not np.allclose(R.T @ R, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
        raise ValueError(f"{name}: the pose's rotation is not orthonormal and right-handed")


def _read_transforms(path: Path) -> dict[str, np.ndarray]:
    content = json.loads(path.read_text(encoding="utf-8"))
    said = (content.get("scene2skill") or {}).get("frame", {})
    if said.get("unit", "m") != "m":
        raise ValueError("its frame is arbitrary, so it says nothing of metres")
    poses = {Path(frame["file_path"]).stem: frame["transform_matrix"] for frame in content["frames"]}
    return {name: np.array(pose, dtype=float) @ OPENCV_FROM_OPENGL for name, pose in poses.items()}


def _read_images_txt(path: Path) -> dict[str, np.ndarray]:
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = [line.split(maxsplit=9) for line in lines[::2] if line.strip()]  # each second line holds the pixels
    return {Path(row[9]).stem: _from_colmap([float(x) for x in row[1:8]]) for row in rows}


def _read_images_bin(path: Path) -> dict[str, np.ndarray]:
    data, poses = path.read_bytes(), {}
    (count,) = struct.unpack_from("<Q", data, 0)
    at = 8
    for _ in range(count):
        row = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        name = data[at + 64 : end].decode()
        (pixels,) = struct.unpack_from("<Q", data, end + 1)
        poses[Path(name).stem], at = _from_colmap(row[1:8]), end + 9 + 24 * pixels
    return poses


def _from_colmap(row: Sequence[float]) -> np.ndarray:
    """COLMAP's quaternion (w first) and translation of world to camera -> world_from_camera."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(row[:4], scalar_first=True).as_matrix()
    pose[:3, 3] = row[4:]
    return invert(pose)
