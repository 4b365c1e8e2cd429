"""World: the simulated world that a YAML file describes, in a PyBullet client of its own.

    with World.load("table") as world:
        picture = world.photograph(camera)

Frame: metres, z up, the robot's base. Collision shapes are primitives; skins are textured meshes (skins.py).
"""

import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from robot import bodies, skins, standing, worldfile
from robot import thing as things
from robot.bullet import BulletClient, connect, pybullet
from robot.variation import varied
from scene.camera import OPENCV_FROM_OPENGL, Camera, invert

NEAR, FAR = 0.05, 30.0  # m
SUPERSAMPLING = 2  # TinyRenderer does not smooth edges: twice the pixels, averaged
HALF_PIXEL = 0.5 / SUPERSAMPLING  # TinyRenderer samples pixels at their lower left corner, not at their centre
LIGHT = {"lightDirection": [2.0, -3.0, 6.0], "lightColor": [1, 1, 1], "lightAmbientCoeff": 0.62, "lightDiffuseCoeff": 0.45,
         "lightSpecularCoeff": 0.0}  # fmt: skip
FRICTION = 0.7
EDGE = 0.03  # share of the depth; samples of a pixel further apart than this lie on different surfaces
BACKDROP = (226, 228, 230)


class World:
    """Bodies by name, a PyBullet client, and a camera. Use it in a ``with`` statement, or call ``close``.

    spec: the data of the world's file, varied under its seed. client: BulletClient. bodies: {name: body id}; what is
    held is among them once a hand holds it.
    """

    def __init__(self, spec: dict, *, textured: bool = True):
        worldfile.check(spec)
        self.spec = varied(spec)
        standing.check(self.spec)
        self.client = connect()
        self.client.setGravity(0, 0, -9.81)
        self.bodies: dict[str, int] = {}
        self._links: dict[str, int] = {}  # by name; -1 is a body's base
        self._textured = textured
        self._grip: int | None = None
        try:
            self._build()
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

    # Where things are

    def thing(self, name: str) -> dict:
        """What the file says of a thing, the held one among them."""
        held = [self.spec["held"]] if self.spec.get("held") else []
        return next(one for one in (*self.spec["objects"], *held) if one["name"] == name)

    def pose(self, name: str) -> np.ndarray:
        """world_from_thing (4, 4), as it stands now."""
        body, link = self.bodies[name], self._links[name]
        place = self.client.getBasePositionAndOrientation(body) if link < 0 else self.client.getLinkState(body, link, computeForwardKinematics=True)[:2]
        return _matrix(*place)

    def speed(self, name: str) -> float:
        """How fast the middle of a thing moves now [m/s]."""
        body, link = self.bodies[name], self._links[name]
        velocity = self.client.getBaseVelocity(body)[0] if link < 0 else self.client.getLinkState(body, link, computeLinkVelocity=True)[6]
        return float(np.linalg.norm(velocity))

    def joint_opening(self, name: str) -> float:
        """How far a joint stands from its lower limit now [m or rad]."""
        joint = next(one for one in self.spec["joints"] if one["name"] == name)
        return self.client.getJointState(self.bodies[joint["child"]], 0)[0] - joint["lower"]

    @property
    def movable(self) -> list[str]:
        """The names of what has a mass, as far as it is in the world."""
        return [name for name in self.bodies if self.thing(name).get("mass")]

    @property
    def in_hand(self) -> list[int]:
        """The ids of the bodies that the hand holds now."""
        return [self.bodies[self.spec["held"]["name"]]] if self._grip is not None else []

    @property
    def touchable(self) -> set[str]:
        """The names of what the task is to touch, the held thing among them."""
        return {*self.spec.get("touch", []), *([self.spec["held"]["name"]] if self.spec.get("held") else [])}

    @property
    def obstacles(self) -> "Obstacles":
        """What a motion must keep clear of; what it is to touch, all but the hand must."""
        held = [self.spec["held"]["name"]] if self.spec.get("held") else []
        return Obstacles(self.client, dict(self.bodies), self.spec, tuple(self.spec.get("touch", [])), tuple(n for n in held if n in self.bodies))

    # Building

    def _build(self) -> None:
        joints = {joint["child"]: joint for joint in self.spec.get("joints", [])}
        with tempfile.TemporaryDirectory() as folder:
            for thing in self.spec["objects"]:
                self._add(thing, things.pose(thing), Path(folder), joints.get(thing["name"]))
            for tag in self.spec.get("tags", []) if self._textured else []:
                self._lay_tag(tag, Path(folder))
        for joint in joints.values():
            self.client.setCollisionFilterPair(self.bodies[joint["parent"]], self.bodies[joint["child"]], -1, 0, 0)

    def _add(self, thing: dict, pose, folder: Path, joint: dict | None = None) -> None:
        """A body of its own; on a joint it is the only link of an unseen rail."""
        skin, picture = self._skin(thing, folder) if self._textured else (None, None)
        at = np.zeros(3) if joint is None or "at" not in joint else pose[:3, :3].T @ (pose[:3, 3] - joint["at"])
        visual = -1 if skin is None else self.client.createVisualShape(pybullet.GEOM_MESH, visualFramePosition=at.tolist(), **skin)
        collision, mass, name = bodies.collision_shape(self.client, thing, at), thing.get("mass", 0), thing["name"]
        position, quat_xyzw = (pose[:3, 3] - pose[:3, :3] @ at).tolist(), Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        link = -1 if joint is None else 0
        if joint is None:
            body = self.client.createMultiBody(mass, collision, visual, position, quat_xyzw)
        else:
            body = bodies.on_rail(self.client, joint, mass, (collision, visual), position, quat_xyzw, at)
        self.client.changeDynamics(body, link, lateralFriction=thing.get("friction", FRICTION))
        if picture:
            self.client.changeVisualShape(body, link, textureUniqueId=self.client.loadTexture(picture))
        self.bodies[name], self._links[name] = body, link

    def _skin(self, thing: dict, folder: Path) -> tuple[dict, str | None]:
        """The visual shape's mesh and colour, and its picture."""
        if thing["shape"] == "mesh":
            colour = [c / 255 for c in thing.get("colour", [180, 180, 180])] + [1]
            return {"fileName": str(thing["file"]), "rgbaColor": colour}, None
        mesh, picture = skins.save(folder, thing["name"], *skin(thing, self.spec["name"]))
        return {"fileName": mesh, "rgbaColor": [1, 1, 1, 1]}, picture

    def _lay_tag(self, tag: dict, folder: Path) -> None:
        """A quad a millimetre above what it lies on; it is seen and never touched."""
        mesh, picture = skins.save(folder, f"tag{tag['id']}", *skins.tag(tag["id"], tag["size"]))
        pose = things.pose(tag)
        visual = self.client.createVisualShape(pybullet.GEOM_MESH, fileName=mesh, rgbaColor=[1, 1, 1, 1])
        quat_xyzw = Rotation.from_matrix(pose[:3, :3]).as_quat()
        body = self.client.createMultiBody(baseVisualShapeIndex=visual, basePosition=pose[:3, 3], baseOrientation=quat_xyzw)
        self.client.changeVisualShape(body, -1, textureUniqueId=self.client.loadTexture(picture))

    # What a hand holds

    def bring_held(self, arm, q) -> None:
        """What the file says is held, if anything, comes into the world, where an arm at q (J,) has it."""
        if self.spec.get("held"):
            self._bring(arm.fk(q) @ self._in_hand(arm.gripper.rest))

    def _in_hand(self, rest) -> np.ndarray:
        """tip_from_held (4, 4): as the file says, and moved along ``rest`` (3,) by half its size, see arm.Gripper."""
        tip_from_held = things.pose(self.spec["held"])
        points = np.vstack([piece.corners() for piece in standing.thing_pieces(self.spec["held"])])
        tip_from_held[:3, 3] += rest * np.max((points - tip_from_held[:3, 3]) @ -np.asarray(rest), initial=0)
        return tip_from_held

    def _bring(self, pose) -> None:
        with tempfile.TemporaryDirectory() as folder:
            self._add(self.spec["held"], pose, Path(folder))

    def put_in_hand(self, robot: int, link: int, rest=(0.0, 0.0, 0.0)) -> None:
        """It comes into the world at the robot's link, fixed to that, moved along ``rest`` (3,) as in ``bring_held``."""
        com, frame = (_matrix(*self.client.getLinkState(robot, link, computeForwardKinematics=True)[k : k + 2]) for k in (0, 4))
        self._bring(frame @ self._in_hand(rest))
        com_from_held = np.linalg.inv(com) @ frame @ self._in_hand(rest)
        quat_xyzw = Rotation.from_matrix(com_from_held[:3, :3]).as_quat().tolist()
        self._grip = self.client.createConstraint(robot, link, self.bodies[self.spec["held"]["name"]], -1, pybullet.JOINT_FIXED, [0, 0, 0],
                                                  com_from_held[:3, 3].tolist(), [0, 0, 0], quat_xyzw)  # fmt: skip

    def let_go(self) -> None:
        """What is held is free to fall."""
        if self._grip is not None:
            self.client.removeConstraint(self._grip)
            self._grip = None

    # Tags

    @property
    def base_from_tag(self) -> dict[int, np.ndarray]:
        """{number: (4, 4)} poses of the tags; a tag's x is right and y up in its upright picture, z out of it."""
        return {tag["id"]: things.pose(tag) for tag in self.spec.get("tags", [])}

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


@dataclass(frozen=True)
class Obstacles:
    """A world as planning knows it. client: BulletClient. bodies: {name: body id}. spec: the world's. touch: names of
    what the hand may touch. held: of what it carries."""

    client: BulletClient
    bodies: dict[str, int]
    spec: dict
    touch: tuple[str, ...] = ()
    held: tuple[str, ...] = ()


def skin(thing: dict, world: str) -> tuple[str, np.ndarray]:
    """OBJ text and picture of an object: the same for the same name in the same world, another for every name."""
    return skins.paint(thing, np.random.default_rng(zlib.crc32(f"{world}/{thing['name']}".encode())))


def _matrix(position, quat_xyzw) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.reshape(pybullet.getMatrixFromQuaternion(quat_xyzw), (3, 3)), position
    return matrix


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
