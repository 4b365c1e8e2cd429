"""World: the simulated world that a YAML file describes, in a PyBullet client of its own.

    with World.load("table") as world:
        picture = world.photograph(camera)

Frame: metres, z up, the robot's base. Collision shapes are primitives; skins are textured meshes (skins.py).
"""

import tempfile
import zlib
from pathlib import Path

import cv2
import numpy as np

from robot import skins, worldfile
from robot.bullet import connect, pybullet
from scene.camera import OPENCV_FROM_OPENGL, Camera, invert

NEAR, FAR = 0.05, 30.0  # m
SUPERSAMPLING = 2  # TinyRenderer does not smooth edges: twice the pixels, averaged
HALF_PIXEL = 0.5 / SUPERSAMPLING  # TinyRenderer samples pixels at their lower left corner, not at their centre
LIGHT = {"lightDirection": [2.0, -3.0, 6.0], "lightColor": [1, 1, 1], "lightAmbientCoeff": 0.62, "lightDiffuseCoeff": 0.45,
         "lightSpecularCoeff": 0.0}  # fmt: skip
HINGE = 0.05  # m, how far from its middle a hinge is held
EDGE = 0.03  # share of the depth; samples of a pixel further apart than this lie on different surfaces
BACKDROP = (226, 228, 230)


