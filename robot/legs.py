"""The legs of a robot that walks: where its joints are when its feet are where they are, in closed form.

Notation, for each leg
    p = (x, y, z)   the foot's centre in the hip's frame, which lies as the trunk does
    d               how far the thigh lies to the side of the hip's axis, positive to the left
    a, b            lengths of thigh and calf
    hip, thigh, knee   the angles about x, y, y; the knee bends backwards (negative)

    h^2 = y^2 + z^2 - d^2,                    hip = atan2(z, y) - atan2(-h, d)
    r^2 = x^2 + h^2,                          cos(knee) = (r^2 - a^2 - b^2) / (2 a b)
    thigh = atan2(-x, h) - atan2(b sin(knee), a + b cos(knee))
"""

from dataclasses import dataclass

import numpy as np

from robot.inverse import NoSolution

PARTS = ("hip", "thigh", "knee")


@dataclass(frozen=True, eq=False)
class Legs:
    """F legs alike, read from a URDF.

    joints: names of hip, thigh and knee, leg by leg. feet: names of the feet's links (F,). links: all links of the legs.
    trunk: the link that carries them. hips (F, 3) [m] in its frame. aside (F,): d [m]. thigh, calf, radius of a foot [m].
    lower, upper (3F,) [rad]. ground [m]: the height in the world's frame of what the feet stand on. room: boxes {link,
    size, position} that hold the legs wherever they step, for collision.
    """

    joints: tuple[str, ...]
    feet: tuple[str, ...]
    links: tuple[str, ...]
    trunk: str
    hips: np.ndarray
    aside: np.ndarray
    thigh: float
    calf: float
    radius: float
    lower: np.ndarray
    upper: np.ndarray
    ground: float
    room: tuple[dict, ...]

    @classmethod
    def from_urdf(cls, description, feet, ground: float, room=()) -> "Legs":
        """description: Urdf. feet: names of links, each the end of a hip, a thigh and a calf joint and a fixed one."""
        chains = []
        for foot in feet:
            if foot not in description.links:
                raise ValueError(f"{description.path.name} has no foot {foot!r}; its links are {', '.join(description.links)}")
            chains.append([description.joints[link] for link in description.chain(foot)[-4:]])
        kinds = {tuple(joint.kind for joint in chain) for chain in chains}
        if kinds != {("revolute", "revolute", "revolute", "fixed")} or len({chain[0].parent for chain in chains}) != 1:
            raise ValueError(f"{description.path.name}: a leg is a hip, a thigh and a calf joint on one trunk, and a fixed foot")
        moving = [joint for chain in chains for joint in chain[:3]]
        hip, thigh, knee, foot = chains[0]
        return cls(
            joints=tuple(joint.name for joint in moving),
            feet=tuple(feet),
            links=tuple(joint.child for chain in chains for joint in chain),
            trunk=hip.parent,
            hips=np.array([chain[0].parent_from_joint[:3, 3] for chain in chains]),
            aside=np.array([chain[1].parent_from_joint[1, 3] for chain in chains]),
            thigh=float(-knee.parent_from_joint[2, 3]),
            calf=float(-foot.parent_from_joint[2, 3]),
            radius=float(description.links[feet[0]][0].size[0]),
            lower=np.array([joint.lower for joint in moving]),
            upper=np.array([joint.upper for joint in moving]),
            ground=float(ground),
            room=tuple(room),
        )

    def stance(self, world_from_trunk) -> np.ndarray:
        """(..., 4, 4) -> (..., F, 3): the feet's centres on the ground straight below where their legs hang, whatever the
        trunk's height and pitch."""
        x, y = np.moveaxis(world_from_trunk[..., :2, 0], -1, 0)
        c, s = (v / np.hypot(x, y) for v in (x, y))
        hang = self.hips[:, :2] + np.column_stack([np.zeros(len(self.aside)), self.aside])
        feet = np.empty((*c.shape, len(self.aside), 3))
        feet[..., 0] = world_from_trunk[..., None, 0, 3] + c[..., None] * hang[:, 0] - s[..., None] * hang[:, 1]
        feet[..., 1] = world_from_trunk[..., None, 1, 3] + s[..., None] * hang[:, 0] + c[..., None] * hang[:, 1]
        feet[..., 2] = self.ground + self.radius
        return feet

    def angles(self, world_from_trunk, feet) -> np.ndarray:
        """(T, 4, 4) and the feet's centres (T, F, 3) [m] -> joints (T, 3F) [rad]. Raises NoSolution, with the first
        ``waypoint`` where a foot is out of reach or a joint beyond its limit."""
        R, o = world_from_trunk[:, :3, :3], world_from_trunk[:, :3, 3]
        p = np.einsum("tji,tfj->tfi", R, feet - o[:, None]) - self.hips
        q = np.stack(self._solved(p), axis=-1)
        flat = q.reshape(len(q), -1)
        bad = ~((flat >= self.lower - 1e-6) & (flat <= self.upper + 1e-6)).all(axis=1)
        if bad.any():
            k = int(np.flatnonzero(bad)[0])
            raise NoSolution(f"{self._short(flat[k], p[k])} at step {k + 1} of {len(p)}", k)
        return flat

    def _solved(self, p):
        """Hip, thigh and knee (T, F) of feet p (T, F, 3); nan where they are out of reach."""
        x, y, z = np.moveaxis(p, -1, 0)
        a, b, d = self.thigh, self.calf, self.aside
        with np.errstate(invalid="ignore"):
            h = np.sqrt(y**2 + z**2 - d**2)
            cosine = (x**2 + h**2 - a**2 - b**2) / (2 * a * b)
            knee = -np.arccos(cosine)
        hip = np.arctan2(z, y) - np.arctan2(-h, d)
        thigh = np.arctan2(-x, h) - np.arctan2(b * np.sin(knee), a + b * np.cos(knee))
        return (hip + np.pi) % (2 * np.pi) - np.pi, thigh, knee

    def _short(self, q, p) -> str:
        bad = ~((q >= self.lower - 1e-6) & (q <= self.upper + 1e-6))
        j = int(np.flatnonzero(bad)[0])
        foot, far = self.feet[j // 3], np.linalg.norm(p[j // 3])
        if np.isnan(q[j]):
            return f"{foot} is {far:.3f} m from its hip, out of its leg's reach"
        return f"{foot} asks {self.joints[j]} for {q[j]:.2f} rad (limits {self.lower[j]:.2f} to {self.upper[j]:.2f})"
