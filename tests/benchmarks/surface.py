"""How near a reconstruction is to the true world: depth, mesh, free space, and planning among its pieces.

    python tests/benchmarks/surface.py data/table                  a capture of a simulated world, after `python -m scene.mesh`
    python tests/benchmarks/surface.py data/table --motions 100    with planning: joint motions from home to places of the workspace

Truth is the world's own file. A surface counts as seen where three photographs see it. A motion is refused where the arm comes nearer
than the planner's margin to anything; it is missed where the reconstruction lets it pass though it touches something.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import open3d as o3d
import trimesh
from scipy.spatial.transform import Rotation

from conf.scene_stages import split
from robot.arm import Arm, NoSolution
from robot.collision import WORLD, CollisionModel
from robot.obstacles import on_the_arm, reconstructed
from robot.world import World
from robot.variation import varied
from scene.dataset import load_views
from scene.field import Field
from scene.surface import Mesh
from scene.surface.depth import confidence
from scene.surface.space import FREE, Space

NEAR = 0.01  # m, of the F-score
MARGIN = 0.01  # m, of the planner


def parts(spec):
    """The world's things as meshes."""
    for thing in spec["objects"]:
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("xyz", thing.get("rpy_deg", [0, 0, 0]), degrees=True).as_matrix()
        pose[:3, 3] = thing["position"]
        box = thing["shape"] == "box"
        made = trimesh.creation.box(thing["size"]) if box else trimesh.creation.cylinder(thing["radius"], thing["height"], sections=48)
        yield made.apply_transform(pose)


def scene_of(meshes):
    scene = o3d.t.geometry.RaycastingScene()
    for mesh in meshes:
        scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    return scene


def distance(scene, points):
    return scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()


def deepest(meshes, points):
    """Signed distance [m] to the union of solids: negative inside."""
    signed = [scene_of([m]).compute_signed_distance(o3d.core.Tensor(points.astype(np.float32))).numpy() for m in meshes]
    return np.min(signed, axis=0)


def true_depth(scene, camera):
    origins, directions = camera.rays(camera.pixel_centres())
    rays = np.concatenate([origins, directions], -1).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return np.where(np.isfinite(hit), hit * (directions @ camera.forward), np.nan)


def depth_table(field, views, truth):
    error, sure = [], []
    for view in views:
        camera = view.camera.resized(320, 240)
        _, depth = field.render(camera)
        true = true_depth(truth, camera)
        there = np.isfinite(true)
        error.append(np.nan_to_num(np.abs(depth - true)[there], nan=np.inf))
        sure.append(confidence(field, camera, depth)[there])
    error, sure = 1000 * np.concatenate(error), np.concatenate(sure)
    print("| depth, held-out views | share of pixels | median [mm] | below 15 mm |\n|---|---|---|---|")
    for least in (0.0, 0.5, 0.7, 0.9):
        some = error[sure >= least]
        print(f"| confidence from {least:g} | {len(some) / len(error):.3f} | {np.median(some):.1f} | {(some < 15).mean():.3f} |")


def mesh_table(mesh, meshes, cameras, truth, spec):
    points = np.concatenate([trimesh.sample.sample_surface(m, max(2000, int(60_000 * m.area)), seed=1)[0] for m in meshes])
    seen = np.zeros(len(points), int)
    for camera in cameras:
        depth, pixels = true_depth(truth, camera), camera.project(points)
        there = np.flatnonzero(camera.contains(pixels))
        column, row = np.minimum(pixels[there].astype(int), [camera.width - 1, camera.height - 1]).T
        seen[there] += np.abs(camera.depth(points[there]) - depth[row, column]) < 0.01
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    samples, _ = trimesh.sample.sample_surface(made, 200_000, seed=2)
    box = [np.array(spec["workspace"][side]) for side in ("lower", "upper")]
    inside = lambda p: ((p > box[0]) & (p < box[1])).all(1)
    print(f"| mesh, within {1000 * NEAR:.0f} mm | precision | recall of seen surfaces | F |\n|---|---|---|---|")
    for name, own, true in (("all", np.ones(len(samples), bool), seen >= 3), ("workspace", inside(samples), (seen >= 3) & inside(points))):
        precision = (distance(truth, samples[own]) < NEAR).mean()
        recall = (distance(scene_of([made]), points[true]) < NEAR).mean()
        print(f"| {name} | {precision:.3f} | {recall:.3f} | {2 * precision * recall / (precision + recall):.3f} |")


