"""Photographs -> cameras and points, by COLMAP's incremental structure from motion.

pycolmap runs in a process of its own: importing it first spoils zlib, it holds the interpreter for seconds, and only
a process can be killed. What passes between the two is one JSON line in and files out:

    <work>/images/<name>         the photographs undistorted, at most ``max_size`` px long, as the cameras of Model see
           colmap/sparse/0/      the model with the lens as it was estimated, for COLMAP
           colmap/model.npz      the Model
           colmap/masks/         where the pictures are not to be looked at, for those that came with a mask

Everything is in the model's own frame, which has no scale and any direction: scene.frame brings it to the robot.
Cameras are pinholes; pixel (0, 0) is the top-left corner of the top-left pixel, as everywhere here.
"""

import ctypes
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from PIL import ExifTags, Image
from tqdm import tqdm

from scene.camera import Camera, View, invert
from scene.dataset import FEWEST_PHOTOGRAPHS, MASKS, inside, is_rotated, load_image, read_mask, read_points, save_image, save_mask
from scene.files import replacing
from scene.transforms import Posed

STRAIGHT = 0.1
"""A lens that moves no pixel by more than this [px] is taken for a pinhole, and its pictures are kept as they are."""

UPSAMPLED = 500
"""Photographs smaller than this [px] are searched for features at twice their size."""

USUAL = {"max_ratio": 0.8, "init_inliers": 60, "pose_inliers": 25, "init_angle": 12.0}
RELAXED = {"max_ratio": 0.9, "init_inliers": 25, "pose_inliers": 15, "init_angle": 4.0}
"""Thresholds of matching and mapping: first for all photographs, then for pairs with those that were left out."""
PEAK, RELAXED_PEAK = 0.0067, 0.002
"""Contrast a feature must have; the lower one is tried where the first attempt joins too few photographs."""
LEAST_BYTES = {"cameras.bin": 48, "images.bin": 73, "points3D.bin": 51}
"""Of one record of COLMAP's binary files."""


class ReconstructionFailed(ValueError):
    """The photographs could not be joined to one model."""


@dataclass(frozen=True, eq=False)
class Model:
    """What structure from motion found, in its own frame.

    names: of the registered photographs, sorted, without extension. cameras: pinholes, one each. images: files of the
    undistorted pictures. points: (N, 3); colours: (N, 3) uint8; point_errors: (N,) mean reprojection error [px].
    total: photographs given. reprojection_px: mean over all observations, in pixels of the photographs as they were.
    unregistered: names of those left out. sparse: folder of the COLMAP model.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    images: tuple[Path, ...]
    points: np.ndarray
    colours: np.ndarray
    point_errors: np.ndarray
    total: int
    reprojection_px: float
    unregistered: tuple[str, ...]
    sparse: Path

    @property
    def registered(self) -> int:
        """Number of photographs in the model."""
        return len(self.names)

    def views(self) -> list[View]:
        """The undistorted pictures with their cameras, in the model's frame."""
        files = [self.sparse.parents[2] / MASKS / f"{name}.png" for name in self.names]
        masks = [read_mask(file) if file.is_file() else None for file in files]
        return [View(*parts) for parts in zip(self.names, self.cameras, map(load_image, self.images), masks, strict=True)]

    @classmethod
    def load(cls, work: str | Path) -> "Model":
        """The model that ``reconstruct`` left in its work folder."""
        work = Path(work)
        with np.load(work / "colmap" / "model.npz", allow_pickle=False) as file:
            parts = dict(file)
        cameras = zip(parts["K"], parts["world_from_camera"], *parts["sizes"].T, strict=True)
        return cls(
            names=tuple(parts["names"].tolist()),
            cameras=tuple(Camera(*camera) for camera in cameras),
            images=tuple(work / "images" / name for name in parts["images"].tolist()),
            **{key: parts[key] for key in ("points", "colours", "point_errors")},
            total=int(parts["total"]),
            reprojection_px=float(parts["reprojection_px"]),
            unregistered=tuple(parts["unregistered"].tolist()),
            sparse=work / "colmap" / "sparse" / "0",
        )


