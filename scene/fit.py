"""Posed photographs -> field.

    field = fit(views, points=points, seed=0)

Coarse to fine: while training goes on, levels join the pyramid (`scene.field.grid`), the pictures get larger and the space
that rays pass through shrinks to what is seen. The points of the reconstruction say where surfaces are to be expected.

Pictures taken before a plain backdrop (`scene.exposure.backdrop`) keep its colour behind everything. Other scenes go on
to where no picture reaches, and every ray of them ends somewhere: at first another random colour stands behind
each ray, so that only something opaque can explain it, and space that the cameras look through to points is empty.

Pictures of one scene may be exposed and balanced differently: picture = gain * colour, channel by channel, which is exact
where a camera's curve is a power of the light. Strong differences are told beforehand (`scene.exposure.exposed`); without them gains are
estimated now and then from what the field has become.
"""

import hashlib
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from scene.exposure import backdrop, exposed, gains, ratios
from scene.field import Field, Shading, kernels, occupancy
from scene.field.cells import dilate
from scene.field.descent import Descent, KernelDescent, Rates
from scene.field.device import chosen
from scene.field.grid import Grid
from scene.field.torch_descent import TorchDescent
from scene.files import replacing
from scene.photographs import Photographs

SCALE = 50.0
STEPS = 3200
"""Default number of steps. For 42 photographs of 640x480, two cores did 3251 in 60 s."""
BATCH = 2048
"""Rays a step."""
PASSES = 4
"""How often a pixel of the photographs is learned at most, on average: then voxels learn what single pictures have wrong."""
FINEST, FINEST_OPEN = 1536, 640
"""Cells an axis of the finest level, at most: before a backdrop, and without one."""
NEAR = 0.02
"""Where the rays of a new view begin, in units of the box's half width."""
CLOSER = (0.3, 0.8, 0.1)
"""From the first to the second fraction of training, rays come to begin at the third of the distance within which nothing is: fog there
would explain a picture while the shape is unknown, and later what other cameras left right before this one is to be seen and go."""
OPAQUE = 0.1
"""Until this fraction of training, random colours stand behind a scene that has no backdrop."""
FORMAT = 3
"""Of a checkpoint: one that another version wrote otherwise is of another training."""
SAVE_EVERY = 30.0
"""Seconds between checkpoints."""
SWEEP = 80
"""Before pruning, every picture is looked through at about so many pixels across, or all of them."""
EXPOSED = 0.2
"""From this fraction of training on, sweeps also tell how each picture was exposed: before, the field says too little."""


@dataclass(frozen=True)
class Stage:
    """What training works on from the fraction ``begin`` of its steps (or seconds) on.

    levels: the pyramid's, cells an axis; cells: of the occupancy grid, an axis; spacing: of samples, in voxels of the
    finest level; shrink: how many times smaller the pictures are; prune: after so many steps, and again; visible: cells
    stay occupied if since the last pruning a sample in or beside them had this share of its ray's largest weight.
    """

    begin: float
    levels: tuple[int, ...]
    cells: int
    spacing: float
    shrink: int
    prune: int
    visible: float


