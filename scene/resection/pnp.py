"""Cameras from the corners of tags at known places, and how well they are known.

Notation
    X_k              corners of the tags that a photograph shows, in the robot's base [m]; p_k where it shows them [px]
    R, o             rotation and centre of its camera; f the focal length [px], the same for all photographs
    minimised        sum_k rho(|project(X_k) - p_k|^2)   over all photographs' R, o, and f unless it is given;
                     plus ((log f - log f_exif) / 0.1)^2 where the photographs' EXIF tells a focal length

A plane seen almost head-on, or small, is explained by two poses (Oberkampf, DeMenthon, Davis 1996); where both fit
alike, the photograph is refused. How far cameras may be off follows from the derivative of the residuals, as
scene.frame has it. """

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from scene.camera import invert
from scene.frame.apriltag import LEAST_NOISE_PX, TagLayout
from scene.frame.similarity import USELESS_MM
from scene.model import ReconstructionFailed

EXIF_SPREAD = 0.1
"""What an EXIF's focal length is worth: the standard deviation of its logarithm."""
LOOSE = 0.1
"""A focal length that the tags leave more open than this share is refused; a quarter of it is said."""
SAID_MM = 10.0
"""A camera that may be off by more than this is said to be; by more than scene.frame.similarity.USELESS_MM, it is left out."""
BAD_PX = 1.0
"""Corners that fit worse than this speak of a wrong layout or lens."""
TWOFOLD = 1.5
"""Two poses whose residuals differ by less than this factor are not told apart."""


@dataclass(frozen=True, eq=False)
class _Photograph:
    """What is seen of the tags that agree: places (N, 3) [m], pixels (N, 2), and the camera's pose so far."""

    name: str
    tags: tuple[int, ...]
    places: np.ndarray
    pixels: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True, eq=False)
class Solved:
    """Cameras {photograph: world_from_camera (4, 4)}, and how well they are known.

    focal [px] and focal_from, what it rests on. residuals_mm: {photograph: rms distance at the tags}; residual_px: rms
    over all corners; uncertainties_mm: {photograph: by how much its camera may be off}. tags: that agree. """

    poses: Mapping[str, np.ndarray]
    focal: float
    focal_from: str
    tags: tuple[int, ...]
    residual_px: float
    residuals_mm: Mapping[str, float]
    uncertainties_mm: Mapping[str, float]
    warnings: tuple[str, ...] = ()

    def describe(self, layout: TagLayout) -> dict:
        """The frame as transforms.json keeps it (scene.dataset.save_views)."""
        many = "s" if len(self.tags) > 1 else ""
        numbered = f"tag{many} {', '.join(map(str, self.tags))} of {1000 * layout.size:.0f} mm"
        alone = f"{numbered} in {len(self.poses)} photographs alone"
        residuals = list(self.residuals_mm.values())
        return {
            "name": "robot base", "unit": "m", "used": list(self.tags), "warnings": list(self.warnings),
            "rests_on": f"{alone}; focal length {self.focal:.0f} px {self.focal_from}",
            "residual_px": self.residual_px, "residual_mm": float(np.sqrt(np.mean(np.square(residuals)))),
            "uncertainty_mm": max(self.uncertainties_mm.values()), "residuals_mm": dict(self.residuals_mm),
            "uncertainties_mm": dict(self.uncertainties_mm),
        }  # fmt: skip


def solve(found, layout: TagLayout, size, K=None, prior: float | None = None) -> Solved:
    """found: {photograph: {tag: corners (4, 2) px of a pinhole}}; K (3, 3) if it is known, else prior: EXIF's focal
    length [px]."""
    corners = layout.corners()
    wrong = _contradicting(found, corners, size, K, prior)
    kept = {name: {n: c for n, c in tags.items() if n not in wrong} for name, tags in found.items()}
    kept = {name: tags for name, tags in kept.items() if tags}
    if len(kept) < 2:
        without = ", ".join(map(str, wrong))
        raise ReconstructionFailed(
            f"without the tags that contradict others ({without}) only {len(kept)} photographs are left; measure their "
            "places again"
        )
    start = K if K is not None else _pinhole(prior or _likely_focal(kept, corners, size), size)
    photographs = [_placed(name, tags, corners, start) for name, tags in kept.items()]
    photographs, K, J, errors = _refine(photographs, start, free=K is None, prior=prior)
    noise = max(float(np.sqrt((errors**2).mean())), LEAST_NOISE_PX)
    deviations = noise * np.sqrt(np.diag(np.linalg.pinv(J.T @ J)))
    off = {p.name: 1000 * float(np.linalg.norm(deviations[6 * i + 3 : 6 * i + 6])) for i, p in enumerate(photographs)}
    open_ones = {p.name: why for p in photographs if (why := _refusal(p, off[p.name], K, noise))}
    if open_ones:
        if len(photographs) - len(open_ones) < 2:
            raise ReconstructionFailed("; ".join(open_ones.values()))
        fewer = {name: tags for name, tags in kept.items() if name not in open_ones}
        solved = solve(fewer, layout, size, K if J.shape[1] % 6 == 0 else None, prior)
        return replace(solved, warnings=(*solved.warnings, *(f"left out: {why}" for why in open_ones.values())))
    focal_from, warnings = _judged_focal(deviations[-1] if J.shape[1] % 6 else None, prior)
    if wrong:
        warnings += (f"left out, as they do not lie where the layout says: tag {', '.join(map(str, wrong))}",)
    unsure = [p for p in photographs if off[p.name] > SAID_MM]
    warnings += tuple(f"{_shows(p)}: its camera may be off by {off[p.name]:.0f} mm" for p in unsure)
    return Solved(
        {p.name: p.pose for p in photographs}, float(K[0, 0]), focal_from, tuple(sorted(set().union(*kept.values()))),
        float(np.sqrt(2 * (errors**2).mean())), {p.name: _residual_mm(p, K) for p in photographs}, off, warnings,
    )  # fmt: skip


