"""Contacts: where a stroke says that the motion touches the scene, it passes a point of the scene's surface.

An event named "contact" on a stroke marks a pixel p at a common time t. Of each view the mean pixel of its strokes is
laid on the surface (depth.py); views that mark the same moment are combined by information:

    x(p) = o + z(p) d(p)                 d = R K^-1 (p, 1), z(p) the depth at which that ray meets the surface's plane
    C_v = J S_p J^T + s_z^2 d d^T        J = dx / dp, S_p covariance [px^2] of the mean pixel, s_z that of depth [m]
    C^-1 = sum_v C_v^-1                  x = C sum_v C_v^-1 x_v
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scene.camera import Camera
from teach.depth import ERROR, surface_points
from teach.sketch import Sketch, SketchError
from teach.trajectory import TrajectoryDistribution

CONTACT = "contact"
"""Name of the event."""
APART = 0.08
"""Contacts are different ones if nothing is marked for longer than this normalised time."""
HAND = 0.01
"""Standard deviation of a single stroke's contact in its picture, of the picture's width."""
FAR = 0.03
"""Views that see a contact further apart than this share of its depth see different things."""


@dataclass(frozen=True, eq=False)
class Contact:
    """A via point on the surface.

    time: in [0, 1]. point: (3,) [m]. covariance: (3, 3) [m^2]. views: the points (3,) [m] that each of them shows.
    """

    time: float
    point: np.ndarray
    covariance: np.ndarray
    views: dict[str, np.ndarray]

    def plain(self) -> dict:
        """What a report says of it."""
        deviation = np.sqrt(np.diag(self.covariance)).tolist()
        return {"time": self.time, "point_m": self.point.tolist(), "deviation_m": deviation, "views": list(self.views)}


def touch(distribution: TrajectoryDistribution, found: Sequence[Contact]) -> TrajectoryDistribution:
    """The motions that touch the surface: their mean meets each contact, their spread there is how well it is known.

    The mean is met exactly since strokes that agree with each other may yet all end beside the surface; then their
    small covariance would outweigh the contact's.
    """
    if not found:
        return distribution
    times, points = [contact.time for contact in found], np.stack([contact.point for contact in found])
    spread = distribution.condition(times, points, np.stack([contact.covariance for contact in found]))
    return replace(spread, mean=distribution.condition(times, points).mean)


def contacts(drawn: Sequence[Sketch], times, depths: Mapping[str, np.ndarray]) -> list[Contact]:
    """The contacts marked on views of which ``depths`` has a picture (h, w) [m], in order of time.

    times: of the motion strokes' points, from align.common_times. Raises SketchError where the surface is unseen.
    """
    marks = sorted(_marks(drawn, times, depths), key=lambda mark: mark[0])
    if not marks:
        return []
    breaks = np.flatnonzero(np.diff([t for t, _, _ in marks]) > APART) + 1
    groups = [marks[a:b] for a, b in zip([0, *breaks], [*breaks, len(marks)], strict=True)]
    return [_contact(group, {sketch.view: sketch.camera for sketch in drawn}, depths) for group in groups]


def warnings(drawn: Sequence[Sketch], found: Sequence[Contact], depths: Mapping[str, np.ndarray]) -> list[str]:
    """Sentences on contacts that are not brought to a surface, and on views that do not agree where one is."""
    marked = [s.view for s in drawn if any(event.name == CONTACT for stroke in s.motions for event in stroke.events)]
    sentences = [
        f"Contacts marked on view {view} are not brought to the surface: its depth picture is missing."
        for view in marked
        if view not in depths
    ]
    for contact in found:
        points = np.stack(list(contact.views.values()))
        gap = np.linalg.norm(points - points[0], axis=1).max()
        if gap > FAR * min(s.camera.depth(contact.point) for s in drawn if s.view in contact.views):
            sentences.append(
                f"The contact at {contact.time:.0%} of the motion lies {100 * gap:.0f} cm apart on the surfaces that "
                f"views {', '.join(contact.views)} show; mark it where both see the same thing."
            )
    return sentences


def _marks(drawn, times, depths) -> list[tuple[float, str, np.ndarray]]:
    """(common time, view, pixel (2,)) of each contact that is marked on a view with depth."""
    return [
        (
            float(np.interp(event.time, stroke.times, at)),
            sketch.view,
            np.array([np.interp(event.time, stroke.times, stroke.points[:, axis]) for axis in range(2)]),
        )
        for sketch, view in zip(drawn, times, strict=True)
        if sketch.view in depths
        for stroke, at in zip(sketch.motions, view, strict=True)
        for event in stroke.events
        if event.name == CONTACT
    ]


def _contact(group, cameras: Mapping[str, Camera], depths) -> Contact:
    """One contact from the marks that all views made of it."""
    views = sorted({view for _, view, _ in group})
    pixels = [np.stack([p for _, v, p in group if v == view]) for view in views]
    touched = [_touched(view, cameras[view], depths[view], p) for view, p in zip(views, pixels, strict=True)]
    points, covariances = zip(*touched, strict=True)
    information = np.linalg.inv(covariances)
    covariance = np.linalg.inv(information.sum(axis=0))
    point = covariance @ np.einsum("vab,vb->a", information, points)
    return Contact(float(np.median([t for t, _, _ in group])), point, covariance, dict(zip(views, points, strict=True)))


def _touched(view: str, camera: Camera, depth, pixels) -> tuple[np.ndarray, np.ndarray]:
    """The surface's point (3,) [m] at the mean of pixels (n, 2), and how well it is known, (3, 3) [m^2]."""
    mean, n = pixels.mean(axis=0), len(pixels)
    points, normals, seen = surface_points(camera, depth, mean[None])
    if not seen[0]:
        raise SketchError(
            f"the contact marked on view {view!r} (pixel {mean[0]:.0f}, {mean[1]:.0f}) has no surface in its depth "
            "picture: mark it on a surface that is seen there"
        )
    drawn = ((pixels - mean) ** 2).sum() / (2 * (n - 1)) if n > 1 else (HAND * camera.width) ** 2
    back = camera.world_from_camera[:3, :3] @ np.linalg.inv(camera.K)
    z, ray, normal = camera.depth(points[0]), back @ np.append(mean, 1.0), normals[0]
    J = z * (back[:, :2] - np.outer(ray, normal @ back[:, :2]) / (normal @ ray))
    return points[0], max(drawn, 1.0) / n * J @ J.T + (ERROR * z) ** 2 * np.outer(ray, ray)