def reconstruct(
    photographs: Sequence[str | Path],
    work: str | Path,
    *,
    seed: int = 0,
    camera_model: str = "SIMPLE_RADIAL",
    single_camera: bool = True,
    features: int = 4096,
    feature_size: int = 1600,
    max_size: int = 1024,
    threads: int = 1,
    progress: bool = True,
    masks: Mapping[str, Path] | None = None,
) -> Model:
    """Register photographs (as scene.dataset.load_photographs lists them) with each other; write ``work``, see above.

    camera_model: COLMAP's name of the lens model. single_camera: all photographs were taken with one lens and zoom.
    features: at most so many in a photograph. feature_size: longest side [px] at which they are sought.
    max_size: longest side [px] of the undistorted pictures. threads: with 1 the same seed gives the same model, bit by
    bit; more are faster. masks: {photograph's name: file}, see scene.masks. Raises ReconstructionFailed when fewer than three or fewer than half of the photographs join.
    """
    photographs, work = [Path(p).absolute() for p in photographs], Path(work)
    if len({p.stem for p in photographs}) < len(photographs):
        raise ValueError("photographs must have different names")
    if any(p.parent == (work / "images").absolute() for p in photographs):
        raise ValueError(f"the photographs lie in {work / 'images'}, where undistorted ones are written; move them")
    unfinished = work / ".colmap.part"
    shutil.rmtree(unfinished, ignore_errors=True)
    (unfinished / "photographs").mkdir(parents=True)
    try:
        for path in photographs:
            _lay_out(path, unfinished / "photographs" / path.name)
            if path.stem in (masks or {}):  # COLMAP wants the whole name before the ending
                save_mask(unfinished / "masks" / f"{path.name}.png", read_mask(masks[path.stem]))
        settings = {
            "folder": str(unfinished.absolute()), "names": sorted(p.name for p in photographs), "seed": seed,
            "camera_model": camera_model, "single_camera": single_camera, "features": features,
            "feature_size": feature_size, "max_size": max_size, "threads": threads,
        }  # fmt: skip
        return _worked("solve", settings, work, progress)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def adopt(
    given: Posed | Path, images: str | Path, work: str | Path, *, max_size: int = 1024, progress: bool = True,
    fewest: int = FEWEST_PHOTOGRAPHS,
) -> Model:  # fmt: skip
    """Take cameras that are known already as they are, in their own frame; write ``work``, see above.

    given: Posed, or the folder of a COLMAP model whose pictures lie in ``images``. Points of a Posed come without what
    saw them, so the model has no reprojection error (nan). Raises ReconstructionFailed when the model cannot be read,
    fewer than ``fewest`` of its pictures have cameras, or one is missing, of another size, or turned by its EXIF.
    """
    work = Path(work)
    settings = {"images": str(Path(images).absolute()), "max_size": max_size, "fewest": fewest}
    if isinstance(given, Posed):
        points, colours = read_points(given.ply) if given.ply else (np.empty((0, 3)), np.empty((0, 3)))
        settings |= {"names": given.names, "lenses": given.lenses, "poses": given.poses.tolist()}
        settings |= {"masks": {name: str(path.absolute()) for name, path in given.masks.items()}}
        settings |= {"points": points.tolist(), "colours": colours.tolist()}
    else:
        _require_whole(Path(given))
        settings |= {"names": (), "sparse": str(Path(given).absolute())}
    unfinished = work / ".colmap.part"
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    try:
        return _worked("adopt", settings | {"folder": str(unfinished.absolute())}, work, progress)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _require_whole(sparse: Path) -> None:
    """Raise ReconstructionFailed where a binary file is shorter than the number of records it states: COLMAP would read on
    for minutes."""
    for name, record in LEAST_BYTES.items():
        path = sparse / name
        if path.is_file():
            with open(path, "rb") as file:
                count = int.from_bytes(file.read(8), "little")
            if path.stat().st_size < 8 + record * count:
                raise ReconstructionFailed(f"{sparse} is not a readable COLMAP model: {name} is cut off or damaged")


