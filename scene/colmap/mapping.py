"""Features, matches and incremental mapping: photographs become a COLMAP model. Runs in COLMAP's process (scene.colmap)."""

import itertools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from PIL import Image

from scene.colmap.lens import STRAIGHT, bend, drop_distortion
from scene.colmap.undistortion import write_results
from scene.dataset import FEWEST_PHOTOGRAPHS
from scene.model import ReconstructionFailed

UPSAMPLED = 500
"""Photographs smaller than this [px] are searched for features at twice their size."""

USUAL = {"max_ratio": 0.8, "init_inliers": 60, "pose_inliers": 25, "init_angle": 12.0}
RELAXED = {"max_ratio": 0.9, "init_inliers": 25, "pose_inliers": 15, "init_angle": 4.0}
"""Thresholds of matching and mapping: first for all photographs, then for pairs with those that were left out."""
PEAK, RELAXED_PEAK = 0.0067, 0.002
"""Contrast a feature must have; the lower one is tried where the first attempt joins too few photographs."""

FEATURELESS = 50
"""Photographs with fewer features show too little to be joined by."""


def solve(pycolmap, folder, names, cameras, seed, threads, max_size, alike, say, **settings):
    """Reconstruct; what was left out is tried once more with relaxed thresholds before it is given up."""
    folder = Path(folder)
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING.value
    pycolmap.set_random_seed(seed)
    run = _Run(pycolmap, folder, names, cameras, seed, threads, say)
    run.extract(PEAK, **settings)
    found = run.match(names, USUAL["max_ratio"], alike)
    models = run.map(USUAL)
    best = models[0] if models else None
    if _left_out(best, names):
        if not _enough(best, names):
            run.extract(RELAXED_PEAK, **settings | {"features": 2 * settings["features"]})
            best = None
        found = run.match(_left_out(best, names), RELAXED["max_ratio"], alike and 2 * alike)
        models = run.map(RELAXED)
        best = max([best, *models], key=_registered)
    if not _enough(best, names):
        raise ReconstructionFailed(_advice(len(names), _registered(best), found, _groups(best, models)))
    straight = _adjust(pycolmap, best, max_size)
    (folder / "colmap" / "sparse" / "0").mkdir(parents=True)
    best.write(folder / "colmap" / "sparse" / "0")
    given = folder / "masks"
    masks = {path.relative_to(given).as_posix().removesuffix(".png"): path for path in given.rglob("*.png")}
    write_results(best, folder, names, max_size, set(best.cameras) if straight else set(), say, masks)


def _registered(model) -> int:
    return 0 if model is None else model.num_reg_images()


def _left_out(model, names) -> list[str]:
    inside = set() if model is None else {image.name for image in model.images.values() if image.has_pose}
    return [name for name in names if name not in inside]


def _enough(model, names) -> bool:
    return _registered(model) >= max(FEWEST_PHOTOGRAPHS, len(names) / 2)


