"""Strokes drawn on pictures, and the JSON files that hold them.

A stroke is kept raw, as drawn: never smoothed, never resampled. Its points are pixels of its view ((0, 0) is the
top-left corner of the picture; points outside the picture are allowed), its times seconds of a clock of its own.

    sketches = load("sketches/reach.json")          # list[Sketch]
    save("sketches/reach.json", sketches)           # load gives back every number exactly
    check(sketches)                                 # SketchError unless they can be seen in 3D

The file is ``{"schema": "scene2skill.sketches", "version": 1, "sketches": [...]}``; teach.schema.SCHEMA says all of it.
What it does not name is refused: a file is understood whole, or the error gives the path of what is wrong in it.
"""

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float

from scene.camera import Camera
from scene.files import replacing
from teach.curve import extent
from teach.schema import KINDS, MAX_POINTS, ORIENTATION, SCHEMA, validate

MAX_BYTES = 64 * 2**20
MAX_PIXEL = 1e6
MIN_RAY_ANGLE_DEG = 3.0
"""Below this angle a pixel of error along the stroke moves the point 20 pixels in depth: rays do not cross well."""


DOT, SHORT_PX = 0.1, 5.0
"""A stroke shorter than this share of its view's others is a slip of the pen; a drawing of fewer pixels may be one."""


class SketchError(ValueError):
    """Strokes that cannot be used; the message says which, why, and what to do."""


@dataclass(frozen=True)
class Event:
    """Something that happens at a moment: name such as "gripper_close", time [s] on the clock of the stroke or
    skill."""

    name: str
    time: float