def _contradicting(found, corners, size, K, prior) -> list[int]:
    """Tags that lie elsewhere than the layout says, seen from most photographs that show them beside others."""
    K = K if K is not None else _pinhole(prior or _likely_focal(found, corners, size), size)
    against, together = {}, {}
    for tags in (tags for tags in found.values() if len(tags) > 1):
        agree = _agreeing(tags, corners, K)
        for n in tags:
            together[n] = together.get(n, 0) + 1
            against[n] = against.get(n, 0) + (n not in agree)
    wrong = sorted(n for n in together if 2 * against[n] > together[n])
    if together and 2 * len(wrong) >= len(together):
        raise ReconstructionFailed(
            f"the tags do not lie as the layout says: of {len(together)} tags ({', '.join(map(str, sorted(together)))}) "
            f"{len(together) - len(wrong)} agree; measure their places and their size (black square) again, or give "
            "scene.resection.camera"
        )
    return wrong


def _agreeing(tags, corners, K) -> set[int]:
    """The largest set of a photograph's tags that one pose explains to a tenth of their edge, or 3 px."""
    numbers = list(tags)
    width = {n: np.linalg.norm(tags[n] - np.roll(tags[n], 1, axis=0), axis=1).mean() for n in numbers}
    tolerance = np.array([max(3.0, width[n] / 10) for n in numbers])
    chosen = [[a, b] for i, a in enumerate(numbers) for b in numbers[:i]] + [[a] for a in numbers] + [numbers]
    best, least = set(), np.inf
    for some in chosen:
        for pose, _ in _poses(np.concatenate([corners[n] for n in some]), np.concatenate([tags[n] for n in some]), K):
            off = np.array([_rms(_projected(K, pose, corners[n]) - tags[n]) for n in numbers]) / tolerance
            cost = np.minimum(np.nan_to_num(off, nan=np.inf), 1).sum()
            if cost < least:
                best, least = {n for n, o in zip(numbers, off) if o < 1}, cost
    return best if len(best) > 1 else set()


