"""Posed photographs -> field.

    field = fit(views, points=points, seed=0)

Coarse to fine: while training goes on, levels join the pyramid (`scene.grid`), the pictures get larger and the space
that rays pass through shrinks to what is occupied. Rays come in small patches of pixels, whose neighbours
read the same voxels while these are in the cache. The points of the reconstruction say where surfaces are to be expected.
"""

import hashlib
import os
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from scene import kernels, occupancy
from scene.descent import KernelDescent, Rates
from scene.field import Field, Shading
from scene.grid import Grid
from scene.photographs import Photographs
from scene.volume import psnr

SCALE = 50.0
STEPS = 1200
"""Default number of steps: 60 to 75 s on two cores for 42 photographs of 640x480."""


@dataclass(frozen=True)
class Stage:
    """What training works on from the fraction ``begin`` of its steps (or seconds) on.

    levels: the pyramid's, cells an axis; cells: of the occupancy grid, an axis; spacing: of samples, in voxels of the
    finest level; shrink: how many times smaller the pictures are; prune: after so many steps, and again; batch: rays a step;
    visible: cells stay occupied if some sample in or beside them had this weight since the last pruning.
    """

    begin: float
    levels: tuple[int, ...]
    cells: int
    spacing: float
    shrink: int
    prune: int
    batch: int
    visible: float


STAGES = (
    Stage(0.0, (96,), 64, 0.8, 4, 300, 1024, 0.02),
    Stage(0.08, (96, 256), 128, 0.9, 2, 200, 2048, 0.03),
    Stage(0.25, (96, 256, 768), 256, 1.0, 1, 200, 4096, 0.05),
)


@dataclass
class Training:
    """A training under way: all that a checkpoint holds."""

    field: Field
    descent: KernelDescent
    occupied: np.ndarray  # (n, n, n) bool
    seen: np.ndarray  # (n^3,) largest weight a sample of each cell has had since the last pruning
    stage: int = -1
    step: int = 0
    pruned: int = 0  # the step of the last pruning
    seconds: float = 0.0
    empty: np.ndarray | bool = False  # (n, n, n) cells known to be empty


def fit(
    views,
    *,
    points=None,
    colours=None,
    seed: int = 0,
    steps: int | None = None,
    seconds: float | None = None,
    callback=None,
    checkpoint=None,
    device: str = "auto",
    progress: bool = True,
    bounds=None,
    deterministic: bool = False,
    stages=STAGES,
    patch: int = 2,
    rates: tuple[float, float, float, float] = (0.3, 0.02, 0.01, 0.003),
    decay: float = 0.1,
    huber: float = 0.1,
    thin: float = 0.1,
    prior: float = 5.0,
    hidden: int = 32,
) -> Field:
    """Train a field on posed photographs.

    views: the training pictures (holding some out is the caller's). points (N, 3), colours (N, 3) uint8: the
    reconstruction's, if there is one [m]. steps: how many (default STEPS, or as many as fit in ``seconds``); seconds: a cap,
    after which training ends even so, with its schedule spread over that time. callback(field, step, seconds)
    after each step gets the field in training. checkpoint: a file, written now and then, from which a killed
    training goes on; removed at the end. bounds: (2, 3) corners of the box of interest [m], else from points or cameras.
    deterministic: one thread, bit-equal results. device: "cpu", "cuda", or "auto".

    patch: rays come from patches of patch x patch pixels. rates: of density, colour, features, network, falling to
    ``decay`` of it. huber: the error [0..1] beyond which the loss grows only linearly. hidden: width of the network.
    """
    _check(views)
    run = _resume(checkpoint, views, seed, stages) or _start(views, points, bounds, seed, hidden, deterministic, device, thin)
    limit = steps if steps is not None else STEPS if seconds is None else None
    clock, saved = time.perf_counter() - run.seconds, time.perf_counter()
    pictures, error = None, None
    bar = tqdm(total=limit, initial=run.step, desc="train", disable=not progress, leave=False)
    while True:
        run.seconds = time.perf_counter() - clock
        done = max(run.step / limit if limit else 0.0, run.seconds / seconds if seconds else 0.0)
        if done >= 1:
            break
        if _advance(run, stages, done, points, prior, views) or pictures is None:
            stage = stages[run.stage]
            pictures = Photographs.of(views, run.field.centre, run.field.half, run.field.near, stage.shrink)
        rng = np.random.default_rng((seed, run.step))
        rays, target = pictures.draw(rng, stages[run.stage].batch, patch)
        jitter = rng.random(len(target), np.float32)
        now = Rates(*(rate * decay**done for rate in rates))
        mse = run.descent.step(rays, target, jitter, now, huber, run.seen, stages[run.stage].visible)
        error = mse if error is None else 0.95 * error + 0.05 * mse
        run.step += 1
        bar.update(1)
        if run.step % 20 == 0:
            bar.set_postfix(psnr=f"{-10 * np.log10(error):.2f} dB", loss=f"{error:.5f}", refresh=False)
        if callback is not None:
            callback(run.field, run.step, run.seconds)
        if checkpoint is not None and time.perf_counter() - saved > 30:
            _save(run, checkpoint, views, seed, stages)
            saved = time.perf_counter()
    bar.close()
    if checkpoint is not None:
        Path(checkpoint).unlink(missing_ok=True)
    return run.field


