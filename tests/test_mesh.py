"""scene/surface/, on a field whose surfaces are known exactly."""

import numpy as np
import open3d as o3d
import pytest
import trimesh
from scipy.spatial import ConvexHull

from scene.camera import Camera, look_at
from scene.field import Marched, Rays
from scene.surface import Mesh, build, cleaned, drawn, fuse
from scene.surface.space import FREE, OCCUPIED, UNSEEN, Space

BOX, TOP = trimesh.creation.box([0.3, 0.3, 0.2]), trimesh.creation.box([1.2, 1.2, 0.04])
BOX.apply_translation([0, 0, 0.1])
TOP.apply_translation([0, 0, -0.02])
EYES = [(1.1 * np.cos(a), 1.1 * np.sin(a), z) for a in np.linspace(0, 5.5, 8) for z in (0.7, 1.2)]
CAMERAS = {f"{i}": Camera.from_fov(look_at(eye, (0, 0, 0.05)), 160, 120, 60) for i, eye in enumerate(EYES)}


class Solid:
    """A field of solids in front of nothing, each of a colour: its surfaces are a tenth of a millimetre thick."""

    centre, half = np.array([0.0, 0.0, 0.1]), 0.7

    def __init__(self, *solids):
        self.scene = o3d.t.geometry.RaycastingScene()
        for solid in solids:
            self.scene.add_triangles(np.asarray(solid.vertices, np.float32), np.asarray(solid.faces, np.uint32))
        self.rendered = 0

    def hit(self, origins, directions):
        rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], -1).astype(np.float32)
        found = self.scene.cast_rays(o3d.core.Tensor(rays))
        return found["t_hit"].numpy(), found["geometry_ids"].numpy()

    def render(self, camera):
        self.rendered += 1
        origins, directions = camera.rays(camera.pixel_centres())
        t, which = self.hit(origins, directions)
        image = np.where(which[..., None] == 0, np.uint8([200, 40, 40]), np.uint8([40, 40, 200]))
        return image, np.where(np.isfinite(t), t * (directions @ camera.forward), np.nan).astype(np.float32)

    def rays(self, origins, directions):
        return Rays(np.asarray(origins) / self.half, directions, np.zeros(len(directions)))

    def march(self, rays, far):
        t, _ = self.hit(rays.origins * self.half, rays.directions)
        optical = lambda s: np.log(2) * np.exp(np.clip((s * self.half - t) / 1e-4, -50, 50))
        return Marched(None, np.exp(optical(rays.near) - optical(far)), None, ())


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    return build(Solid(BOX, TOP), CAMERAS, tmp_path_factory.mktemp("depths"), width=160, voxel=0.01)


def distance(solids, points):
    scene = o3d.t.geometry.RaycastingScene()
    for solid in solids:
        scene.add_triangles(np.asarray(solid.vertices, np.float32), np.asarray(solid.faces, np.uint32))
    return scene.compute_distance(o3d.core.Tensor(np.asarray(points, np.float32))).numpy()


def test_the_mesh_lies_where_the_surfaces_are_and_has_their_colours(surface):
    mesh = surface.mesh
    assert np.percentile(distance([BOX, TOP], mesh.vertices), 95) < 0.006
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    seen = np.stack(np.meshgrid(np.linspace(-0.12, 0.12, 9), np.linspace(-0.12, 0.12, 9), [0.2]), -1).reshape(-1, 3)
    assert np.median(distance([made], seen)) < 0.001 and distance([made], seen).max() < 0.003  # half a pixel is 4 mm here
    on_box = mesh.vertices[:, 2] > 0.05
    assert np.median(mesh.colours[on_box], axis=0)[0] > 150 and np.median(mesh.colours[~on_box], axis=0)[2] > 150


def test_faces_look_at_the_cameras(surface):
    a, b, c = (surface.mesh.vertices[surface.mesh.faces[:, k]] for k in range(3))
    level = (np.abs(a[:, 2] - 0.2) < 0.01) & (np.abs(a[:, :2]).max(1) < 0.12)
    assert (np.cross(b - a, c - a)[level, 2] > 0).all()