def space_table(space, meshes, capture):
    free = space.centres()[space.labels == FREE]
    inside = deepest(meshes, free)
    print(f"space: {(space.labels == FREE).mean():.2f} free, {(space.labels == 0).mean():.2f} unseen; of {len(free)} free voxels of "
          f"{1000 * space.voxel:.0f} mm {(inside < 0).sum()} have their centre in something, {(inside < -0.01).sum()} deeper than 10 mm")  # fmt: skip
    pieces = [trimesh.load(path, process=False) for path in sorted((capture / "collision").glob("*.obj"))]
    surface = np.concatenate([trimesh.sample.sample_surface(p, 1000, seed=0)[0] for p in pieces])
    beyond = 1000 * np.maximum(deepest(meshes, surface), 0)
    print(f"{len(pieces)} convex pieces; their surfaces lie {np.median(beyond):.1f} mm (median), {np.percentile(beyond, 95):.1f} mm (95 %) outside of things")


def motions(arm, count, spec, seed=0):
    """Joint paths from home over a raised place to a random one in the workspace, within the arm's reach."""
    rng, lower, upper = np.random.default_rng(seed), *(np.array(spec["workspace"][side]) for side in ("lower", "upper"))
    home = arm.fk(arm.home)
    while count:
        target = rng.uniform(lower, upper)
        raised = (home[:3, 3] + target) / 2 + rng.normal(0, 0.06, 3) + [0, 0, 0.08]
        if not 0.3 < np.linalg.norm(target) < 0.8:
            continue
        try:
            path = [arm.home]
            for place in (raised, target):
                pose = home.copy()
                pose[:3, 3] = place
                path.append(arm.ik(pose, start=path[-1], position_only=True))
        except NoSolution:
            continue
        legs = [np.linspace(a, b, 25) for a, b in zip(path, path[1:])]
        yield np.concatenate(legs)
        count -= 1


def clearance(model, path):
    """Least clearance [m] to the world on the way."""
    distance, _ = model.measure(path)
    return float(distance[:, WORLD].min())


def planning_table(capture, space, spec, count):
    arm = Arm.load("panda")
    around = on_the_arm(arm, arm.home)
    outcome = np.zeros((3, 2), int)  # truth: touches, nearer than the margin, clear; reconstruction: refuses, lets pass
    with World.from_spec(spec, textured=False) as world:
        true_model = CollisionModel(arm, world)
        for path in motions(arm, count, spec):
            true = clearance(true_model, path)
            known = reconstructed(capture, space, arm.fk(path)[:, :3, 3], around)
            with World.from_spec(known, textured=False) as rebuilt:
                found = clearance(CollisionModel(arm, rebuilt), path)
            outcome[0 if true < 0 else 1 if true < MARGIN else 2, int(found >= MARGIN)] += 1
            if (true < 0) == (found >= MARGIN):
                print(f"  truth {1000 * true:.0f} mm, reconstruction {1000 * found:.0f} mm")
    print("| in truth | motions | refused | let pass |\n|---|---|---|---|")
    for name, (refused, passed) in zip(("touches something", f"nearer than {1000 * MARGIN:.0f} mm", "clear"), outcome):
        print(f"| {name} | {refused + passed} | {refused} | {passed} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture folder of a simulated world with mesh.ply, collision and space.npz")
    parser.add_argument("--motions", type=int, default=0)
    options = parser.parse_args()
    spec = varied(json.loads((options.capture / "truth.json").read_text())["world"])
    meshes = list(parts(spec))
    truth, views, space = scene_of(meshes), load_views(options.capture), Space.load(options.capture / "space.npz")
    depth_table(Field.load(options.capture / "field.pt"), split(views)[1], truth)
    mesh_table(Mesh.load(options.capture / "mesh.ply"), meshes, [v.camera.resized(320, 240) for v in views], truth, spec)
    space_table(space, meshes, options.capture)
    if options.motions:
        planning_table(options.capture, space, spec, options.motions)


if __name__ == "__main__":
    main()