@dataclass(frozen=True, eq=False)
class Stroke:
    """One line drawn on a view.

    points: (N, 2) [px]. times: (N,) [s], not decreasing (equal ones are allowed). demonstration: which repetition of
    the motion it draws. kind: "motion", "keep_out" for the outline of a region to avoid, or "arrow" for where the hand
    points, from its first point to its last. pressure: (N,) of the pen.
    pointer: the device, such as "mouse". Raises SketchError.
    """

    points: Float[np.ndarray, "N 2"]
    times: Float[np.ndarray, " N"]
    demonstration: int = 0
    kind: str = "motion"
    events: tuple[Event, ...] = ()
    pressure: Float[np.ndarray, " N"] | None = None
    pointer: str | None = None

    def __post_init__(self):
        points, times = _array(self.points, "points"), _array(self.times, "times")
        if points.ndim != 2 or points.shape[1] != 2 or times.shape != points.shape[:1]:
            raise SketchError(f"a stroke has points (N, 2) and times (N,), not {points.shape} and {times.shape}")
        if not 2 <= len(points) <= MAX_POINTS:
            raise SketchError(f"a stroke has {len(points)} point(s): it needs 2 to {MAX_POINTS}; draw it again")
        if np.abs(points).max() > MAX_PIXEL:
            raise SketchError(f"a stroke's point at {np.abs(points).max():.3g} px is not on any picture")
        if (np.diff(times) < 0).any():
            i = int(np.argmax(np.diff(times) < 0))
            raise SketchError(f"a stroke's times go backwards at point {i}, {times[i]:.6g} s to {times[i + 1]:.6g} s")
        if self.kind not in KINDS:
            raise SketchError(f"a stroke's kind is one of {', '.join(KINDS)}, not {self.kind!r}")
        if self.pressure is not None:
            pressure = _array(self.pressure, "pressure")
            if pressure.shape != times.shape:
                raise SketchError(f"a stroke of {len(times)} points has pressure ({len(times)},), not {pressure.shape}")
            object.__setattr__(self, "pressure", pressure)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "demonstration", int(self.demonstration))
        object.__setattr__(self, "events", tuple(self.events))

    @property
    def length(self) -> float:
        """Length of the line [px]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def duration(self) -> float:
        """Time it took to draw [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def arc_length(self) -> np.ndarray:
        """(N,) arc length at each point, from 0 to 1. Raises SketchError for a stroke that does not move."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        if along[-1] <= 0:
            raise SketchError(f"a stroke of {len(self.points)} points does not move: draw a line")
        return along / along[-1]

    def at(self, fractions) -> np.ndarray:
        """Points (..., 2) [px] at fractions (...,) in [0, 1] of the arc length, linear in between."""
        along = self.arc_length
        return np.stack([np.interp(fractions, along, self.points[:, axis]) for axis in range(2)], axis=-1)


@dataclass(frozen=True, eq=False)
class Sketch:
    """All strokes drawn on one view: its name, the camera that fitting uses, the strokes. orientation: how the hand is to be
    held, as teach.orientation has it, the same on all views; None: as it turns out. Raises SketchError."""

    view: str
    camera: Camera
    strokes: tuple[Stroke, ...]
    orientation: dict | None = None

    def __post_init__(self):
        if not isinstance(self.camera, Camera):
            raise SketchError(f"view {self.view!r} needs a scene.camera.Camera, not {type(self.camera).__name__}")
        K = self.camera.K
        if min(self.camera.width, self.camera.height) < 1 or min(K[0, 0], K[1, 1]) <= 0 or (K[2] != [0, 0, 1]).any():
            raise SketchError(f"view {self.view!r} has no usable intrinsics: focal lengths and sizes are positive")
        object.__setattr__(self, "strokes", tuple(self.strokes))
        if self.orientation is not None:
            object.__setattr__(self, "orientation", held(self.orientation))

    @property
    def motions(self) -> tuple[Stroke, ...]:
        """The strokes that draw the motion."""
        return tuple(stroke for stroke in self.strokes if stroke.kind == "motion")

    @property
    def outlines(self) -> tuple[Stroke, ...]:
        """The strokes that outline regions to keep out of."""
        return tuple(stroke for stroke in self.strokes if stroke.kind == "keep_out")

    @property
    def arrows(self) -> tuple[Stroke, ...]:
        """The strokes that say where the hand points."""
        return tuple(stroke for stroke in self.strokes if stroke.kind == "arrow")


def held(orientation: dict) -> dict:
    """What is said of the hand, checked (teach.orientation). Raises SketchError."""
    try:
        validate(orientation, ORIENTATION, "orientation")
    except ValueError as error:
        raise SketchError(str(error)) from None
    axis = orientation.get("axis")
    if axis is not None and orientation["kind"] != "along":
        raise SketchError(f"orientation: a hand that is held {orientation['kind']!r} has no axis")
    if axis is not None and not np.linalg.norm(axis) > 1e-9:
        raise SketchError("orientation.axis has no direction")
    return dict(orientation)


def check(sketches: Sequence[Sketch], surfaces: Collection[str] = ()) -> None:
    """Raise SketchError unless the motion is drawn on at least two views whose rays cross well, or on one of ``surfaces``.

    surfaces: names of the views whose depth picture is known, so that a motion may lie on the surface seen there.
    """
    drawn = [sketch for sketch in sketches if sketch.motions]
    for sketch in drawn:
        for number, stroke in enumerate(sketch.motions):
            if stroke.length <= 0:
                raise SketchError(f"stroke {number} on view {sketch.view!r} does not move: remove it or draw it again")
    names = sorted({sketch.view for sketch in drawn})
    if not drawn:
        raise SketchError("the motion is drawn on no view: depth needs strokes on two views from different sides")
    if len(drawn) == 1 and names[0] in surfaces:
        return
    if len(drawn) == 1:
        raise SketchError(
            f"the motion is drawn only on view {names[0]!r}: depth needs strokes on two views from different sides, or a "
            "depth picture of that view, which would let the motion be laid on the surface seen there"
        )
    if len(names) < len(drawn):
        raise SketchError(f"{len(drawn)} sketches share the views {names}: put all strokes of a view in one sketch")
    pairs = [(ray_angle(a, b), a, b) for a, b in combinations(drawn, 2)]
    angle, a, b = max(pairs, key=lambda pair: pair[0])
    if angle < MIN_RAY_ANGLE_DEG:
        baseline = np.linalg.norm(a.camera.centre - b.camera.centre)
        raise SketchError(
            f"the rays of views {a.view!r} and {b.view!r} never cross well: {angle:.2g} degrees (at least "
            f"{MIN_RAY_ANGLE_DEG:g} are needed), cameras {baseline:.3g} m apart; sketch on a view from another side"
        )
    for sketch in drawn:
        if not any(sketch.camera.contains(stroke.at(np.linspace(0, 1, 200))).any() for stroke in sketch.motions):
            raise SketchError(
                f"all that is drawn on view {sketch.view!r} lies outside its {sketch.camera.width}x{sketch.camera.height} "
                "picture: draw it on the picture, or give the camera of the picture that it was drawn on"
            )


def without_slips(sketches: Sequence[Sketch]) -> tuple[list[Sketch], list[str]]:
    """The sketches without motion strokes that are but dots beside the others of their view, and sentences on these and on
    views whose drawing is hardly longer than a dot."""
    kept, notes = [], []
    for sketch in sketches:
        extents = np.array([extent(stroke.points) for stroke in sketch.motions])
        slips = extents < DOT * np.median(extents) if len(extents) > 2 else extents < DOT * np.max(extents, initial=0.0)
        notes += [f"Stroke {k + 1} on view {sketch.view} is only {extents[k]:.0f} px long, a slip of the pen; it is left out."
                  for k in np.flatnonzero(slips)]  # fmt: skip
        if len(extents) and extents.max() < SHORT_PX:
            notes.append(f"What is drawn on view {sketch.view} is only {extents.max():.0f} px long: unless the motion runs "
                         "straight at that camera, draw it again.")  # fmt: skip
        left = iter(~slips)
        kept.append(replace(sketch, strokes=tuple(s for s in sketch.strokes if s.kind != "motion" or next(left))))
    return kept, notes


def ray_angle(a: Sketch, b: Sketch, count: int = 20) -> float:
    """Median angle [deg], 0 to 90, at which the rays of two views' mean strokes meet within the epipolar plane.

    0 where the cameras share their centre or the rays meet behind a camera, so where nothing can be triangulated.
    """
    fractions = np.linspace(0, 1, count)
    pixels = [np.mean([stroke.at(fractions) for stroke in sketch.motions], axis=0) for sketch in (a, b)]
    rays_a, rays_b = a.camera.rays(pixels[0])[1], b.camera.rays(pixels[1])[1]
    baseline = b.camera.centre - a.camera.centre
    if np.linalg.norm(baseline) <= 1e-9 * max(1.0, np.abs(a.camera.centre).max()):
        return 0.0
    along = baseline / np.linalg.norm(baseline)
    # In the epipolar plane the rays and the baseline form a triangle; it closes in front of both cameras if a < b.
    angles = [np.arccos(np.clip(rays @ along, -1, 1)) for rays in (rays_a, rays_b)]
    meeting = float(np.degrees(np.median(angles[1] - angles[0])))
    return max(0.0, min(meeting, 180.0 - meeting))


def load(path) -> list[Sketch]:
    """Read a sketch file. Raises FileNotFoundError, or SketchError naming the path of what is wrong inside the file."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no sketch file {path}")
    if path.stat().st_size > MAX_BYTES:
        raise SketchError(f"{path}: a sketch file has at most {MAX_BYTES // 2**20} MB")
    try:
        return loads(path.read_bytes())
    except SketchError as error:
        raise SketchError(f"{path}: {error}") from None