def schedule(views, open_ended: bool = False) -> tuple[Stage, ...]:
    """The stages for pictures of this size: the finest voxels are about a pixel wide.

    open_ended: there is no backdrop; all that is far away needs voxels too, so they are fewer to a metre, one and a half pixels wide.
    """
    width = max(view.camera.width for view in views)
    of_pixel, over, finest, spacing = (1.6, 128, FINEST_OPEN, 1.0) if open_ended else (2.4, 192, FINEST, 1.3)
    fine = int(np.clip(round(of_pixel * width / 64) * 64, 256, finest))
    middle = max(fine // over, 2) * 40
    most = 512 if fine > 768 else 256
    return (
        Stage(0.00, (96,), 64, 1.2, 4, 50, 0.10),
        Stage(0.04, (96,), 128, 1.2, 4, 50, 0.15),
        Stage(0.08, (96, middle), 128, 1.5, 2, 100, 0.15),
        Stage(0.14, (96, middle), 256, 1.5, 2, 100, 0.15),
        Stage(0.20, (96, middle), most, 1.0, 1, 100, 0.30),
        Stage(0.26, (96, middle, fine), most, spacing, 1, 250, 0.30),
    )


def learning_rates(pictures: int, open_ended: bool = False) -> tuple[float, float, float, float]:
    """Of density, colour, features and network.

    A ray that meets the backdrop says that its way is empty, so surfaces may form at once. Where no ray says so, fog before
    a camera explains its picture as well as the scene does; the fewer other pictures contradict it, the slower density is.
    """
    return min(0.3, 0.002 * pictures) if open_ended else 0.3, 1.7, 0.003, 0.001


@dataclass
class Training:
    """A training under way: all that a checkpoint holds."""

    field: Field
    descent: Descent
    seen: np.ndarray  # cells that were seen since the last pruning, as bits (`occupancy.cells`)
    surface: np.ndarray  # cells that held a surface since then
    gains: np.ndarray  # (pictures, 3): how much brighter each is than the field, by channel
    stage: int = -1
    step: int = 0
    pruned: int = 0  # the step of the last pruning
    seconds: float = 0.0


def fit(
    views,
    *,
    points=None,
    seed: int = 0,
    steps: int | None = None,
    seconds: float | None = None,
    callback=None,
    checkpoint=None,
    device: str = "auto",
    progress: bool = True,
    bounds=None,
    deterministic: bool = False,
    stages: tuple[Stage, ...] | None = None,
    rates: tuple[float, float, float, float] | None = None,
    decay: float = 0.5,
    exposure: bool = True,
    thin: float = 0.1,
    prior: float = 5.0,
    hidden: int = 32,
) -> Field:
    """Train a field on posed photographs.

    views: the training pictures (holding some out is the caller's). points (N, 3): the reconstruction's,
    if there is one [m]. steps: how many (default STEPS, or as many as fit in ``seconds``, but only so many that each pixel
    is learned PASSES times); seconds: a cap, after which training ends even so, with its schedule spread over that time. callback(field, step, seconds)
    after each step gets the field in training. checkpoint: a file, written now and then, from which a killed
    training goes on; removed at the end. bounds: (2, 3) corners of the box of interest [m], else from points or cameras.
    deterministic: one thread of the CPU, bit-equal results. device: where the field is trained and then lies,
    see `scene.field.device.chosen`: "auto" is a GPU if there is one, else the CPU.

    stages: default `schedule`. rates: of density, colour, features, network (default `learning_rates`), falling
    to ``decay`` of it. exposure: pictures may be exposed differently; the field gets their geometric mean. thin: density of the fog that training begins with, and prior: raw density it begins with at points. hidden:
    width of the network.
    """
    _check(views, device, deterministic)
    device = "cpu" if deterministic else device
    behind_all, brighter = exposed(views, points) if exposure else (backdrop(views), np.ones((len(views), 3), np.float32))
    unsure = exposure and bool((brighter == 1).all())
    stages = stages or schedule(views, open_ended=not len(behind_all))
    rates = rates or learning_rates(len(views), open_ended=not len(behind_all))
    threads = 1 if deterministic else kernels.THREADS
    run = _resume(checkpoint, views, seed, stages, device, threads) or _start(
        views, points, bounds, Shading.initial(np.random.default_rng(seed), behind_all, hidden), device, threads, thin, brighter
    )
    limit = steps if steps is not None else min(STEPS if seconds is None else np.inf, _most(views))
    clock, saved = time.perf_counter() - run.seconds, time.perf_counter()
    nearest = occupancy.nearest(views, points) / run.field.half
    pictures, error = None, None
    bar = tqdm(total=limit, initial=run.step, desc="train", disable=not progress, leave=False)
    while True:
        run.seconds = time.perf_counter() - clock
        done = max(run.step / limit, run.seconds / seconds if seconds else 0.0)
        if done >= 1:
            break
        near = nearest * np.interp(done, CLOSER[:2], (1, CLOSER[2]))
        if _advance(run, stages, done, points, prior, views, near, unsure and done >= EXPOSED) or pictures is None:
            stage = stages[run.stage]
            pictures = Photographs.of(views, run.field.centre, run.field.half, stage.shrink)
        rng = np.random.default_rng((seed, run.step))
        rays, target, which = pictures.draw(rng, BATCH, near)
        target /= run.gains[which]
        jitter = rng.random(len(target), np.float32)
        now = Rates(*(rate * decay**done for rate in rates))
        anything = not len(behind_all) and done < OPAQUE
        behind = rng.random((len(target), 3), np.float32) if anything else run.field.behind(len(target))
        mse = run.descent.step(rays, target, behind, jitter, now, run.seen, run.surface, stages[run.stage].visible)
        error = mse if error is None else 0.95 * error + 0.05 * mse
        run.step += 1
        bar.update(1)
        if run.step % 20 == 0:
            bar.set_postfix(psnr=f"{-10 * np.log10(error):.2f} dB", loss=f"{error:.5f}", refresh=False)
        if callback is not None:
            callback(run.field, run.step, run.seconds)
        if checkpoint is not None and time.perf_counter() - saved > SAVE_EVERY:
            _save(run, checkpoint, views, seed, stages)
            saved = time.perf_counter()
    bar.close()
    if checkpoint is not None:
        Path(checkpoint).unlink(missing_ok=True)
    return run.field


def _most(views) -> int:
    """Steps in which each pixel is learned PASSES times."""
    return max(1, PASSES * sum(view.camera.width * view.camera.height for view in views) // BATCH)


def _check(views, device: str, deterministic: bool) -> None:
    if len(views) < 2:
        raise ValueError(f"a field needs at least two photographs, {len(views)} given")
    if chosen(device) is not None and device != "auto" and deterministic:
        raise ValueError(f"training is bit-equal on the CPU only, not on device {device!r}; use 'cpu', or deterministic=false")


def _descent(field: Field, threads: int) -> Descent:
    return KernelDescent(field, threads) if field.twin is None else TorchDescent(field)


def _start(views, points, bounds, shading: Shading, device, threads, thin, brighter) -> Training:
    centre, half = occupancy.box_of_interest(views, points, bounds)
    occupied = occupancy.seen(views, centre, half, 64)
    field = Field(
        centre, half, Grid.empty(), shading, occupancy.Occupancy.of(occupied),
        step=1.0, scale=SCALE, shift=float(np.log(np.expm1(thin / SCALE))), near=NEAR,
    ).on(device)  # fmt: skip
    return Training(field, _descent(field, threads), *np.zeros((2, 1), np.uint64), brighter)


def _advance(run: Training, stages, done: float, points, prior, views, near, exposure: bool) -> bool:
    """Prune, and go to the next stage, when it is time. True if a stage begins."""
    due = run.step - run.pruned >= stages[run.stage].prune or run.stage < 0
    begins = due and run.stage + 1 < len(stages) and done >= stages[run.stage + 1].begin
    if not (due or begins):
        return False
    mask = run.field.occupied.mask
    if run.stage >= 0:
        _sweep(run, views, stages[run.stage].visible, near, exposure)
        mask = run.seen if points is None else occupancy.marked(run.seen, _places(run, points))
    if begins:
        run.stage += 1
        mask = occupancy.bits(occupancy.resampled(occupancy.cells(mask), stages[run.stage].cells))
    n = stages[run.stage].cells
    if run.step:
        mask = dilate(mask, n // 4)
    if points is not None and len(points) and not len(run.field.shading.background) and n <= 256:
        mask = mask & ~occupancy.bits(occupancy.empty_by_sight(views, points, run.field.centre, run.field.half, n))
    run.field.occupied = occupancy.Occupancy.from_mask(mask)
    if begins:
        _grow(run, stages[run.stage], points, prior)
    run.seen, run.surface = (np.zeros(len(run.field.occupied.mask), np.uint64) for _ in range(2))
    run.pruned = run.step
    return begins


def _sweep(run: Training, views, visible: float, near: float, exposure: bool) -> None:
    """Note what all pictures see, so that no cell is pruned for want of a ray, and how they are exposed."""
    rng = np.random.default_rng(run.step)
    logs = []
    for view in views:
        every = max(view.camera.width // SWEEP, 1)
        x, y = rng.random(2) * every
        pixels = np.stack(np.meshgrid(np.arange(x, view.camera.width, every), np.arange(y, view.camera.height, every)), -1)
        rays = run.field.rays(*view.camera.rays(pixels.reshape(-1, 2)))
        rays.near[:] = near
        marched = run.field.march(rays, keep=100, seen=run.seen, surface=run.surface, visible=visible, threads=run.descent.threads)
        if exposure:
            colour = run.field.shade(marched, rays, run.field.behind(len(rays.near)), run.descent.threads)
            logs.append(ratios(view, pixels.reshape(-1, 2), colour))
    run.gains = gains(np.array(logs)) if exposure else run.gains


def _places(run: Training, points) -> np.ndarray:
    return occupancy.contract((np.asarray(points, dtype=float) - run.field.centre) / run.field.half)


def _grow(run: Training, stage: Stage, points, prior) -> None:
    """Add the stage's new levels; the first one starts grey, and dense where the points are."""
    grid = run.field.grid
    for size in stage.levels[len(grid.sizes) :]:
        grid = grid.with_level(size, occupancy.cells(run.field.occupied.mask if len(grid.sizes) < 2 else run.surface))
    if run.stage == 0:
        grid.values[64:, 1:4] = 0.5
        if points is not None:
            grid.values[grid.rows_near(0, _places(run, points)), 0] = prior
    run.field.grid, run.field.step = grid, 4 / stage.levels[-1] * stage.spacing
    run.descent.grown()


def _fingerprint(views, seed, stages) -> str:
    digest = hashlib.sha256(repr((FORMAT, seed, stages)).encode())
    for view in views:
        for part in (view.camera.K, view.camera.world_from_camera, view.image):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def _save(run: Training, path, views, seed, stages) -> None:
    """Write a checkpoint, atomically."""
    field = run.field.on("cpu")
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(
            file, fingerprint=_fingerprint(views, seed, stages), centre=field.centre, sizes=field.grid.sizes,
            numbers=[field.half, field.step, field.scale, field.shift, field.near],
            roots=field.grid.roots, table=field.grid.table, values=field.grid.values, occupied=field.occupied.mask, seen=run.seen, surface=run.surface, gains=run.gains, background=field.shading.background,
            inner=field.shading.inner, outer=field.shading.outer,
            progress=[run.stage, run.step, run.pruned], seconds=run.seconds, **run.descent.state(),
        )  # fmt: skip


def _resume(path, views, seed, stages, device, threads) -> Training | None:
    """The training a checkpoint holds, if there is one and it is of these views, this seed and these stages, whatever the device."""
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
    grid = Grid(state["sizes"], state["roots"], state["table"], state["values"])
    shading = Shading(state["background"], state["inner"], state["outer"])
    field = Field(
        state["centre"], float(state["numbers"][0]), grid, shading, occupancy.Occupancy.from_mask(state["occupied"]),
        *map(float, state["numbers"][1:]),
    ).on(device)  # fmt: skip
    descent = _descent(field, threads)
    descent.restore(state)
    stage, step, pruned = map(int, state["progress"])
    return Training(field, descent, state["seen"], state["surface"], state["gains"], stage, step, pruned, float(state["seconds"]))
