"""The report's pictures. Each function draws one figure from arrays and returns it; nothing is read or written here."""

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

TIME_COLOURS = "viridis"
INK = "#d1242f"
KEEP_OUT = "#0969da"
MUTED = "#8c959f"
AXES = ("x", "y", "z")


def photographs_and_cameras(views, points, colours, count: int = 8) -> Figure:
    """A few photographs, and where all of them were taken around the sparse points."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[1.9, 1])
    shown = [views[i] for i in np.linspace(0, len(views) - 1, min(count, len(views))).astype(int)]
    axes = left.subplots(-(-len(shown) // 4), 4, squeeze=False).ravel()
    for axis in axes:
        axis.axis("off")
    for axis, view in zip(axes, shown, strict=False):
        axis.imshow(view.image)
        axis.set_title(view.name, fontsize=7)
    scene = _scene_axes(right, points, colours)
    for view in views:
        _draw_camera(scene, view.camera)
    centres = np.stack([view.camera.centre for view in views])
    _fit_limits(scene, centres, margin=0.3 * np.ptp(centres, axis=0).max())
    return figure


def beside(photograph, rendered, depth) -> Figure:
    """A held-out photograph beside what the field shows there, and its depth."""
    figure = Figure(figsize=(11, 2.9), layout="constrained")
    axes = figure.subplots(1, 3)
    for axis, image, title in zip(axes, (photograph, rendered), ("held-out photograph", "rendered by the field")):
        axis.imshow(image)
        axis.set_title(title, fontsize=9)
    near, far = np.nanpercentile(depth, [2, 98])
    shown = axes[2].imshow(depth, cmap="magma_r", vmin=near, vmax=far)
    axes[2].set_title("rendered depth", fontsize=9)
    figure.colorbar(shown, ax=axes[2], shrink=0.8)
    for axis in axes:
        axis.axis("off")
    return figure


def sketches(pages) -> Figure:
    """Strokes on the pictures they were drawn on, outlines of keep-out regions dashed. pages: (title, image, strokes,
    outlines) each, lines as (N, 2) px."""
    figure, axes = _row(len(pages))
    for axis, (title, image, strokes, outlines) in zip(axes, pages):
        _picture(axis, image, title)
        _outline(axis, outlines)
        for stroke in strokes:
            axis.plot(*stroke.T, color=INK, linewidth=1.6)
            axis.plot(*stroke[0], "o", color="white", markeredgecolor=INK, markersize=5)
    return figure


def densities(pages) -> Figure:
    """p(x, y) of each view with the time axis collapsed. pages: (title, image, density (H, W)) each."""
    figure, axes = _row(len(pages))
    for axis, (title, image, density) in zip(axes, pages):
        _picture(axis, image // 2 + 100, title)
        strength = density / density.max()
        axis.imshow(strength, cmap="magma", alpha=np.sqrt(strength), extent=(0, image.shape[1], image.shape[0], 0))
    return figure


def trajectories_3d(mean, samples, points, colours, performed=None, regions=()) -> Figure:
    """Samples and mean (n, T, 3), (T, 3) in the scene, from two sides; the performed path beside them, and the edges
    (E, 2, 3) of keep-out regions."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    for part, azimuth in zip(figure.subfigures(1, 2), (-60, 30)):
        scene = _scene_axes(part, points, colours)
        for sample in samples:
            scene.plot(*sample.T, color=INK, alpha=0.3, linewidth=0.8)
        scene.scatter(*mean.T, c=np.linspace(0, 1, len(mean)), cmap=TIME_COLOURS, s=8, depthshade=False)
        if performed is not None:
            scene.plot(*performed.T, color="black", linewidth=1.4, label="performed")
            scene.legend(fontsize=8)
        for edges in regions:
            scene.add_collection3d(Line3DCollection(edges, colors=KEEP_OUT, linewidths=0.6, alpha=0.5))
        scene.view_init(22, azimuth)
        _fit_limits(scene, np.concatenate([samples.reshape(-1, 3), mean]), margin=0.2)
    return figure


def overlay(pages, performed) -> Figure:
    """Samples, mean and the performed path seen by each view, over the strokes drawn there. pages: (title, image, mean, samples, strokes);
    performed: (T, 2) [px] of each view, nothing where nothing was performed."""
    figure, axes = _row(len(pages))
    for axis, (title, image, mean, samples, strokes), path in zip(axes, pages, performed or [None] * len(pages)):
        _picture(axis, image, title)
        for stroke in strokes:
            axis.plot(*stroke.T, color="white", linewidth=1.0, linestyle=":")
        for sample in samples:
            axis.plot(*sample.T, color=INK, linewidth=0.8, alpha=0.6)
        axis.scatter(*mean.T, c=np.linspace(0, 1, len(mean)), cmap=TIME_COLOURS, s=6)
        if path is not None:
            axis.plot(*path.T, color="white", linewidth=3.2)
            axis.plot(*path.T, color="black", linewidth=1.6)
    return figure


