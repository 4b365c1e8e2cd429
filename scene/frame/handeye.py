"""A camera on the arm's hand: where the arm's flange was at each photograph gives the robot's frame.

    arm_poses.json    {"base_from_flange": {"0000": 4 x 4 [m], ...}}, by name of the photograph

Where the camera sits on the flange is unknown, and so is the model's similarity: robot-world hand-eye calibration with
an unknown scale. A start in closed form is refined over all unknowns with a robust loss; poses that do not fit are
named.

Notation
    F_i = (Q_i, f_i)    base_from_flange at photograph i [m]
    C_i = (R_i, c_i)    model_from_camera
    X   = (R_X, x)      flange_from_camera [m], unknown; s, R, t the similarity from model to base
    Q_i R_X = R R_i                    rotation
    f_i + Q_i x = s R c_i + t          centre
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from scene.files import parse_json
from scene.frame.poses import agreeing, angles, check_rigid, left_out, matched, refuse_strangers
from scene.frame.similarity import Similarity, nearest_rotation, with_uncertainty
from scene.model import Model, ReconstructionFailed

FEWEST, COMFORTABLE = 4, 10
LEVER = 0.5
"""An error of rotation [rad] counts like one of place this many metres away: 1 mm weighs as much as 0.11 degrees."""
LEAST_TURN = np.radians(3)
"""The flange must turn by this much [rms] about two axes."""
TRIALS, SAMPLE = 300, 4


def align(model: Model, base_from_flange: Mapping[str, np.ndarray]) -> Similarity:
    """The similarity from the model's frame to the robot's base; ``extra`` holds flange_from_camera (4 x 4 [m])."""
    names = matched(model, base_from_flange, "arm poses", FEWEST)
    cameras = dict(zip(model.names, model.cameras, strict=True))
    model_from_camera = [cameras[n].world_from_camera for n in names]
    return fit_frame(names, model_from_camera, [base_from_flange[n] for n in names], model.cameras)


def fit_frame(names: Sequence[str], model_from_camera, base_from_flange, cameras) -> Similarity:
    """``align`` on matched poses (N, 4, 4) each; ``cameras`` are those whose uncertainty is told."""
    C, F = np.asarray(model_from_camera, dtype=float), np.asarray(base_from_flange, dtype=float)
    if len(C) < FEWEST:
        raise ReconstructionFailed(f"{len(C)} arm poses are too few: {FEWEST} are needed, better {COMFORTABLE}")
    _refuse_few_turns(F)
    rng = np.random.default_rng(0)
    samples = [np.arange(len(C)), *(rng.choice(len(C), SAMPLE, replace=False) for _ in range(TRIALS))]
    proposals = [p for p in (closed_form(C[k], F[k]) for k in samples) if p is not None]
    if not proposals:
        raise ReconstructionFailed("the arm's motions fix no scale: move the hand as well as turning it")
    start = min(proposals, key=lambda proposal: np.median(_distances(*proposal, C, F)))
    inside = agreeing(_distances(*start, C, F))
    for _ in range(5):
        start = closed_form(C[inside], F[inside]) or start
        distance = _distances(*start, C, F)
        inside = agreeing(distance)
    advice = "are they base_from_flange in metres (not its inverse), taken when the photographs of these names were?"
    refuse_strangers(distance, F[:, :3, 3], inside, "the arm's poses", advice)
    _refuse_few_turns(F[inside])
    found, X, J, noise = _refine(*start, C[inside], F[inside])
    distance = _distances(found, X, C, F)
    inside = agreeing(distance)
    gaps = np.linalg.norm(_gaps(found, X, C, F), axis=1)
    warnings = [*left_out(names, distance, inside, "arm's pose")]
    if inside.sum() < COMFORTABLE:
        warnings.append(f"only {inside.sum()} arm poses: with {COMFORTABLE} or more a wrong one would show")
    arm = 1000 * np.linalg.norm(X[:3, 3])
    found = replace(
        found, rests_on=f"{inside.sum()} poses of the arm, the camera {arm:.0f} mm from the flange",
        used=tuple(n for n, agrees in zip(names, inside) if agrees), warnings=tuple(warnings),
        residual_mm=1000 * float(np.sqrt((gaps[inside] ** 2).mean())),
        residuals_mm={n: 1000 * float(gap) for n, gap in zip(names, gaps)}, extra={"flange_from_camera": X.tolist()},
    )  # fmt: skip
    return with_uncertainty(found, J, noise, cameras, F[:, :3, 3].mean(axis=0))


def closed_form(C: np.ndarray, F: np.ndarray) -> tuple[Similarity, np.ndarray] | None:
    """(similarity, flange_from_camera) from poses (N, 4, 4): rotations first, then places and scale linearly.

    Relative motions turn alike about axes that R_X maps: log(Q_i^T Q_j) = R_X log(R_i^T R_j) (Park & Martin 1994).
    None if the motions leave something open.
    """
    i, j = np.triu_indices(len(C), k=1)
    Q, R_camera, f, c = F[:, :3, :3], C[:, :3, :3], F[:, :3, 3], C[:, :3, 3]
    turned, seen = (_logarithms(M[i].transpose(0, 2, 1) @ M[j]) for M in (Q, R_camera))
    near = np.linalg.norm(seen, axis=1) < np.radians(170)  # beyond, noise may turn the axis round
    M = turned[near].T @ seen[near]
    if np.linalg.matrix_rank(M, 1e-4 * max(np.linalg.norm(M), 1e-9)) < 2:
        return None
    R_X = nearest_rotation(M)
    R = nearest_rotation((Q @ R_X @ R_camera.transpose(0, 2, 1)).sum(axis=0))
    spread = np.linalg.norm(c - c.mean(axis=0)) / np.sqrt(len(c)) or 1.0
    around = (c - c.mean(axis=0)) @ R.T / spread
    A = np.concatenate([Q, -around[:, :, None], -np.tile(np.eye(3), (len(c), 1, 1))], axis=2)  # of x, s spread, t
    solution, _, _, s = np.linalg.lstsq(A.reshape(-1, 7), -f.ravel(), rcond=None)
    scale = solution[3] / spread
    if s[-1] < 1e-3 * s[0] or scale <= 1e-9:
        return None
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R_X, solution[:3]
    return Similarity(float(scale), R, solution[4:] - scale * R @ c.mean(axis=0)), X


def _logarithms(turns: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(turns).as_rotvec()


def _refuse_few_turns(F: np.ndarray):
    """Turning about one axis leaves the camera's place along it open; not turning, all of it."""
    Q = F[:, :3, :3]
    turns = _logarithms(nearest_rotation(Q.sum(axis=0)).T @ Q)
    spread = np.linalg.svd(turns, compute_uv=False) / np.sqrt(len(turns))
    if spread[1] < LEAST_TURN:
        about = "hardly turned" if spread[0] < LEAST_TURN else "turned about one axis only"
        raise ReconstructionFailed(
            f"the hand {about} between the photographs (by {np.degrees(spread[0]):.1f} and {np.degrees(spread[1]):.1f} "
            "degrees about two axes), which leaves open where the camera sits on it: tilt it about two axes, by 20 "
            "degrees or more"
        )


