"""How far each stage is from the truth, where the truth is known. Nothing here reaches teach or robot.

Errors of teaching are fractions of the picture's width in the held-out view (the paper's Table I).
"""

import time
from pathlib import Path

import numpy as np

from scene.camera import Camera

SAMPLES = 5
TIMES = np.linspace(0, 1, 100)


def camera_errors(views, truth: dict | None) -> dict:
    """Median distance [mm] and angle [deg] between estimated and true cameras."""
    if truth is None:
        return {}
    pairs = [(view.camera, Camera(**truth["cameras"][view.name])) for view in views]
    centres = [np.linalg.norm(a.centre - b.centre) for a, b in pairs]
    turns = [a.world_from_camera[:3, :3].T @ b.world_from_camera[:3, :3] for a, b in pairs]
    angles = [np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) for turn in turns]
    return {"camera_error_mm": 1000 * float(np.median(centres)), "camera_error_deg": float(np.median(angles))}


def field_errors(field, held_out, folder: Path, world_spec: dict | None) -> dict:
    """PSNR [dB] and SSIM on held-out views, seconds for one view, and, in a simulated world, the median depth error [mm].

    The rendered pictures are kept in ``folder`` for the report.
    """
    from scene.dataset import save_image
    from scene.field.volume import psnr, ssim

    folder.mkdir(exist_ok=True)
    started = time.perf_counter()
    rendered = [field.render(view.camera) for view in held_out]
    seconds = (time.perf_counter() - started) / max(len(held_out), 1)
    for view, (image, depth) in zip(held_out, rendered, strict=True):
        save_image(folder / f"{view.name}.png", image)
        np.save(folder / f"{view.name}_depth.npy", depth)
    errors = {
        "psnr": float(np.mean([psnr(image, view.image) for view, (image, _) in zip(held_out, rendered, strict=True)])),
        "ssim": float(np.mean([ssim(image, view.image) for view, (image, _) in zip(held_out, rendered, strict=True)])),
        "render_seconds": seconds,
    }
    if world_spec is not None:
        errors["depth_error_mm"] = _depth_error(held_out, [depth for _, depth in rendered], world_spec)
    return errors


def _depth_error(views, depths, world_spec: dict) -> float:
    """Median over pixels whose true point lies in the world's workspace; a pixel without depth counts as infinitely wrong."""
    from robot.world import World

    lower, upper = (np.array(world_spec["workspace"][side]) for side in ("lower", "upper"))
    errors = []
    with World.from_spec(world_spec) as world:
        for view, depth in zip(views, depths, strict=True):
            _, true = world.photograph_with_depth(view.camera)
            origins, directions = view.camera.rays(view.camera.pixel_centres())
            points = origins + directions * (true / (directions @ view.camera.forward))[..., None]
            inside = ((points > lower) & (points < upper)).all(-1)
            errors.append(np.nan_to_num(np.abs(depth - true)[inside], nan=np.inf))
    return 1000 * float(np.median(np.concatenate(errors)))


def taught_errors(skill, run: Path, *, seed: int) -> dict:
    """How far the learned motion is from what was meant, where that is known; nothing of what a person drew.

    error_mm: Frechet distance in space from its mean to the path that all demonstrations attempt. MFD and WD: in the held-out
    view, if there is one. The oracle knows the intended 3D paths behind the training strokes: their mean, and five of them as
    samples.
    """
    from teach import metrics
    from teach.curve import resample

    with np.load(run / "intended.npz", allow_pickle=False) as file:
        if "meant" not in file:
            return {}
        training, meant = file["training"].reshape(-1, *file["training"].shape[-2:]), file["meant"]
    mean, oracle = skill.distribution.mean_at(TIMES), training.mean(0)
    off = {f"{prefix}error_mm": 1000 * float(metrics.frechet(resample(path, len(meant)), meant)) for prefix, path in (("", mean), ("oracle_", oracle))}
    return off | _in_the_held_out_view(skill.distribution, training, run, np.random.default_rng([seed, 1]))


def _in_the_held_out_view(taught, intended, run: Path, rng) -> dict:
    """MFD and WD of what was taught, beside them the oracle's, who knows the paths (n, T, 3) [m], and the two baselines'."""
    from teach import baselines, metrics
    from teach import sketch as sketch_files

    held_out = sketch_files.load(run / "held_out.json")
    if not held_out:
        return {}
    (held_out,) = held_out
    strokes, camera = [stroke.points for stroke in held_out.strokes], held_out.camera
    line = baselines.linear(strokes)
    nearest = baselines.nearest_neighbour(sketch_files.load(run / "sketches.json"), camera)

    def scores(mean, samples, prefix=""):
        mfd, std = metrics.mfd(mean, strokes, camera.width)
        return {f"{prefix}mfd": mfd, f"{prefix}mfd_std": std, f"{prefix}wd": metrics.wd(samples, strokes, camera.width)}

    return (
        scores(camera.project(taught.mean_at(TIMES)), camera.project(taught.sample(SAMPLES, TIMES, rng)))
        | scores(camera.project(intended.mean(0)), camera.project(rng.permutation(intended)[:SAMPLES]), "oracle_")
        | scores(line, [line], "linear_")
        | scores(nearest.mean(0), nearest, "nearest_neighbour_")
    )
