"""Two points with a known distance, and gravity: metres and an up from nothing but a tape measure.

    distance.json    {"distance": 0.5, "from": PLACE, "to": PLACE,
                      "origin": PLACE, "origin_in_base": [0, 0, 0], "forward": PLACE}     the last three may be left out

    PLACE            {"pixels": {"0003": [412.5, 200.0], "0017": [88.0, 310.5]}}   pixels of the same physical point in
                     two or more photographs as they were taken (upright; (0, 0) is the top left corner), or
                     {"point": 123}   a point of the model: the row of sparse.ply, from 0

The frame is the robot's if ``origin`` (whose place in the robot's base is ``origin_in_base`` [m]) and ``forward`` (a
point beyond it in the direction of the base's x axis, at any height) are given; else it is level and in metres, no
more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scene.camera import Camera
from scene.colmap import straighten
from scene.files import parse_json
from scene.frame import gravity
from scene.frame.similarity import Similarity, judged
from scene.frame.triangulation import triangulate
from scene.model import Model, ReconstructionFailed

CLICK = 0.005
"""A pixel further than this part of the picture's width from where the other pictures put its point is left out."""
LEAST_NOISE_PX, TAPE_M = 0.5, 5e-4
"""What a person's pixels and tape measure are off by at least, when the frame's uncertainty is told."""


@dataclass(frozen=True, eq=False)
class Ruler:
    """What distance.json says. Places are {photograph: (2,) px} or a point's row (int)."""

    distance: float
    start: Mapping[str, np.ndarray] | int
    end: Mapping[str, np.ndarray] | int
    origin: Mapping[str, np.ndarray] | int | None = None
    forward: Mapping[str, np.ndarray] | int | None = None
    origin_in_base: np.ndarray = (0.0, 0.0, 0.0)

    def __post_init__(self):
        if not (np.isfinite(self.distance) and self.distance > 0):
            raise ValueError(f"distance must be a positive length in metres, not {self.distance}")
        if self.forward is not None and self.origin is None:
            raise ValueError("forward needs an origin, from which it is seen")
        base = np.array(self.origin_in_base, dtype=float)
        if base.shape != (3,) or not np.isfinite(base).all():
            raise ValueError("origin_in_base must be three numbers in metres")
        object.__setattr__(self, "origin_in_base", base)

    @property
    def places(self) -> dict:
        """The places by their names in the file."""
        named = {"from": self.start, "to": self.end, "origin": self.origin, "forward": self.forward}
        return {name: place for name, place in named.items() if place is not None}

    @classmethod
    def load(cls, path: str | Path) -> "Ruler":
        """Read distance.json."""
        return parse_json(path, "file of a distance", cls._parsed)

    @classmethod
    def _parsed(cls, content) -> "Ruler":
        known = {"distance", "from", "to", "origin", "origin_in_base", "forward"}
        unknown = ", ".join(sorted(content.keys() - known))
        if unknown:
            raise ValueError(f"unknown {unknown}; there are {', '.join(sorted(known))}")
        optional = {key: _place(key, content[key]) for key in ("origin", "forward") if key in content}
        ends = _place("from", content["from"]), _place("to", content["to"])
        optional["origin_in_base"] = content.get("origin_in_base", (0, 0, 0))
        return cls(float(content["distance"]), *ends, **optional)


def _place(name: str, place):
    if set(place) == {"point"} and isinstance(place["point"], int) and place["point"] >= 0:
        return place["point"]
    if set(place) != {"pixels"}:
        raise ValueError(name + ': a place is {"pixels": {photograph: [u, v], ...}} or {"point": row of sparse.ply}')
    pixels = {Path(photograph).stem: np.array(pixel, dtype=float) for photograph, pixel in place["pixels"].items()}
    if len(pixels) < 2 or any(p.shape != (2,) or not np.isfinite(p).all() for p in pixels.values()):
        raise ValueError(f"{name}: a place needs a pixel [u, v] in two photographs at least, better in four")
    return pixels


def align(model: Model, ruler: Ruler) -> Similarity:
    """The similarity from the model's frame to a level one in metres: the robot's, if origin and forward are known."""
    clicked = {name: place for name, place in ruler.places.items() if not isinstance(place, int)}
    photographs = sorted({photograph for place in clicked.values() for photograph in place})
    asked = {p: [name for name in clicked if p in clicked[name]] for p in photographs}
    straight = straighten(model, {p: [clicked[name][p] for name in asked[p]] for p in photographs}) if asked else {}
    pixels = {name: {p: straight[p][asked[p].index(name)] for p in clicked[name]} for name in clicked}
    changed = {"start": "from", "end": "to", "origin": "origin", "forward": "forward"}
    ruler = replace(ruler, **{field: pixels[name] for field, name in changed.items() if name in pixels})
    return fit_frame(ruler, model.names, model.cameras, model.points, model.point_errors)