def _worked(task: str, settings: dict, work: Path, progress: bool) -> Model:
    """Have the worker fill its folder, and move what it made into place."""
    unfinished = Path(settings["folder"])
    answer = _run_worker(settings | {"task": task}, unfinished / "log.txt", progress)
    if "failure" in answer:
        raise ReconstructionFailed(answer["failure"])
    for result in ("images", "colmap"):  # the model comes last: with it the work is whole
        shutil.rmtree(work / result, ignore_errors=True)
        (unfinished / result).replace(work / result)
    return Model.load(work)


def _lay_out(source: Path, target: Path):
    """Put a photograph where COLMAP looks; one that EXIF turns is written upright, with the rest of its EXIF."""
    if not is_rotated(source):
        target.symlink_to(source)
        return
    with Image.open(source) as image:
        exif = image.getexif()
    del exif[ExifTags.Base.Orientation]
    Image.fromarray(load_image(source)).save(target, quality=98, subsampling=0, exif=exif)


def _run_worker(settings: dict, log: Path, progress: bool) -> dict:
    """Do the work in another process, which dies with this one; its last line is the answer."""
    code = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from scene.colmap import _work; _work()"
    command = [sys.executable, "-P", "-c", code, json.dumps([str(Path(__file__).parents[1]), *sys.path])]
    with open(log, "wb") as errors:
        worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True)
    try:
        worker.stdin.write(json.dumps(settings) + "\n")
        worker.stdin.flush()  # and stays open: its end tells the worker that nobody waits any more
        answer = {}
        with tqdm(total=len(settings["names"]), unit="photo", disable=not progress, leave=False) as bar:
            for line in worker.stdout:
                answer = json.loads(line)
                _show(bar, answer)
        worker.wait()
    finally:
        worker.kill()
        worker.wait()
        worker.stdin.close()
        worker.stdout.close()
    if not answer.keys() & {"done", "failure"}:
        last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no message"]
        raise ReconstructionFailed(f"COLMAP's process ended with code {worker.returncode}: {last[0][-300:]}")
    return answer


def _show(bar: tqdm, message: dict):
    if "stage" in message:
        bar.set_description(message["stage"])
        bar.n = 0
    bar.n = message.get("count", bar.n)
    bar.refresh()


