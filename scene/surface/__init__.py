"""A trained field -> a mesh, convex pieces of it for a simulator, and what of space is free, occupied, unseen.

    depth with confidence from the photographs' cameras (scene.surface.depth) ─ TSDF fusion ─ cleaned mesh ─ convex pieces
                                                                      └ rays carve space (scene.surface.space)

Fusion averages the signed distance to all depths within a truncation (Curless, Levoy 1996). Only depth of which the
field is sure goes in, a surface must be seen by two cameras, and none is made where no camera has looked: holes stay
holes.

Metres, the frame of the cameras. Open3D is imported here only, and late.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scene.camera import Camera
from scene.files import replacing
from scene.surface import depth as depths
from scene.surface.pieces import convex_pieces
from scene.surface.space import FREE, Space, carve

TRUNCATION = 4.0  # voxels
SIMPLE = 10_000
"""Faces of the mesh that convex pieces are made of."""
NOTHING = 0.5
"""A ray that meets no surface is taken to pass if at least this share of its light does."""
LIGHT = np.array([0.3, -0.45, 0.84])


@dataclass(frozen=True, eq=False)
class Mesh:
    """vertices (V, 3) [m], faces (F, 3), anticlockwise from outside, colours (V, 3) uint8."""

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray

    def save(self, path: str | Path) -> None:
        """Write a ply file, whole or not at all."""
        import trimesh

        with replacing(path) as temporary:
            made = trimesh.Trimesh(self.vertices, self.faces, vertex_colors=self.colours, process=False)
            made.export(temporary, "ply")

    @classmethod
    def load(cls, path: str | Path) -> "Mesh":
        """Read what ``save`` wrote. Raises FileNotFoundError, or ValueError for a file that is no mesh."""
        import trimesh

        if not Path(path).is_file():
            raise FileNotFoundError(f"no mesh {path}: python -m scene.mesh makes it from a trained field")
        try:
            mesh = trimesh.load(path, file_type="ply", process=False)
            colours = np.asarray(mesh.visual.vertex_colors)[:, :3]
            return cls(np.array(mesh.vertices, dtype=float), np.array(mesh.faces), np.array(colours, dtype=np.uint8))
        except Exception as error:  # a parser of foreign files may fail in any way
            raise ValueError(f"{path} is not a readable mesh: {error}") from error


@dataclass(frozen=True, eq=False)
class Surface:
    """What `build` found. pieces: convex meshes (vertices (V, 3), faces (F, 3)) whose union covers the mesh."""

    mesh: Mesh
    pieces: tuple[tuple[np.ndarray, np.ndarray], ...]
    space: Space

    def save(self, folder: str | Path) -> None:
        """Write mesh.ply, collision/piece000.obj, ... and space.npz."""
        folder = Path(folder)
        self.mesh.save(folder / "mesh.ply")
        for i, (vertices, faces) in enumerate(self.pieces):
            rows = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
            with replacing(folder / "collision" / f"piece{i:03d}.obj") as temporary:
                temporary.write_text("\n".join([*rows, ""]), encoding="ascii")
        self.space.save(folder / "space.npz")


def build(
    field,
    cameras: Mapping[str, Camera],
    folder: str | Path,
    *,
    width: int = 320,
    voxel: float | None = None,
    confidence: float = 0.5,
    views: int = 2,
    smallest: float = 0.05,
    coarse: float = 2.5,
    concavity: float = 0.01,
    progress=None,
) -> Surface:
    """The surface that a field (scene.field.Field) shows to the photographs' cameras, by name. Depth pictures are kept
    in ``folder``: a killed job goes on from there.

    width [px]: of the depth pictures. voxel [m]: of fusion; None: 1/128 of half the field's box. confidence: depth
    below it is left out. views: cameras that must have seen a surface, and must look through what is free. smallest
    [m]: pieces of surface of less than a square of this edge are taken for dirt. coarse: edge of the voxels of space,
    in those of fusion. concavity [m]: how deep convex pieces may reach into free space. Raises ValueError where the
    field shows no surface. """
    voxel = field.half / 128 if voxel is None else voxel
    small = [camera.resized(width, round(camera.height * width / camera.width)) for camera in cameras.values()]
    files = [Path(folder) / f"{name}.npz" for name in cameras]
    seen = [_seen(field, camera, file, confidence) for camera, file in (progress or iter)(list(zip(small, files)))]
    pictures, measured = zip(*seen)
    mesh = cleaned(fuse(small, pictures, measured, voxel, views), smallest)
    corners = field.centre - field.half, field.centre + field.half
    space = carve(small, measured, mesh.vertices, *corners, coarse * voxel, views)
    return Surface(mesh, pieces(mesh, space, concavity, voxel), space)


def _seen(field, camera: Camera, path: Path, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture (h, w, 3) and depth (h, w) [m along z]: nan where the field is not sure, inf where it shows nothing."""
    if not path.is_file():
        image, depth, sure = depths.render(field, camera)
        known = np.where(sure >= least, depth, np.nan)
        known[depths.passes(field, camera, depth) > NOTHING] = np.inf
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, image=image, depth=known.astype(np.float32))
    with np.load(path, allow_pickle=False) as file:
        return file["image"], file["depth"]