@dataclass(frozen=True)
class _Run:
    """COLMAP's three steps on one database. cameras: the names that each camera took, None if every photograph has its own."""

    pycolmap: ModuleType
    folder: Path
    names: list[str]
    cameras: list[list[str]] | None
    seed: int
    threads: int
    say: Callable

    @property
    def database(self) -> Path:
        return self.folder / "database.db"

    def extract(self, peak, camera_model, features, feature_size):
        """Features of all photographs, in a new database."""
        self.database.unlink(missing_ok=True)
        options = self.pycolmap.FeatureExtractionOptions()
        options.num_threads = self.threads
        options.max_image_size = feature_size
        options.sift.max_num_features = features
        options.sift.peak_threshold = peak
        reader = self.pycolmap.ImageReaderOptions()
        reader.camera_model = camera_model
        if (self.folder / "masks").is_dir():
            reader.mask_path = self.folder / "masks"
        self.say(stage="features", count=0)
        done = 0
        for names in self.cameras or [self.names]:
            options.sift.first_octave = -1 if self._longest_side(names[0]) < UPSAMPLED else 0
            reader.existing_camera_id = -1
            for start in range(0, len(names), 4):
                self._read(names[start : start + 4], reader, options)
                self.say(count=done + min(start + 4, len(names)))
            done += len(names)

    def _read(self, names, reader, options):
        """Features of photographs of one camera, which ``reader`` knows from the second time on."""
        single = self.cameras is not None
        self.pycolmap.extract_features(
            self.database, self.folder / "photographs", image_names=names, reader_options=reader, extraction_options=options,
            camera_mode=self.pycolmap.CameraMode.SINGLE if single else self.pycolmap.CameraMode.PER_IMAGE,
            device=self.pycolmap.Device.cpu,
        )  # fmt: skip
        if single and reader.existing_camera_id < 0:
            with self.pycolmap.Database.open(self.database) as content:
                reader.existing_camera_id = max(camera.camera_id for camera in content.read_all_cameras())

    def _longest_side(self, name) -> int:
        with Image.open(self.folder / "photographs" / name) as image:
            return max(image.size)

    def match(self, names, max_ratio, alike=None) -> dict:
        """Match ``names`` anew, with all photographs or those that ``_unlike`` leaves; returns what the database holds."""
        with self.pycolmap.Database.open(self.database) as content:
            numbers = {image.name: image.image_id for image in content.read_all_images()}
            for a, b in itertools.product(names, self.names):
                if a != b and content.exists_matches(numbers[a], numbers[b]):
                    content.delete_matches(numbers[a], numbers[b])
                    content.delete_two_view_geometry(numbers[a], numbers[b])
            for a, b in self._unlike(content, numbers, alike) if alike else ():
                if not content.exists_matches(a, b):
                    content.write_matches(a, b, np.empty((0, 2), np.uint32))  # taken for matched, without success
                    content.write_two_view_geometry(a, b, self.pycolmap.TwoViewGeometry())
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
            _, inliers = content.read_two_view_geometry_num_inliers()  # pairs that were tried in vain are in there too
            return {"pairs": int(np.count_nonzero(inliers)), "features": features}

    def _unlike(self, content, numbers, alike: int) -> list[tuple[int, int]]:
        """Numbers of all pairs but neighbours and those that look alike."""
        from scene.colmap.retrieval import pairs_to_match

        seen = [np.asarray(content.read_descriptors(numbers[name]).data) for name in self.names]
        kept = set(pairs_to_match(seen, alike=alike, seed=self.seed))
        pairs = itertools.combinations(range(len(self.names)), 2)
        return [(numbers[self.names[i]], numbers[self.names[j]]) for i, j in pairs if (i, j) not in kept]

    def map(self, limits) -> list:
        """Models, the largest first."""
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
        return sorted(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), reverse=True)


def _groups(best, models) -> list[int]:
    """Sizes of further models that share no photograph with the best."""
    posed = lambda model: {image.name for image in model.images.values() if image.has_pose}
    taken, sizes = posed(best) if best else set(), []
    for names in map(posed, models):
        if not names & taken:
            sizes.append(len(names))
            taken = taken | names
    return sizes


def _advice(total: int, registered: int, found: dict, groups: list[int]) -> str:
    pairs = total * (total - 1) // 2
    if groups:
        sizes = ", ".join(map(str, groups))
        return (
            f"the photographs fall into groups of {registered}, {sizes} that show nothing in common: take some on the way "
            "from one to the other, or give one group alone"
        )
    return (
        f"only {registered} of {total} photographs could be joined ({found['pairs']} of {pairs} pairs show common "
        f"points, {found['features']:.0f} features in a photograph). What helps: {_help(registered, found, pairs)}"
    )


def _help(registered: int, found: dict, pairs: int) -> str:
    if found["features"] < FEATURELESS:
        return "things with texture on or around the objects, such as a newspaper under them, and sharp photographs"
    if not registered and found["pairs"] > pairs / 2:
        return "to walk around the scene: photographs taken from one place, however turned, do not say how far away things are"
    return (
        "neighbours that overlap by 60-80 %, in steps of at most 20 degrees around a still scene, sharp, with texture "
        "on or around the objects"
    )


def _adjust(pycolmap, model, max_size) -> bool:
    """Final bundle adjustment; returns whether the lens is straight, in which case the model says so too."""
    _bundle(pycolmap, model, lens=True)
    bends = max(bend(camera, max_size) for camera in model.cameras.values())
    if bends > 20 * STRAIGHT:
        return False
    bent = {number: camera.params.copy() for number, camera in model.cameras.items()}
    error = model.compute_mean_reprojection_error()
    drop_distortion(model)
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
