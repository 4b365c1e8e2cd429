import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from scene.surface.pieces import convex_pieces


def grid(low, high, step):
    axes = [np.arange(a + step / 2, b, step) for a, b in zip(low, high)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def made(mesh, forbidden, smallest=0.05):
    fine = mesh.subdivide_to_size(0.04)
    return fine, convex_pieces(np.array(fine.vertices), np.array(fine.faces), forbidden, 0.005, smallest)


def depth(pieces, points):
    """How deep points lie in the union of pieces [m], negative outside."""
    hulls = [ConvexHull(v).equations for v, _ in pieces]
    return np.max([-(points @ h[:, :3].T + h[:, 3]).max(axis=1) for h in hulls], axis=0)


def test_a_convex_body_stays_one_piece():
    box = trimesh.creation.box([0.3, 0.2, 0.4])
    free = grid([-0.4] * 3, [0.4] * 3, 0.02)
    free = free[(np.abs(free) > [0.16, 0.11, 0.21]).any(1)]
    _, pieces = made(box, free)
    (vertices, faces), = pieces
    hull = trimesh.Trimesh(vertices, faces, process=False)
    assert hull.is_watertight and hull.volume == pytest.approx(box.volume, rel=1e-6)  # anticlockwise: the volume is positive


def test_pieces_cover_an_angle_and_leave_the_free_space_in_it_free():
    wall, shelf = trimesh.creation.box([0.04, 0.4, 0.4]), trimesh.creation.box([0.4, 0.4, 0.04])
    shelf.apply_translation([0.2, 0, -0.18])
    angle = trimesh.util.concatenate([wall, shelf])
    free = grid([0.04, -0.2, -0.14], [0.4, 0.2, 0.2], 0.02)
    fine, pieces = made(angle, free)
    assert depth(pieces, free).max() <= 0
    assert depth(pieces, np.array(fine.vertices)).min() > -1e-9
    assert 2 <= len(pieces) <= 6


def test_what_cannot_be_cut_apart_ends_at_the_smallest_extent():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    inside = grid([-0.09] * 3, [0.09] * 3, 0.02)
    _, pieces = made(ball, inside, smallest=0.06)
    assert all(np.ptp(v, axis=0).max() < 0.13 for v, _ in pieces)
    assert depth(pieces, np.array(ball.vertices)).min() > -1e-9