def fuse(
    cameras: Sequence[Camera], images: Sequence[np.ndarray], measured: Sequence[np.ndarray], voxel: float, views: int = 2
) -> Mesh:
    """TSDF fusion of pictures (h, w, 3) uint8 with depth (h, w) [m along z; nan, inf: none] to a mesh of ``voxel`` [m].

    views: cameras that must have seen a voxel beside the surface. Raises ValueError where there is nothing to fuse.
    """
    o3d = _open3d()
    core = o3d.core
    attributes = ("tsdf", "weight", "color"), (core.float32,) * 3, ((1,), (1,), (3,))
    grid = o3d.t.geometry.VoxelBlockGrid(*attributes, voxel, 16, 10_000, core.Device("CPU:0"))
    for camera, image, depth in zip(cameras, images, measured, strict=True):
        known = np.where(np.isfinite(depth), depth, 0).astype(np.float32)
        if not known.any():
            continue
        shown = o3d.t.geometry.Image(core.Tensor(known))
        coloured = o3d.t.geometry.Image(core.Tensor(image.astype(np.float32) / 255))
        K = core.Tensor(np.array(camera.K))  # Open3D rounds pixels down, so they begin at their corners, as here
        pose, farthest = core.Tensor(np.ascontiguousarray(camera.camera_from_world)), float(known.max()) + 1
        blocks = grid.compute_unique_block_coordinates(shown, K, pose, 1.0, farthest, TRUNCATION)
        grid.integrate(blocks, shown, coloured, K, K, pose, 1.0, farthest, TRUNCATION)
    none = grid.hashmap().size() == 0
    made = o3d.geometry.TriangleMesh() if none else grid.extract_triangle_mesh(float(views)).to_legacy()
    if not len(made.triangles):
        raise ValueError(
            f"the field shows no surface that {views} of {len(cameras)} cameras are sure of: train it longer, or lower "
            "scene.surface.confidence"
        )
    colours = np.clip(np.asarray(made.vertex_colors) * 255 + 0.5, 0, 255).astype(np.uint8)
    return Mesh(np.array(made.vertices), np.array(made.triangles), colours)


def cleaned(mesh: Mesh, smallest: float) -> Mesh:
    """The mesh without connected parts of less area than a square of edge ``smallest`` [m]; the largest part always
    stays."""
    made = _open3d_mesh(mesh)
    part, _, area = (np.asarray(v) for v in made.cluster_connected_triangles())
    faces = mesh.faces[area[part] >= min(smallest**2, area.max())]
    kept, inverse = np.unique(faces, return_inverse=True)
    return Mesh(mesh.vertices[kept], inverse.reshape(-1, 3), mesh.colours[kept])


def pieces(mesh: Mesh, space: Space, concavity: float, voxel: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Convex meshes that cover the mesh and nothing of free space that is further than ``concavity`` [m] from it."""
    from scipy.spatial import cKDTree

    simple = _open3d_mesh(mesh).simplify_quadric_decimation(SIMPLE)
    simple.remove_unreferenced_vertices()
    free = space.centres()[space.labels == FREE]
    away, _ = cKDTree(mesh.vertices).query(free, distance_upper_bound=concavity)
    vertices, faces = np.asarray(simple.vertices), np.asarray(simple.triangles)
    return convex_pieces(vertices, faces, free[away > concavity], voxel, 3 * space.voxel)


def _open3d_mesh(mesh: Mesh):
    o3d = _open3d()
    return o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces))


def _open3d():
    try:
        import open3d
    except (ImportError, OSError) as error:
        needed = "sudo apt-get install libusb-1.0-0 libgl1 libegl1 libx11-6 libidn2-0"
        raise OSError(f"Open3D, which makes the mesh, cannot be loaded: {error}; on Debian: {needed}") from error
    return open3d


def drawn(mesh: Mesh, camera: Camera, background=(250, 250, 250)) -> np.ndarray:
    """A picture (h, w, 3) uint8 of the mesh in its colours, half lit from above so that its shape shows."""
    o3d = _open3d()
    core = o3d.core
    origins, directions = camera.rays(camera.pixel_centres())
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(core.Tensor(mesh.vertices.astype(np.float32)), core.Tensor(mesh.faces.astype(np.uint32)))
    hit = scene.cast_rays(core.Tensor(np.concatenate([origins, directions], -1).astype(np.float32)))
    there = np.isfinite(hit["t_hit"].numpy())
    corners, uv = mesh.faces[hit["primitive_ids"].numpy()[there].astype(int)], hit["primitive_uvs"].numpy()[there]
    weights = np.stack([1 - uv.sum(-1), *uv.T], -1)
    lit = 0.6 + 0.45 * np.abs(hit["primitive_normals"].numpy()[there] @ LIGHT)
    picture = np.tile(np.array(background, np.uint8), (*there.shape, 1))
    colour = (mesh.colours[corners] * weights[..., None]).sum(1) * lit[:, None]
    picture[there] = np.clip(colour, 0, 255).astype(np.uint8)
    return picture