def straighten(model: Model, pixels: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Pixels (N, 2) of photographs as they were taken (upright), by name -> of the undistorted pictures of ``model``.

    ValueError for a photograph that is not in the model, or a pixel outside of it.
    """
    given = {name: np.asarray(p, dtype=float).reshape(-1, 2).tolist() for name, p in pixels.items()}
    unknown = sorted(given.keys() - set(model.names))
    if unknown:
        left_out = " (left out by COLMAP)" if unknown[0] in model.unregistered else ""
        raise ValueError(f"no photograph {unknown[0]}{left_out} in the model; there are {', '.join(model.names[:6])}, ...")
    code = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from scene.colmap import _rays; _rays()"
    command = [sys.executable, "-P", "-c", code, json.dumps([str(Path(__file__).parents[1]), *sys.path])]
    settings = json.dumps({"sparse": str(model.sparse), "pixels": given})
    answer = subprocess.run(command, input=settings, capture_output=True, text=True)
    if answer.returncode:
        last = answer.stderr.strip().splitlines()[-1:] or ["no message"]
        raise ReconstructionFailed(f"{model.sparse} cannot be read: {last[0][-300:]}")
    answer = json.loads(answer.stdout.splitlines()[-1])
    outside = [name for name in given if answer["outside"][name]]
    if outside:
        raise ValueError(f"photograph {outside[0]} has no pixel {given[outside[0]]}: {answer['outside'][outside[0]]}")
    lenses = {name: camera.K for name, camera in zip(model.names, model.cameras, strict=True)}
    return {name: np.array(rays) @ lenses[name][:2, :2].T + lenses[name][:2, 2] for name, rays in answer["rays"].items()}


# What follows runs in the worker process only.


def _rays():
    """Read photographs' pixels, answer with x / z, y / z of the rays that the estimated lens sends through them."""
    settings = json.loads(sys.stdin.readline())
    model = _pycolmap().Reconstruction(settings["sparse"])
    lenses = {Path(image.name).stem: model.cameras[image.camera_id] for image in model.images.values()}
    rays, outside = {}, {}
    for name, pixels in settings["pixels"].items():
        pixels, size = np.array(pixels), (lenses[name].width, lenses[name].height)
        rays[name] = np.asarray(lenses[name].cam_from_img(pixels)).tolist()
        outside[name] = f"it is {size[0]}x{size[1]}" if (pixels < 0).any() or (pixels > size).any() else ""
    print(json.dumps({"rays": rays, "outside": outside}))


def _work():
    """Read the settings, answer with lines of JSON; end at once when whoever asked is gone."""
    settings = json.loads(sys.stdin.readline())
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which ends this process
    _die_with_parent()
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints goes to the log

    def say(**message):
        answers.write(json.dumps(message) + "\n")

    try:
        {"solve": _solve, "adopt": _adopt}[settings.pop("task")](say=say, **settings)
        say(done=True)
    except ReconstructionFailed as failure:
        say(failure=str(failure))


def _die_with_parent():
    """End when the other end of stdin is gone; on Linux by the kernel, as pycolmap holds the interpreter for long."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _solve(folder, names, seed, threads, max_size, say, **settings):
    """Reconstruct; what was left out is tried once more with relaxed thresholds before it is given up."""
    pycolmap, folder = _pycolmap(), Path(folder)
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING.value
    pycolmap.set_random_seed(seed)
    run = _Run(pycolmap, folder, names, seed, threads, say)
    run.extract(PEAK, **settings)
    found = run.match(names, USUAL["max_ratio"])
    best = run.map(USUAL)
    if _left_out(best, names):
        if not _enough(best, names):
            run.extract(RELAXED_PEAK, **settings | {"features": 2 * settings["features"]})
            best = None
        found = run.match(_left_out(best, names), RELAXED["max_ratio"])
        best = max(best, run.map(RELAXED), key=_registered)
    if not _enough(best, names):
        raise ReconstructionFailed(_advice(len(names), _registered(best), found))
    straight = _adjust(pycolmap, best, max_size)
    (folder / "colmap" / "sparse" / "0").mkdir(parents=True)
    best.write(folder / "colmap" / "sparse" / "0")
    masks = {path.stem: path for path in (folder / "masks").glob("*.png")}
    _write_results(best, folder, names, max_size, straight, say, masks)


def _adopt(folder, names, images, max_size, fewest, say, sparse=None, masks=None, **given):
    """Write what is known already as ``_solve`` writes what it has found."""
    pycolmap, folder, images = _pycolmap(), Path(folder), Path(images)
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    if sparse is None:
        model = _built(pycolmap, names, **given)
    else:
        try:
            model = pycolmap.Reconstruction(sparse)
        except (ValueError, RuntimeError, MemoryError, IndexError, KeyError) as error:
            raise ReconstructionFailed(f"{sparse} is not a readable COLMAP model: {error}") from error
    posed = [image for image in model.images.values() if image.has_pose]
    if len(posed) < fewest:
        raise ReconstructionFailed(f"only {len(posed)} pictures have cameras; a scene needs {fewest}, better 30")
    _check_pictures(images, [(image.name, model.cameras[image.camera_id]) for image in posed])
    (folder / "colmap" / "sparse" / "0").mkdir(parents=True)
    model.write(folder / "colmap" / "sparse" / "0")
    straight = all(_bend(camera, max_size) < STRAIGHT for camera in model.cameras.values())
    masks = {name: Path(path) for name, path in (masks or {}).items()}
    _write_results(model, folder, [image.name for image in model.images.values()], max_size, straight, say, masks, images)


def _built(pycolmap, names, lenses, poses, points, colours):
    """A COLMAP model of cameras and points alone; pictures of one lens share its camera."""
    model, numbers = pycolmap.Reconstruction(), {}
    for i, (name, lens, pose) in enumerate(zip(names, lenses, poses, strict=True), start=1):
        key = json.dumps(lens)
        if key not in numbers:
            numbers[key] = len(numbers) + 1
            model.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=numbers[key], **lens))
        image = pycolmap.Image(name=name, camera_id=numbers[key], image_id=i)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(invert(np.array(pose))[:3]))
    for point, colour in zip(points, colours, strict=True):
        model.add_point3D(np.array(point), pycolmap.Track(), np.array(colour, dtype=np.uint8))
    return model


def _check_pictures(images: Path, cameras: list[tuple]):
    """Every picture is there, and the one that its camera took."""
    for name, camera in cameras:
        try:
            path = inside(images, name, f"picture {name}")
            height, width = load_image(path).shape[:2]
        except (ValueError, FileNotFoundError) as error:
            raise ReconstructionFailed(str(error)) from error
        if is_rotated(path):
            raise ReconstructionFailed(f"picture {name} is turned by its EXIF, its camera may not be: save it upright")
        if (width, height) != (camera.width, camera.height):
            said = f"{camera.width}x{camera.height}"
            raise ReconstructionFailed(f"picture {name} is {width}x{height}, but its camera says {said}")
    flat = [_flat(name) for name, _ in cameras]
    if len(set(flat)) < len(flat):
        twice = sorted({name for name in flat if flat.count(name) > 1})
        raise ReconstructionFailed(f"more than one picture is called {', '.join(twice[:6])}")


def _flat(name: str) -> str:
    """What a picture is called here: COLMAP's name, which may have folders, without its ending."""
    return str(Path(name).with_suffix("")).replace(os.sep, "_")


def _registered(model) -> int:
    return 0 if model is None else model.num_reg_images()


def _left_out(model, names) -> list[str]:
    inside = set() if model is None else {image.name for image in model.images.values() if image.has_pose}
    return [name for name in names if name not in inside]


def _enough(model, names) -> bool:
    return _registered(model) >= max(FEWEST_PHOTOGRAPHS, len(names) / 2)


def _pycolmap():
    """pycolmap, after those whose zlib it would otherwise take the place of."""
    import zlib  # noqa: F401

    import cv2  # noqa: F401
    import pycolmap

    return pycolmap


@dataclass(frozen=True)
class _Run:
    """COLMAP's three steps on one database."""

    pycolmap: ModuleType
    folder: Path
    names: list[str]
    seed: int
    threads: int
    say: Callable

    @property
    def database(self) -> Path:
        return self.folder / "database.db"

    def extract(self, peak, camera_model, single_camera, features, feature_size):
        """Features of all photographs, in a new database."""
        self.database.unlink(missing_ok=True)
        options = self.pycolmap.FeatureExtractionOptions()
        options.num_threads = self.threads
        options.max_image_size = feature_size
        options.sift.max_num_features = features
        options.sift.peak_threshold = peak
        options.sift.first_octave = -1 if self._longest_side() < UPSAMPLED else 0
        reader = self.pycolmap.ImageReaderOptions()
        reader.camera_model = camera_model
        if (self.folder / "masks").is_dir():
            reader.mask_path = self.folder / "masks"
        mode = self.pycolmap.CameraMode.SINGLE if single_camera else self.pycolmap.CameraMode.PER_IMAGE
        self.say(stage="features", count=0)
        for start in range(0, len(self.names), 4):
            self.pycolmap.extract_features(
                self.database, self.folder / "photographs", image_names=self.names[start : start + 4], camera_mode=mode,
                reader_options=reader, extraction_options=options, device=self.pycolmap.Device.cpu,
            )  # fmt: skip
            if single_camera and start == 0:
                with self.pycolmap.Database.open(self.database) as content:
                    reader.existing_camera_id = content.read_all_cameras()[0].camera_id
            self.say(count=min(start + 4, len(self.names)))

    def _longest_side(self) -> int:
        with Image.open(self.folder / "photographs" / self.names[0]) as image:
            return max(image.size)

    def match(self, names, max_ratio) -> dict:
        """Match ``names`` with all photographs anew; returns how much the database holds then."""
        with self.pycolmap.Database.open(self.database) as content:
            numbers = {image.name: image.image_id for image in content.read_all_images()}
            for a, b in itertools.product(names, self.names):
                if a != b and content.exists_matches(numbers[a], numbers[b]):
                    content.delete_matches(numbers[a], numbers[b])
                    content.delete_two_view_geometry(numbers[a], numbers[b])
        options = self.pycolmap.FeatureMatchingOptions()
        options.num_threads = self.threads
        options.sift.max_ratio = max_ratio
        verification = self.pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = self.seed
        self.say(stage="matches", count=0)
        self.pycolmap.match_exhaustive(  # leaves alone what is matched already
            self.database, matching_options=options, verification_options=verification, device=self.pycolmap.Device.cpu
        )
        with self.pycolmap.Database.open(self.database) as content:
            features = content.num_keypoints() / content.num_images()
            return {"pairs": content.num_verified_image_pairs(), "features": features}

    def map(self, limits):
        """The largest model, or None."""
        options = self.pycolmap.IncrementalPipelineOptions()
        options.num_threads = 1  # sums in bundle adjustment depend on the order of its threads
        options.random_seed = self.seed
        options.min_model_size = FEWEST_PHOTOGRAPHS
        options.mapper.init_min_num_inliers = limits["init_inliers"]
        options.mapper.init_min_tri_angle = limits["init_angle"]
        options.mapper.abs_pose_min_num_inliers = limits["pose_inliers"]
        count = itertools.count(3)
        self.say(stage="cameras", count=2)
        with tempfile.TemporaryDirectory(dir=self.folder) as output:
            models = self.pycolmap.incremental_mapping(
                self.database, self.folder / "photographs", output, options,
                next_image_callback=lambda: self.say(count=next(count)),
            )  # fmt: skip
        return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()), default=None)