def save(path, sketches: Sequence[Sketch]) -> None:
    """Write a sketch file, whole or not at all; every number is read back exactly."""
    text = dumps(sketches)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def loads(text: str | bytes) -> list[Sketch]:
    """The sketches that the JSON ``text`` (SCHEMA) describes. Raises SketchError."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SketchError(f"not a JSON file ({error})") from None
    _require(document)
    return [_sketch(sketch, f"sketches[{i}]") for i, sketch in enumerate(document["sketches"])]


def dumps(sketches: Sequence[Sketch]) -> str:
    """JSON text (SCHEMA) from which ``loads`` gives the sketches back."""
    document = {"schema": "scene2skill.sketches", "version": 1, "sketches": [_plain(sketch) for sketch in sketches]}
    _require(document)
    return json.dumps(document, allow_nan=False)


def _require(document) -> None:
    try:
        validate(document, SCHEMA)
    except ValueError as error:
        raise SketchError(str(error)) from None


def _plain(sketch: Sketch) -> dict:
    said = {} if sketch.orientation is None else {"orientation": sketch.orientation}
    return {
        "view": sketch.view,
        "camera": sketch.camera.plain(),
        **said,
        "strokes": [_plain_stroke(stroke) for stroke in sketch.strokes],
    }


def _plain_stroke(stroke: Stroke) -> dict:
    plain = {
        "points": stroke.points.tolist(),
        "times": stroke.times.tolist(),
        "demonstration": stroke.demonstration,
        "kind": stroke.kind,
        "events": [{"name": event.name, "time": float(event.time)} for event in stroke.events],
        "pressure": None if stroke.pressure is None else stroke.pressure.tolist(),
        "pointer": stroke.pointer,
    }
    return {key: value for key, value in plain.items() if value is not None}


def _sketch(plain: dict, where: str) -> Sketch:
    try:
        camera = Camera(**plain["camera"])
    except ValueError as error:
        raise SketchError(f"{where}.camera: {error}") from None
    strokes = []
    for i, stroke in enumerate(plain["strokes"]):
        try:
            strokes.append(Stroke(**{**stroke, "events": tuple(Event(**event) for event in stroke.get("events", ()))}))
        except SketchError as error:
            raise SketchError(f"{where}.strokes[{i}]: {error}") from None
    return Sketch(plain["view"], camera, tuple(strokes), plain.get("orientation"))


def _array(values, name: str) -> np.ndarray:
    """A read-only array of finite floats."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise SketchError(f"a stroke's {name} must be an array of numbers") from None
    if not np.isfinite(array).all():
        first = np.argwhere(~np.isfinite(array))[0][0]
        raise SketchError(f"a stroke's {name} hold NaN or infinite numbers (first at point {first})")
    array.setflags(write=False)
    return array