def overview(drawn, learned, performed) -> Figure:
    """The idea in one row: strokes on two views, the motion in a third, the robot. drawn: (title, image, strokes,
    outlines) each; learned: (title, image, mean, samples, strokes); performed: the last picture of the film, or None."""
    figure, axes = _row(len(drawn) + 1 + (performed is not None))
    for axis, (_, image, strokes, outlines) in zip(axes, drawn):
        _picture(axis, image, "sketched")
        _outline(axis, outlines)
        for stroke in strokes:
            axis.plot(*stroke.T, color=INK, linewidth=1.6)
    _, image, mean, samples, _ = learned
    _picture(axes[len(drawn)], image, "learned")
    for sample in samples:
        axes[len(drawn)].plot(*sample.T, color=INK, linewidth=0.8, alpha=0.6)
    axes[len(drawn)].scatter(*mean.T, c=np.linspace(0, 1, len(mean)), cmap=TIME_COLOURS, s=5)
    if performed is not None:
        _picture(axes[-1], performed, "performed")
    return figure


def over_time(times, mean, deviation, samples) -> Figure:
    """x, y, z over normalised time with two standard deviations. times: (T,), mean: (T, 3), deviation: (T, 3) [m]."""
    figure = Figure(figsize=(11, 2.8), layout="constrained")
    for i, axis in enumerate(figure.subplots(1, 3)):
        axis.fill_between(times, mean[:, i] - 2 * deviation[:, i], mean[:, i] + 2 * deviation[:, i], color="#ffebe9")
        axis.plot(times, samples[..., i].T, color=INK, linewidth=0.6, alpha=0.5)
        axis.plot(times, mean[:, i], color="black", linewidth=1.6)
        axis.plot(0, samples[0, 0, i], "s", color="black", markersize=5)
        axis.set_xlabel("t")
        axis.set_title(f"{AXES[i]} [m]", fontsize=9)
    return figure


def quality(report: dict) -> Figure:
    """Uncertainty of the mean, spread and ray angle over normalised time; the weakest stretch is shaded. report: teach.quality's."""
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    t = np.linspace(0, 1, len(report["uncertainty_mm"]))
    left.plot(t, report["uncertainty_mm"], color="black", label="of the mean")
    left.plot(t, report["deviation_mm"], color=MUTED, label="of demonstrations")
    left.set_title("standard deviation [mm]", fontsize=9)
    left.legend(fontsize=8)
    right.plot(t, report["angle_deg"], color="black")
    right.set_title("angle between rays [deg]", fontsize=9)
    right.set_ylim(0, 95)
    left.set_ylim(0, None)
    weak = report["weakest"]
    for axis in (left, right):
        axis.set_xlabel("t")
        if weak and weak.get("clear", True):  # earlier files have a stretch only where it is clear
            axis.axvspan(weak["from"], weak["to"], color="#ffebe9")
    return figure


def checks(plan, execution=None) -> Figure:
    """Clearance and errors over time, against nothing below zero and 5 mm."""
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(plan.times, 1000 * plan.clearance, color="black")
    left.axhline(0, color=INK, linewidth=0.8)
    left.set_title("clearance of the arm [mm]", fontsize=9)
    right.plot(plan.times, 1000 * plan.position_error, color=MUTED, label="planned path against the sampled one")
    if execution is not None:
        right.plot(execution.times, 1000 * execution.tip_error, color="black", label="performed against planned")
    right.set_title("error of the hand's position [mm]", fontsize=9)
    right.legend(fontsize=8)
    for axis in (left, right):
        axis.set_xlabel("time [s]")
    return figure


def filmstrip(frames, times) -> Figure:
    """Pictures (F, H, W, 3) of a performance, each with its time [s]."""
    figure, axes = _row(len(frames))
    for axis, frame, time in zip(axes, frames, times):
        _picture(axis, frame, f"{time:.1f} s")
    return figure


def _row(count: int):
    figure = Figure(figsize=(11, 11 / count * 0.75 + 0.35), layout="constrained")
    return figure, figure.subplots(1, count, squeeze=False)[0]


def _picture(axis, image, title: str) -> None:
    axis.imshow(image, extent=(0, image.shape[1], image.shape[0], 0))
    axis.set_xlim(0, image.shape[1])
    axis.set_ylim(image.shape[0], 0)
    axis.set_title(title, fontsize=9)
    axis.axis("off")


def _outline(axis, outlines) -> None:
    for line in outlines:
        axis.plot(*np.vstack([line, line[:1]]).T, color=KEEP_OUT, linewidth=1.6, linestyle="--")


def _scene_axes(part, points, colours, most: int = 4000):
    axis = part.add_subplot(projection="3d")
    if len(points):
        keep = np.linspace(0, len(points) - 1, min(most, len(points))).astype(int)
        axis.scatter(*points[keep].T, c=colours[keep] / 255.0, s=1, depthshade=False)
    axis.set(xlabel="x", ylabel="y", zlabel="z")
    axis.tick_params(labelsize=6)
    return axis


def _fit_limits(axis, points, margin: float = 0.0) -> None:
    """Equal scales around the bulk of the points; a few stray ones do not shrink the picture."""
    lower, upper = np.percentile(points, [2, 98], axis=0)
    middle, half = (lower + upper) / 2, (upper - lower).max() / 2 + margin
    axis.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half], zlim=middle[2] + [-half, half])
    axis.set_box_aspect((1, 1, 1))


def _draw_camera(axis, camera, size: float = 0.06) -> None:
    corners = np.array([[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height], [0, 0]])
    origins, directions = camera.rays(corners)
    depth = size * np.linalg.norm(camera.centre) if np.linalg.norm(camera.centre) else size
    outline = origins + directions * depth
    axis.plot(*outline.T, color=INK, linewidth=0.5)
    for corner in outline[:4]:
        axis.plot(*np.stack([camera.centre, corner]).T, color=INK, linewidth=0.4)
