"""What a lens does to pixels, and pinholes in its place. ``camera`` is a pycolmap.Camera everywhere."""

import numpy as np

STRAIGHT = 0.1
"""A lens that moves no pixel by more than this [px] is taken for a pinhole, and its pictures are kept as they are."""


def drop_distortion(model) -> None:
    """Make every lens of a pycolmap.Reconstruction straight."""
    for camera in model.cameras.values():
        params = camera.params.copy()
        params[list(camera.extra_params_idxs())] = 0
        camera.params = params


def pinhole(camera) -> np.ndarray:
    """K (3, 3) of a COLMAP camera without its distortion."""
    rows = [camera.focal_length_x, 0, camera.principal_point_x], [0, camera.focal_length_y, camera.principal_point_y]
    return np.array([*rows, [0, 0, 1]])


def bend(camera, max_size) -> float:
    """How far the lens moves a pixel at most [px of the undistorted picture]."""
    grid = np.meshgrid(np.linspace(0, camera.width, 41), np.linspace(0, camera.height, 41))
    pixels = np.stack(grid, axis=-1).reshape(-1, 2)
    moved = through_lens(camera, pinhole(camera), pixels) - pixels
    return float(np.linalg.norm(moved, axis=1).max()) * min(1, max_size / max(camera.width, camera.height))


def through_lens(camera, K, pixels) -> np.ndarray:
    """Where the lens puts what a pinhole K sees at pixels (N, 2)."""
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(K).T
    return np.asarray(camera.img_from_cam(rays))


def widest_pinhole(camera) -> np.ndarray:
    """K (3, 3) of the widest pinhole of the same size all of whose pixels the photograph has seen."""
    K, width, height = pinhole(camera), camera.width, camera.height
    u, v = np.linspace(0, width, 65), np.linspace(0, height, 65)
    sides = (u, 0.0), (u, float(height)), (0.0, v), (float(width), v)
    edge = np.concatenate([np.stack(np.broadcast_arrays(*side), axis=1) for side in sides])
    low, high = 0.5, 2.0
    for _ in range(40):
        zoom = (low + high) / 2
        seen = through_lens(camera, K * [[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]], edge)
        inside = np.isfinite(seen).all() and (seen >= 0).all() and (seen <= [width, height]).all()
        low, high = (low, zoom) if inside else (zoom, high)
    return K * [[high, 1, 1], [1, high, 1], [1, 1, 1]]