def fit_frame(
    ruler: Ruler, names: Sequence[str], cameras: Sequence[Camera], points: np.ndarray, point_errors: np.ndarray
) -> Similarity:
    """``align`` on pixels of the cameras ``names``, not bent by a lens. point_errors: (N,) [px] of points (N, 3)."""
    by_name = dict(zip(names, cameras, strict=True))
    found = {}
    for name, place in ruler.places.items():
        if isinstance(place, int):
            found[name] = _model_point(place, name, cameras, points, point_errors)
        else:
            found[name] = _clicked(place, name, by_name)
    a, b = found["from"], found["to"]
    length = float(np.linalg.norm(b.x - a.x))
    if not length > 0:
        raise ReconstructionFailed("from and to are the same point: their distance gives no scale")
    along = (b.x - a.x) / length
    unsure = np.hypot(np.sqrt(along @ (a.covariance + b.covariance) @ along) / length, TAPE_M / ruler.distance)  # of 1
    scale = ruler.distance / length
    rotation, origin = _level(found, gravity.up(cameras, points), cameras, points)
    translation = ruler.origin_in_base - scale * rotation @ origin
    known = "forward" in found
    place = "z is up and lengths are metres, but origin and heading are not the robot's: say origin and forward"
    views = [f"{photograph} of {name}" for name in found for photograph in found[name].left_out]
    wrong = (f"left out, as the pixel lies off the others': {', '.join(views)}",) if views else ()
    similarity = Similarity(
        scale, rotation, translation, "robot base" if known else "level",
        rests_on=f"a distance of {1000 * ruler.distance:.0f} mm between two points, with up by gravity",
        residual_mm=1000 * scale * float(np.sqrt(np.mean([p.residual**2 for p in found.values()]))),
        residuals_mm={name: 1000 * scale * p.residual for name, p in found.items()}, used=tuple(found),
        warnings=wrong + (() if known else (place,)), extra={"scale_uncertainty": float(unsure)},
    )  # fmt: skip
    reach = scale * np.sqrt(np.mean([((camera.centre - origin) ** 2).sum() for camera in cameras]))
    place_off = scale * _unsure_place(found, rotation, reach / scale)
    return judged(similarity, 1000 * float(np.hypot(unsure * reach, place_off)))


@dataclass(frozen=True, eq=False)
class _Point:
    """x: (3,) in the model; covariance: (3, 3); residual: rms distance of its rays; left_out: who disagrees."""

    x: np.ndarray
    covariance: np.ndarray
    residual: float
    left_out: tuple[str, ...] = ()


def _clicked(place: Mapping[str, np.ndarray], name: str, by_name: Mapping[str, Camera]) -> _Point:
    photographs = list(place)
    cameras, pixels = [by_name[p] for p in photographs], np.array([place[p] for p in photographs])
    x, agree = triangulate(pixels, cameras, threshold=max(2.0, CLICK * cameras[0].width))
    if not np.isfinite(x).all():
        raise ReconstructionFailed(
            f"distance.json, {name}: the pixels of {', '.join(photographs)} do not belong to one point; click the same "
            "spot in all of them"
        )
    inside = [camera for camera, agrees in zip(cameras, agree) if agrees]
    errors = np.array([camera.project(x) for camera in inside]) - pixels[agree]
    J = np.concatenate([camera.jacobian(x) for camera in inside])
    noise = max(float(np.sqrt((errors**2).mean())), LEAST_NOISE_PX)
    metres_per_px = np.array([camera.depth(x) / camera.K[0, 0] for camera in inside])
    covariance = noise**2 * np.linalg.pinv(J.T @ J, rcond=1e-14)
    residual = float(np.sqrt(((errors**2).sum(axis=1) * metres_per_px**2).mean()))
    return _Point(x, covariance, residual, tuple(p for p, agrees in zip(photographs, agree) if not agrees))


def _model_point(row: int, name: str, cameras, points, point_errors) -> _Point:
    if row >= len(points):
        raise ValueError(f"distance.json, {name}: there is no point {row}; the model has {len(points)}")
    seen = [camera for camera in cameras if camera.contains(camera.project(points[row]))] or list(cameras)
    residual = float(point_errors[row] * np.median([abs(c.depth(points[row])) / c.K[0, 0] for c in seen]))
    return _Point(points[row], residual**2 * np.eye(3), residual)


def _unsure_place(found: Mapping[str, _Point], rotation: np.ndarray, reach: float) -> float:
    """Standard deviation of a camera at ``reach`` from the origin by place and heading, all in the model's unit."""
    if "origin" not in found:
        return 0.0
    origin = found["origin"]
    if "forward" not in found:
        return float(np.sqrt(np.trace(origin.covariance)))
    ahead, across = rotation[0] @ (found["forward"].x - origin.x), rotation[1]
    heading = across @ (origin.covariance + found["forward"].covariance) @ across / ahead**2  # [rad^2]
    return float(np.sqrt(np.trace(origin.covariance) + heading * reach**2))


def _level(found: Mapping[str, _Point], up: np.ndarray, cameras, points) -> tuple[np.ndarray, np.ndarray]:
    """(level_from_model (3, 3), the model's point (3,) that becomes the origin)."""
    if "origin" not in found:
        return gravity.level(up, cameras[0]), gravity.middle(cameras, points)
    origin = found["origin"].x
    if "forward" not in found:
        return gravity.level(up, cameras[0]), origin
    ahead = found["forward"].x - origin
    if np.linalg.norm(np.cross(ahead, up)) < 0.05 * np.linalg.norm(ahead) or not np.any(ahead):
        raise ReconstructionFailed("distance.json: forward lies straight above or below the origin: no direction")
    return gravity.level(up, cameras[0], ahead), origin