def _gaps(similarity: Similarity, X: np.ndarray, C: np.ndarray, F: np.ndarray) -> np.ndarray:
    """(N, 3) [m] from where the arm puts the cameras' centres to where the photographs do."""
    return similarity.apply(C[:, :3, 3]) - (F @ X)[:, :3, 3]


def _turns(similarity: Similarity, X: np.ndarray, C: np.ndarray, F: np.ndarray) -> np.ndarray:
    """(N, 3, 3) rotations from the arm's cameras to the photographs'; identities if all is exact."""
    return (similarity.rotation @ C[:, :3, :3]) @ (F[:, :3, :3] @ X[:3, :3]).transpose(0, 2, 1)


def _distances(similarity, X, C, F) -> np.ndarray:
    """(N,) [m] how badly each pose fits, place and rotation together."""
    return np.hypot(np.linalg.norm(_gaps(similarity, X, C, F), axis=1), LEVER * angles(_turns(similarity, X, C, F)))


def _refine(similarity: Similarity, X: np.ndarray, C: np.ndarray, F: np.ndarray):
    """Robust least squares over similarity and X: (similarity, X, Jacobian of the residuals [m], their noise [m])."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    middle = F[:, :3, 3].mean(axis=0)

    def moved(p):
        changed = X.copy()
        changed[:3, :3], changed[:3, 3] = X[:3, :3] @ Rotation.from_rotvec(p[7:10]).as_matrix(), X[:3, 3] + p[10:]
        return similarity.nudged(p, middle), changed

    def errors(p):
        both = moved(p)
        turned = LEVER * _logarithms(_turns(*both, C, F))
        return np.concatenate([_gaps(*both, C, F), turned]).ravel()

    first = errors(np.zeros(13))
    width = max(2 * 1.4826 * float(np.median(np.abs(first))), 1e-5)
    best = least_squares(errors, np.zeros(13), loss="soft_l1", f_scale=width, x_scale="jac")
    noise = max(float(np.sqrt((errors(best.x) ** 2).sum() / (6 * len(C) - 13))), 1e-4)
    return *moved(best.x), best.jac, noise


def load(path: str | Path) -> dict[str, np.ndarray]:
    """{name without extension: base_from_flange (4, 4) [m]} of arm_poses.json."""
    return parse_json(path, "file of arm poses", _parsed)


def _parsed(content) -> dict[str, np.ndarray]:
    poses = {Path(name).stem: np.array(pose, dtype=float) for name, pose in content["base_from_flange"].items()}
    for name, pose in poses.items():
        check_rigid(pose, name)
    return poses