def _advice(total: int, registered: int, found: dict) -> str:
    pairs = total * (total - 1) // 2
    return (
        f"only {registered} of {total} photographs could be joined ({found['pairs']} of {pairs} pairs show common "
        f"points, {found['features']:.0f} features in a photograph). What helps: neighbours that overlap by 60-80 %, "
        "in steps of at most 20 degrees around a still scene, sharp, with texture on or around the objects"
    )


def _adjust(pycolmap, model, max_size) -> bool:
    """Final bundle adjustment; returns whether the lens is straight, in which case the model says so too."""
    _bundle(pycolmap, model, lens=True)
    bends = max(_bend(camera, max_size) for camera in model.cameras.values())
    if bends > 20 * STRAIGHT:
        return False
    bent = {number: camera.params.copy() for number, camera in model.cameras.items()}
    error = model.compute_mean_reprojection_error()
    _straighten(model)
    _bundle(pycolmap, model, lens=False)
    if bends < STRAIGHT or model.compute_mean_reprojection_error() < 1.01 * error:
        return True
    for number, params in bent.items():
        model.cameras[number].params = params
    _bundle(pycolmap, model, lens=True)
    return False


def _bundle(pycolmap, model, lens: bool):
    """Bundle adjustment with a robust loss of 1 px, so that the odd wrong match does not bend the model."""
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_extra_params = lens
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.function_tolerance = 1e-6
    pycolmap.bundle_adjustment(model, options)
    model.update_point_3d_errors()


