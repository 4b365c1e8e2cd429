"""Surfaces: the same for the same seed, different for each object, full of points that photographs are matched on."""

import cv2
import numpy as np
import pytest

from robot import skins, textures, thing, worldfile
from robot.world import skin

KINDS = sorted(textures.PAINTERS)
SCALE = 450.0  # px per metre


def painted(kind, seed=0, height=135, width=180):
    return textures.paint(kind, np.random.default_rng(seed), height, width, SCALE, [180, 140, 90])


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_one_picture_and_another_seed_another(kind):
    first = painted(kind)
    assert first.shape == (135, 180, 3) and first.dtype == np.uint8
    np.testing.assert_array_equal(first, painted(kind))
    assert (first != painted(kind, seed=1)).mean() > 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_every_surface_has_features_that_photographs_are_matched_on(kind):
    """At least one SIFT feature in 6 cm by 6 cm, on 40 cm by 30 cm of the surface."""
    found = cv2.SIFT_create(contrastThreshold=0.02).detect(cv2.cvtColor(painted(kind), cv2.COLOR_RGB2GRAY), None)
    assert len(found) >= 33


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(1, 1), (2, 300), (300, 2), (9, 9)])
def test_the_narrowest_faces_are_painted_too(kind, size):
    assert painted(kind, height=size[0], width=size[1]).shape[2] == 3


def test_an_unknown_kind_is_told_which_there_are():
    with pytest.raises(ValueError, match="marble.*wood"):
        textures.paint("marble", np.random.default_rng(0), 10, 10, SCALE, [1, 2, 3])


def test_every_kind_that_a_world_may_name_can_be_painted():
    assert set(thing.TEXTURES) <= set(textures.PAINTERS)


def test_each_object_of_the_table_has_a_look_of_its_own():
    spec = worldfile.read("table")
    looks = [skin(one, "table")[1] for one in spec["objects"] if one["name"].startswith("leg")]
    assert len(looks) == 4 and all((a != b).any() for i, a in enumerate(looks) for b in looks[:i])


def faces_of(obj):
    """Vertices (V, 3), picture places (V, 2), triangles (F, 3) of an OBJ text."""
    rows = [line.split() for line in obj.splitlines()]
    vertices, uvs = (np.array([[float(x) for x in r[1:]] for r in rows if r[0] == key]) for key in ("v", "vt"))
    return vertices, uvs, np.array([[int(c.split("/")[0]) - 1 for c in r[1:]] for r in rows if r[0] == "f"])


def test_a_box_is_closed_faces_outwards_and_has_its_size():
    vertices, _, triangles = faces_of(skins.box([0.2, 0.3, 0.4], "wood", np.random.default_rng(0), [180, 140, 90])[0])
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    np.testing.assert_allclose(
        np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6, 0.2 * 0.3 * 0.4
    )  # volume, by divergence
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0).all()


def test_a_cylinder_has_nearly_its_volume():
    vertices, _, triangles = faces_of(skins.cylinder(0.12, 0.03, "label", np.random.default_rng(0), [180, 40, 40])[0])
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    np.testing.assert_allclose(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6, np.pi * 0.03**2 * 0.12, rtol=0.01)


def test_all_faces_of_a_box_are_painted_at_one_scale():
    """Pixels per metre along the edges of every triangle."""
    obj, atlas = skins.box([0.2, 0.3, 0.4], "wood", np.random.default_rng(0), [180, 140, 90])
    vertices, uvs, triangles = faces_of(obj)
    a, b = triangles[:, 0], triangles[:, 1]
    metres = np.linalg.norm(vertices[a] - vertices[b], axis=1)
    pixels = np.linalg.norm((uvs[a] - uvs[b]) * [atlas.shape[1], atlas.shape[0]], axis=1)
    np.testing.assert_allclose(pixels / metres, SCALE, rtol=0.02)


def test_a_tag_has_a_white_border_around_a_black_square_of_its_size():
    obj, _ = skins.tag(3, 0.12)
    vertices, _, _ = faces_of(obj)
    np.testing.assert_allclose(np.ptp(vertices[:, :2], axis=0), 0.15)  # ten cells, of which the black square has eight
    cells = skins.tag_cells(3)
    assert (cells[0] == 255).all() and (cells[1, 1:-1] == 0).all() and set(np.unique(cells)) == {0, 255}


def test_a_tag_beyond_the_family_is_refused():
    with pytest.raises(ValueError, match="587"):
        skins.tag_cells(587)