def _poses(places, pixels, K) -> list[tuple[np.ndarray, float]]:
    """Poses world_from_camera (4, 4) that explain the pixels, refined, with their rms [px], best first; two of a
    plane."""
    import cv2

    flat = np.linalg.svd(places - places.mean(0), compute_uv=False)[2] < 1e-3 * np.ptp(places, axis=0).max()
    method = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_SQPNP
    points, seen = np.ascontiguousarray(places), np.ascontiguousarray(pixels)
    _, turns, shifts, _ = cv2.solvePnPGeneric(points, seen, K, None, flags=method)
    found = []
    for turn, shift in zip(turns, shifts):
        turn, shift = cv2.solvePnPRefineLM(points, seen, K, None, turn, shift)
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3], camera_from_world[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
        pose = invert(camera_from_world)
        found.append((pose, _rms(_projected(K, pose, places) - pixels)))
    return sorted((p for p in found if np.isfinite(p[1])), key=lambda p: p[1])


def _placed(name, tags, corners, K) -> _Photograph:
    places, pixels = np.concatenate([corners[n] for n in tags]), np.concatenate(list(tags.values()))
    poses = _poses(places, pixels, K)
    if not poses:
        shown = ", ".join(map(str, tags))
        raise ReconstructionFailed(f"photograph {name}: no pose explains tag {shown}; photograph it again")
    return _Photograph(name, tuple(tags), places, pixels, poses[0][0])


def _likely_focal(found, corners, size) -> float:
    """The focal length [px] of a coarse scale that explains all photographs best."""
    scale = max(size) * np.geomspace(0.5, 4, 25)

    def cost(focal):
        K = _pinhole(focal, size)
        places = [np.concatenate([corners[n] for n in tags]) for tags in found.values()]
        poses = [_poses(X, np.concatenate(list(tags.values())), K) for X, tags in zip(places, found.values())]
        return sum(min(p[0][1], 20.0) if p else 20.0 for p in poses)

    return float(min(scale, key=cost))


def _refine(photographs, K, free: bool, prior: float | None):
    """All poses, and the focal length if it is free, by robust least squares; (photographs, K, derivative, residuals
    [px])."""
    from scipy.optimize import least_squares
    from scipy.sparse import lil_matrix
    from scipy.spatial.transform import Rotation

    rows = np.cumsum([0, *(2 * len(p.pixels) for p in photographs)])
    told = free and prior is not None

    def moved(x):
        poses = []
        for i, photograph in enumerate(photographs):
            pose = photograph.pose.copy()
            pose[:3, :3] = Rotation.from_rotvec(x[6 * i : 6 * i + 3]).as_matrix() @ pose[:3, :3]
            pose[:3, 3] += x[6 * i + 3 : 6 * i + 6]
            poses.append(pose)
        zoom = np.exp(x[-1]) if free else 1.0
        return poses, K * [[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]]

    def errors(x):
        poses, lens = moved(x)
        off = [(_projected(lens, pose, p.places) - p.pixels).ravel() for pose, p in zip(poses, photographs)]
        return np.concatenate([*off, [LEAST_NOISE_PX * x[-1] / EXIF_SPREAD]] if told else off)

    sparsity = lil_matrix((rows[-1] + told, 6 * len(photographs) + free), dtype=int)
    for i in range(len(photographs)):
        sparsity[rows[i] : rows[i + 1], 6 * i : 6 * i + 6] = 1
    if free:
        sparsity[:, -1] = 1
    start = np.zeros(6 * len(photographs) + free)
    best = least_squares(errors, start, loss="soft_l1", f_scale=0.5, x_scale="jac", jac_sparsity=sparsity)
    poses, lens = moved(best.x)
    refined = [replace(p, pose=pose) for p, pose in zip(photographs, poses)]
    return refined, lens, best.jac.toarray(), errors(best.x)[: rows[-1]]


def _judged_focal(deviation: float | None, prior: float | None) -> tuple[str, tuple[str, ...]]:
    """What the focal length rests on, and warnings; deviation: of its logarithm, None where it was given."""
    if deviation is None:
        return "as the camera file says", ()
    source = "from the tags" if prior is None else f"from the tags and EXIF ({prior:.0f} px)"
    advice = "photograph more tags, larger and at a slant, or give scene.resection.camera"
    if deviation > LOOSE:
        raise ReconstructionFailed(f"the focal length {source} stays open ({100 * deviation:.0f} %): {advice}")
    known = f"known to {100 * deviation:.1f} %"
    return f"{source}, {known}", (f"the focal length {source} is {known} only: {advice}",) * bool(deviation > LOOSE / 4)


def _shows(photograph: _Photograph) -> str:
    squares = photograph.pixels.reshape(-1, 4, 2)
    edge = np.linalg.norm(squares - np.roll(squares, 1, axis=1), axis=-1).max()
    many = "s" if len(photograph.tags) > 1 else ""
    tags = ", ".join(map(str, photograph.tags))
    return f"photograph {photograph.name} shows tag{many} {tags}, at most {edge:.0f} px wide"


def _refusal(photograph: _Photograph, off_mm: float, K, noise: float) -> str:
    """Why a photograph's camera is not known, empty where it is: too uncertain, or two poses explain it alike."""
    if not off_mm <= USELESS_MM:
        by = f"may be off by {off_mm:.0f} mm" if off_mm < 1e4 else "stays open"
        advice = "go nearer, show more tags, spread wider, or give scene.resection.camera"
        if noise > BAD_PX:
            advice += f"; corners miss their places by {noise:.1f} px, are these and the size right?"
        return f"{_shows(photograph)}: its camera {by}; {advice}"
    poses = _poses(photograph.places, photograph.pixels, K)
    if len(poses) < 2 or poses[1][1] > TWOFOLD * max(poses[0][1], noise):
        return ""
    apart = 1000 * np.linalg.norm(poses[0][0][:3, 3] - poses[1][0][:3, 3])
    places = f"two places of the camera, {apart:.0f} mm apart, explain it alike"
    return f"{_shows(photograph)}: {places}; go nearer, look at a slant, or show more tags" if apart > SAID_MM else ""


def _residual_mm(photograph: _Photograph, K) -> float:
    """Rms distance of the corners from the rays of their pixels, across the view."""
    off = np.linalg.norm(_projected(K, photograph.pose, photograph.places) - photograph.pixels, axis=1)
    depth = (photograph.places - photograph.pose[:3, 3]) @ photograph.pose[:3, 2]
    return 1000 * _rms(off * depth / K[0, 0])


def _projected(K, pose, points) -> np.ndarray:
    seen = (points - pose[:3, 3]) @ pose[:3, :3] @ K.T
    return seen[:, :2] / np.where(seen[:, 2:] > 1e-9, seen[:, 2:], 1e-9)


def _rms(x) -> float:
    """Of vectors (N, 2) or numbers (N,): the root of the mean squared length."""
    return float(np.sqrt(np.mean(np.square(x)) * (2 if np.ndim(x) == 2 else 1)))


def _pinhole(focal: float, size) -> np.ndarray:
    return np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
