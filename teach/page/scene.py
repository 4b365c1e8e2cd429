"""What is drawn on: the views of a scene, as files and cameras."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scene.camera import Camera
from teach.page.solid import Solid


@dataclass(frozen=True, eq=False)
class Picture:
    """A view of the scene: its picture's file and its camera. kind: "rendered" or "photograph"."""

    path: Path
    camera: Camera
    kind: str


@dataclass(frozen=True, eq=False)
class Scene:
    """What is drawn on. views: by name. points: (N, 3) [m] and colours (N, 3) uint8. unit: of lengths. surfaces: views whose
    depth is known. target: (3,) where one looks. mesh: makes the scene's surface when it is first looked at; None: there is none."""

    title: str
    views: Mapping[str, Picture]
    points: np.ndarray
    colours: np.ndarray
    unit: str = "m"
    surfaces: tuple[str, ...] = ()
    target: tuple[float, ...] = (0.0, 0.0, 0.0)
    mesh: Callable[[], Solid] | None = None