def _straighten(model):
    for camera in model.cameras.values():
        params = camera.params.copy()
        params[list(camera.extra_params_idxs())] = 0
        camera.params = params


def _pinhole(camera) -> np.ndarray:
    """K (3, 3) of a COLMAP camera without its distortion."""
    rows = [camera.focal_length_x, 0, camera.principal_point_x], [0, camera.focal_length_y, camera.principal_point_y]
    return np.array([*rows, [0, 0, 1]])


def _bend(camera, max_size) -> float:
    """How far the lens moves a pixel at most [px of the undistorted picture]."""
    grid = np.meshgrid(np.linspace(0, camera.width, 41), np.linspace(0, camera.height, 41))
    pixels = np.stack(grid, axis=-1).reshape(-1, 2)
    moved = _through_lens(camera, _pinhole(camera), pixels) - pixels
    return float(np.linalg.norm(moved, axis=1).max()) * min(1, max_size / max(camera.width, camera.height))


def _through_lens(camera, K, pixels) -> np.ndarray:
    """Where the lens puts what a pinhole K sees at pixels (N, 2)."""
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(K).T
    return np.asarray(camera.img_from_cam(rays))


def _widest_pinhole(camera) -> np.ndarray:
    """K (3, 3) of the widest pinhole of the same size all of whose pixels the photograph has seen."""
    K, width, height = _pinhole(camera), camera.width, camera.height
    u, v = np.linspace(0, width, 65), np.linspace(0, height, 65)
    sides = (u, 0.0), (u, float(height)), (0.0, v), (float(width), v)
    edge = np.concatenate([np.stack(np.broadcast_arrays(*side), axis=1) for side in sides])
    low, high = 0.5, 2.0
    for _ in range(40):
        zoom = (low + high) / 2
        seen = _through_lens(camera, K * [[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]], edge)
        inside = np.isfinite(seen).all() and (seen >= 0).all() and (seen <= [width, height]).all()
        low, high = (low, zoom) if inside else (zoom, high)
    return K * [[high, 1, 1], [1, high, 1], [1, 1, 1]]