def test_no_surface_is_made_where_no_camera_has_looked(surface):
    assert surface.mesh.vertices[:, 2].min() > -0.06  # the top's underside is unseen
    assert not (np.abs(surface.mesh.vertices - [0, 0, 0.0]) < [0.1, 0.1, 0.02]).all(1).any()  # so is what the box stands on


def test_space_knows_free_occupied_and_unseen(surface):
    status = lambda *point: surface.space.status(np.array(point))
    assert status(0.3, 0.0, 0.2) == FREE and status(0, 0, 0.5) == FREE
    assert status(0, 0, 0.1) == UNSEEN and status(0, 0, -0.2) == UNSEEN
    assert surface.space.status(surface.mesh.vertices).min() == OCCUPIED


def test_pieces_hold_the_solids_and_little_else(surface):
    points = np.random.default_rng(0).uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 0.4], (4000, 3))
    hulls = [ConvexHull(vertices).equations for vertices, _ in surface.pieces]
    inside = np.any([(points @ h[:, :3].T + h[:, 3] < 0).all(1) for h in hulls], axis=0)
    in_box = (np.abs(points - [0, 0, 0.1]) < [0.14, 0.14, 0.09]).all(1)
    clear = distance([BOX, TOP], points) > 0.025
    assert inside[in_box].mean() > 0.95 and inside[clear & ~in_box].mean() < 0.01


def test_everything_is_saved_and_read_again(surface, tmp_path):
    surface.save(tmp_path)
    mesh, space = Mesh.load(tmp_path / "mesh.ply"), Space.load(tmp_path / "space.npz")
    np.testing.assert_allclose(mesh.vertices, surface.mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(mesh.colours, surface.mesh.colours)
    np.testing.assert_array_equal(space.labels, surface.space.labels)
    files = sorted((tmp_path / "collision").glob("*.obj"))
    assert len(files) == len(surface.pieces)
    assert trimesh.load(files[0], process=False).is_watertight


def test_a_killed_job_renders_only_what_is_missing(tmp_path):
    two = dict(list(CAMERAS.items())[:4])
    first, again = Solid(BOX, TOP), Solid(BOX, TOP)
    build(first, two, tmp_path, width=80, voxel=0.02)
    (tmp_path / "2.npz").unlink()
    build(again, two, tmp_path, width=80, voxel=0.02)
    assert (first.rendered, again.rendered) == (4, 1)


def test_small_floating_parts_go_and_the_largest_stays():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01).apply_translation([0, 0, 1.0])
    both = trimesh.util.concatenate([BOX, ball])
    mesh = Mesh(np.array(both.vertices), np.array(both.faces), np.zeros((len(both.vertices), 3), np.uint8))
    assert cleaned(mesh, 0.05).vertices[:, 2].max() < 0.5
    assert len(cleaned(mesh, 5.0).vertices) == len(BOX.vertices)


def test_a_field_that_shows_nothing_is_refused():
    camera = CAMERAS["0"]
    image, nothing = np.zeros((120, 160, 3), np.uint8), np.full((120, 160), np.inf)
    with pytest.raises(ValueError, match="no surface that 2 of 2 cameras are sure of"):
        fuse([camera] * 2, [image] * 2, [nothing] * 2, 0.01)


def test_the_picture_shows_the_mesh_before_nothing(surface):
    picture = drawn(surface.mesh, CAMERAS["3"])
    assert (picture[0, 0] == 250).all()
    u, v = CAMERAS["3"].project([0, 0, 0.2]).astype(int)
    assert picture[v, u, 0] > 2 * picture[v, u, 2]


def test_a_file_that_is_no_mesh_is_refused(tmp_path):
    (tmp_path / "mesh.ply").write_text("hello")
    with pytest.raises(ValueError, match="not a readable mesh"):
        Mesh.load(tmp_path / "mesh.ply")
    with pytest.raises(FileNotFoundError, match="no mesh"):
        Mesh.load(tmp_path / "other.ply")