class World:
    """Bodies by name, a PyBullet client, and a camera. Use it in a ``with`` statement, or call ``close``.

    spec: the data of the world's file, varied under its seed. client: BulletClient. bodies: {name: body id}.
    """

    def __init__(self, spec: dict, *, textured: bool = True):
        worldfile.check(spec)
        self.spec = worldfile.varied(spec)
        self.client = connect()
        self.client.setGravity(0, 0, -9.81)
        self.bodies: dict[str, int] = {}
        self._textured = textured
        try:
            with tempfile.TemporaryDirectory() as folder:
                self._build(Path(folder))
        except BaseException:
            self.close()
            raise

    @classmethod
    def load(cls, name_or_path, seed: int | None = None, **options) -> "World":
        """A world that comes with the project, by name, or the path of a YAML file. Raises FileNotFoundError, ValueError."""
        spec = worldfile.read(name_or_path)
        return cls(spec if seed is None else spec | {"seed": seed}, **options)

    @classmethod
    def from_spec(cls, spec: dict, **options) -> "World":
        """A world from the data that its file holds."""
        return cls(spec, **options)

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_):
        self.close()

    def close(self) -> None:
        if self.client.isConnected():
            self.client.disconnect()

    # Building

    def _build(self, folder: Path) -> None:
        for thing in self.spec["objects"]:
            self.bodies[thing["name"]] = self._add(thing, folder)
        for joint in self.spec.get("joints", []):
            self._join(joint)
        for tag in self.spec.get("tags", []) if self._textured else []:
            self._lay_tag(tag, folder)

    def _add(self, thing: dict, folder: Path) -> int:
        quat_xyzw = pybullet.getQuaternionFromEuler(np.radians(thing.get("rpy_deg", [0, 0, 0])))
        visual, picture = self._skin(thing, folder) if self._textured else (-1, None)
        body = self.client.createMultiBody(
            baseMass=thing.get("mass", 0),
            baseCollisionShapeIndex=self._collision_shape(thing),
            baseVisualShapeIndex=visual,
            basePosition=thing["position"],
            baseOrientation=quat_xyzw,
        )
        self.client.changeDynamics(body, -1, lateralFriction=thing.get("friction", 0.7))
        if picture:
            self.client.changeVisualShape(body, -1, textureUniqueId=self.client.loadTexture(picture))
        return body

    def _collision_shape(self, thing: dict) -> int:
        if thing["shape"] == "box":
            return self.client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[length / 2 for length in thing["size"]])
        if thing["shape"] == "cylinder":
            return self.client.createCollisionShape(pybullet.GEOM_CYLINDER, radius=thing["radius"], height=thing["height"])
        return self.client.createCollisionShape(pybullet.GEOM_MESH, fileName=str(thing["file"]))

    def _skin(self, thing: dict, folder: Path) -> tuple[int, str | None]:
        if thing["shape"] == "mesh":
            colour = [c / 255 for c in thing.get("colour", [180, 180, 180])] + [1]
            return self.client.createVisualShape(pybullet.GEOM_MESH, fileName=str(thing["file"]), rgbaColor=colour), None
        mesh, picture = skins.save(folder, thing["name"], *skin(thing, self.spec["name"]))
        return self.client.createVisualShape(pybullet.GEOM_MESH, fileName=mesh, rgbaColor=[1, 1, 1, 1]), picture

    def _lay_tag(self, tag: dict, folder: Path) -> None:
        """A quad a millimetre above what it lies on; it is seen and never touched."""
        mesh, picture = skins.save(folder, f"tag{tag['id']}", *skins.tag(tag["id"], tag["size"]))
        pose = tag_pose(tag)
        visual = self.client.createVisualShape(pybullet.GEOM_MESH, fileName=mesh, rgbaColor=[1, 1, 1, 1])
        quat_xyzw = pybullet.getQuaternionFromEuler(np.radians(tag.get("rpy_deg", [0, 0, 0])))
        body = self.client.createMultiBody(baseVisualShapeIndex=visual, basePosition=pose[:3, 3], baseOrientation=quat_xyzw)
        self.client.changeVisualShape(body, -1, textureUniqueId=self.client.loadTexture(picture))

    def _join(self, joint: dict) -> None:
        """A slider along the axis, or a hinge about it through the child's centre: held at two points of it. No limits."""
        parent, child = self.bodies[joint["parent"]], self.bodies[joint["child"]]
        poses = [self.client.getBasePositionAndOrientation(body) for body in (parent, child)]
        world_from_parent, world_from_child = (_rotation(quat_xyzw) for _, quat_xyzw in poses)
        axis = np.array(joint["axis"], dtype=float) / np.linalg.norm(joint["axis"])  # in the world's frame
        offset = world_from_parent.T @ np.subtract(poses[1][0], poses[0][0])
        self.client.setCollisionFilterPair(parent, child, -1, -1, 0)
        if joint["type"] == "prismatic":
            self._constrain(pybullet.JOINT_PRISMATIC, parent, child, world_from_parent.T @ axis, offset, np.zeros(3))
            return
        for end in (-HINGE, HINGE):
            along = end * axis
            self._constrain(pybullet.JOINT_POINT2POINT, parent, child, axis, offset + world_from_parent.T @ along, world_from_child.T @ along)

    def _constrain(self, kind, parent, child, axis, on_parent, on_child) -> None:
        self.client.createConstraint(parent, -1, child, -1, kind, axis.tolist(), on_parent.tolist(), on_child.tolist())

    @property
    def base_from_tag(self) -> dict[int, np.ndarray]:
        """{number: (4, 4)} poses of the tags; a tag's x is right and y up in its upright picture, z out of it."""
        return {tag["id"]: tag_pose(tag) for tag in self.spec.get("tags", [])}

    @property
    def tag_size(self) -> float:
        """Edge of the tags' black squares [m]; all are alike."""
        return float(self.spec["tags"][0]["size"])

    # Photographs

    def photograph(self, camera: Camera) -> np.ndarray:
        """What the camera sees: (H, W, 3) uint8 RGB."""
        return self.photograph_with_depth(camera)[0]

    def photograph_with_depth(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """The picture, and the depth (H, W) [m] along the optical axis, nan where nothing is seen."""
        width, height = camera.width * SUPERSAMPLING, camera.height * SUPERSAMPLING
        _, _, rgba, buffer, _ = self.client.getCameraImage(
            width,
            height,
            invert(camera.world_from_camera @ OPENCV_FROM_OPENGL).T.ravel().tolist(),
            _gl_projection(camera).T.ravel().tolist(),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            **LIGHT,
        )
        buffer = np.reshape(np.asarray(buffer, dtype=np.float64), (height, width))
        depth = FAR * NEAR / (FAR - (FAR - NEAR) * buffer)
        nothing = depth > 0.9 * FAR
        image = np.reshape(rgba, (height, width, 4))[..., :3].astype(np.uint8)
        image[nothing] = BACKDROP
        depth[nothing] = np.nan
        small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return small, _at_centres(depth)


def _at_centres(depth: np.ndarray) -> np.ndarray:
    """Depth at the pixels' centres from their samples. 1/z is linear on a plane, so its mean is exact there; the nearest at edges."""
    height, width = (size // SUPERSAMPLING for size in depth.shape)
    samples = depth.reshape(height, SUPERSAMPLING, width, SUPERSAMPLING).swapaxes(1, 2).reshape(height, width, -1)
    nearest, farthest = samples.min(-1), samples.max(-1)  # nan where any sample sees nothing
    return np.where(farthest - nearest > EDGE * nearest, nearest, 1 / (1 / samples).mean(-1))


def skin(thing: dict, world: str) -> tuple[str, np.ndarray]:
    """OBJ text and picture of an object: the same for the same name in the same world, another for every name."""
    rng = np.random.default_rng(zlib.crc32(f"{world}/{thing['name']}".encode()))
    kind, colour = thing.get("texture", "wood"), np.array(thing.get("colour", [170, 130, 90]), dtype=float)
    if thing["shape"] == "box":
        return skins.box(thing["size"], kind, rng, colour)
    return skins.cylinder(thing["height"], thing["radius"], kind, rng, colour)


def _rotation(quat_xyzw) -> np.ndarray:
    return np.reshape(pybullet.getMatrixFromQuaternion(quat_xyzw), (3, 3))


def tag_pose(tag: dict) -> np.ndarray:
    """base_from_tag (4, 4)."""
    pose = np.eye(4)
    quat_xyzw = pybullet.getQuaternionFromEuler(np.radians(tag.get("rpy_deg", [0, 0, 0])))
    pose[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(quat_xyzw), (3, 3))
    pose[:3, 3] = tag["position"]
    return pose


def _gl_projection(camera: Camera) -> np.ndarray:
    """OpenGL clip matrix (4, 4) of a pinhole: x_ndc = 2 u / w - 1, y_ndc = 1 - 2 v / h."""
    K, w, h = camera.K, camera.width, camera.height
    cx, cy = K[0, 2] - HALF_PIXEL, K[1, 2] + HALF_PIXEL
    return np.array([
        [2 * K[0, 0] / w, 0, 1 - 2 * cx / w, 0],
        [0, 2 * K[1, 1] / h, 2 * cy / h - 1, 0],
        [0, 0, -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)],
        [0, 0, -1, 0],
    ])  # fmt: skip