def _write_results(model, folder, names, max_size, straight, say, masks, photographs=None):
    """The undistorted pictures and masks ({picture's name: file}), and model.npz. photographs: where they lie, if not in ``folder``."""
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    pinhole = _pinhole if straight else _widest_pinhole
    lenses = {number: pinhole(camera) for number, camera in model.cameras.items()}
    cameras, files = [], []
    say(stage="pictures", count=0)
    for image in images:
        lens = model.cameras[image.camera_id]
        full = Camera(lenses[image.camera_id], _world_from_camera(image), lens.width, lens.height)
        scale = min(1, max_size / max(full.width, full.height))
        cameras.append(full.resized(round(full.width * scale), round(full.height * scale)))
        source = (photographs or folder / "photographs") / image.name
        target = folder / "images" / _flat(image.name)
        files.append(_undistort(source, target, None if straight else lens, full, cameras[-1]))
        if image.name in masks:
            mask = np.uint8(255) * read_mask(masks[image.name])
            seen = _resampled(mask, None if straight else lens, full, cameras[-1]) > 250  # what is partly ignored is ignored
            save_mask(folder / MASKS / f"{_flat(image.name)}.png", seen)
        say(count=len(files))
    points = [model.points3D[number] for number in sorted(model.points3D)]
    registered = {image.name for image in images}
    with replacing(folder / "colmap" / "model.npz") as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            names=[_flat(image.name) for image in images],
            images=[path.name for path in files],
            K=[camera.K for camera in cameras],
            world_from_camera=[camera.world_from_camera for camera in cameras],
            sizes=[(camera.width, camera.height) for camera in cameras],
            points=np.array([p.xyz for p in points]).reshape(-1, 3),
            colours=np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
            point_errors=[p.error for p in points],
            total=len(names),
            reprojection_px=model.compute_mean_reprojection_error() if model.compute_num_observations() else np.nan,
            unregistered=np.array([_flat(name) for name in names if name not in registered], dtype=str),
        )


def _world_from_camera(image) -> np.ndarray:
    camera_from_world = np.eye(4)
    camera_from_world[:3] = image.cam_from_world().matrix()
    return invert(camera_from_world)


def _undistort(source, stem, lens, full, camera) -> Path:
    """Write one picture as ``camera`` sees it to ``stem`` with an ending; without a change it is copied bit by bit."""
    unchanged = lens is None and (full.width, full.height) == (camera.width, camera.height)
    if unchanged and source.suffix.lower() in (".png", ".jpg", ".jpeg"):
        stem.parent.mkdir(exist_ok=True)
        return Path(shutil.copyfile(source, stem.with_name(stem.name + source.suffix)))
    target = stem.with_name(f"{stem.name}.png")
    save_image(target, _resampled(load_image(source), lens, full, camera))
    return target


def _resampled(picture, lens, full, camera) -> np.ndarray:
    """A picture (H, W[, 3]) uint8 of a lens (None: a pinhole) as ``camera`` sees it."""
    import cv2

    picture = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    if lens is not None:
        enlarged = np.array([full.width / camera.width, full.height / camera.height])
        seen = _through_lens(lens, full.K, camera.pixel_centres().reshape(-1, 2) * enlarged)
        seen = seen / enlarged - 0.5  # OpenCV: centres at whole numbers
        seen = seen.reshape(camera.height, camera.width, 2).astype(np.float32)
        picture = cv2.remap(picture, seen[..., 0], seen[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return picture