def _check(views) -> None:
    if len(views) < 2:
        raise ValueError(f"a field needs at least two photographs, {len(views)} given")


def _start(views, points, bounds, seed, hidden, deterministic, device, thin) -> Training:
    if device not in ("auto", "cpu"):
        raise ValueError(f"device {device!r} is not there; use 'cpu' or 'auto'")
    centre, half = occupancy.box_of_interest(views, points, bounds)
    scale = SCALE
    occupied = occupancy.seen(views, centre, half, 64)
    field = Field(
        centre, half, Grid.empty(), Shading.initial(np.random.default_rng(seed), hidden), occupancy.distances(occupied),
        step=1.0, scale=scale, shift=float(np.log(np.expm1(thin / scale))), near=0.05,
    )  # fmt: skip
    descent = KernelDescent(field, 1 if deterministic else kernels.THREADS)
    return Training(field, descent, occupied, np.zeros(1, np.uint8))


def _advance(run: Training, stages, done: float, points, prior, views) -> bool:
    """Prune, and go to the next stage, when it is time. True if a stage begins."""
    due = run.step - run.pruned >= stages[run.stage].prune or run.stage < 0
    begins = due and run.stage + 1 < len(stages) and done >= stages[run.stage + 1].begin
    if not (due or begins):
        return False
    if run.stage >= 0:
        n = len(run.occupied)
        run.occupied = (run.seen > 0).reshape(n, n, n)
        if points is not None:
            run.occupied |= occupancy.around(_places(run, points), n)
    if begins:
        run.stage += 1
        run.occupied = occupancy.resampled(run.occupied, stages[run.stage].cells)
    if run.step:
        run.occupied = occupancy.dilated(run.occupied)
    if points is not None and len(points):
        if begins:
            run.empty = occupancy.empty_by_sight(views, points, run.field.centre, run.field.half, len(run.occupied))
        run.occupied &= ~run.empty
    run.field.occupied_distance = occupancy.distances(run.occupied)
    run.seen = np.zeros(run.occupied.size, np.uint8)
    run.pruned = run.step
    if begins:
        _grow(run, stages[run.stage], points, prior)
    return begins


def _places(run: Training, points) -> np.ndarray:
    return occupancy.contract((np.asarray(points, dtype=float) - run.field.centre) / run.field.half)


def _grow(run: Training, stage: Stage, points, prior) -> None:
    """Add the stage's new levels; the first one starts grey, and dense where the points are."""
    grid = run.field.grid
    for size in stage.levels[len(grid.sizes) :]:
        grid = grid.with_level(size, run.occupied)
    if run.stage == 0:
        grid.values[64:, 1:4] = 0.5
        if points is not None:
            grid.values[grid.rows_near(0, _places(run, points)), 0] = prior
    run.field.grid, run.field.step = grid, 4 / stage.levels[-1] * stage.spacing
    run.descent.grown()


def _fingerprint(views, seed, stages) -> str:
    digest = hashlib.sha256(repr((seed, stages)).encode())
    for view in views:
        for part in (view.camera.K, view.camera.world_from_camera, view.image):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def _save(run: Training, path, views, seed, stages) -> None:
    """Write a checkpoint, atomically."""
    temporary = Path(path).with_name(Path(path).name + ".partial")
    field = run.field
    with open(temporary, "wb") as file:
        np.savez(
            file, fingerprint=_fingerprint(views, seed, stages), centre=field.centre, sizes=field.grid.sizes,
            numbers=[field.half, field.step, field.scale, field.shift, field.near], table=field.grid.table,
            values=field.grid.values, occupied=run.occupied, seen=run.seen, background=field.shading.background,
            inner=field.shading.inner, outer=field.shading.outer, threads=run.descent.threads,
            progress=[run.stage, run.step, run.pruned], seconds=run.seconds, **run.descent.state(),
        )  # fmt: skip
    os.replace(temporary, path)


def _resume(path, views, seed, stages) -> Training | None:
    """The training a checkpoint holds, if there is one and it is of these views, this seed and these stages."""
    if path is None or not Path(path).exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {key: file[key] for key in file.files}
    except (OSError, ValueError, EOFError, KeyError) as error:
        warnings.warn(f"the checkpoint {path} cannot be read ({error}); training starts afresh", stacklevel=3)
        return None
    if str(state["fingerprint"]) != _fingerprint(views, seed, stages):
        warnings.warn(f"the checkpoint {path} is of another training; training starts afresh", stacklevel=3)
        return None
    grid = Grid(state["sizes"], state["table"], state["values"])
    shading = Shading(state["background"], state["inner"], state["outer"])
    field = Field(
        state["centre"], float(state["numbers"][0]), grid, shading, occupancy.distances(state["occupied"]),
        *map(float, state["numbers"][1:]),
    )  # fmt: skip
    descent = KernelDescent(field, int(state["threads"]))
    descent.restore(state)
    stage, step, pruned = map(int, state["progress"])
    return Training(field, descent, state["occupied"], state["seen"], stage, step, pruned, float(state["seconds"]))
