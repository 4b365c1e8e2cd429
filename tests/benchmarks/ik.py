"""Inverse kinematics beside its peers in one table: PyBullet's own with restarts, pink, and ours.

    python tests/benchmarks/ik.py                      # Panda and Z1, 1,000 poses each; pink needs: pip install pin-pink daqp
    python tests/benchmarks/ik.py --poses 100 --arms z1

Poses are those of random postures inside the limits; solved: within 1 mm and 0.01 rad, and inside the limits. Peers begin
at home as ours does, then at random postures. Times are of CPU [ms]. Then poses that cannot be had, 200 for each arm: half
beyond the reach; a quarter whose place can be had, but turned so that the last joint would be farther from the second
than the links between them are long; a quarter of postures beyond a limit that 2,000 starts do not reach. Last
paths of 200 waypoints that are known to exist (smooth random postures' own), by orientation kept or free.
"""

import argparse
import time
from importlib.util import find_spec

import numpy as np
from scipy.spatial.transform import Rotation

from robot import kinematics
from robot.arm import Arm, NoSolution
from robot.bullet import connect
from robot.inverse import choose
from robot.kinematics import POSE, POSITION

POSITION_MM, ROTATION = 1.0, 0.01
SOLVER = "daqp"  # of pink's quadratic programs


class Bullet:
    """calculateInverseKinematics with 200 iterations, begun again up to 5 (or 20) times at random postures."""

    def __init__(self, arm, restarts):
        self.arm, self.restarts, self.client = arm, restarts, connect()
        self.body = arm.spawn(self.client)
        self.tip = next(i for i in range(self.client.getNumJoints(self.body)) if self.client.getJointInfo(self.body, i)[12].decode() == arm.tip_link)
        movable = [i for i in range(self.client.getNumJoints(self.body)) if self.client.getJointInfo(self.body, i)[2] != 4]
        self.columns = [movable.index(i) for i in arm.joint_indices]

    def __call__(self, pose):
        for start in np.vstack([self.arm.home, self.arm.random(self.restarts, 0)]):
            for joint, value in zip(self.arm.joint_indices, start):
                self.client.resetJointState(self.body, joint, value)
            answer = self.client.calculateInverseKinematics(
                self.body, self.tip, pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat(), maxNumIterations=200,
                residualThreshold=1e-5,
            )  # fmt: skip
            q = np.array(answer)[self.columns]
            if solved(self.arm, q, pose):
                return q
        return None


class Pink:
    """pink's differential inverse kinematics, iterated to convergence, begun again up to 5 times."""

    def __init__(self, arm, restarts):
        import pinocchio
        import pink

        self.pin, self.pink, self.arm, self.restarts = pinocchio, pink, arm, restarts
        whole = pinocchio.buildModelFromUrdf(str(arm.urdf))
        held = [i for i, name in enumerate(whole.names) if i and name not in arm.joint_names]
        neutral = pinocchio.neutral(whole)
        for name, value in zip(arm.gripper.joints, arm.gripper.open):
            neutral[whole.joints[whole.getJointId(name)].idx_q] = value
        self.model = pinocchio.buildReducedModel(whole, held, neutral)
        self.model.lowerPositionLimit[:], self.model.upperPositionLimit[:] = arm.lower, arm.upper
        self.data = self.model.createData()

    def __call__(self, pose):
        from pink.tasks import FrameTask

        task = FrameTask(self.arm.tip_link, position_cost=1.0, orientation_cost=1.0, lm_damping=1e-6)
        task.set_target(self.pin.SE3(pose[:3, :3], pose[:3, 3]))
        for start in np.vstack([self.arm.home, self.arm.random(self.restarts, 0)]):
            inside = np.clip(start, self.arm.lower + 1e-6, self.arm.upper - 1e-6)
            configuration = self.pink.Configuration(self.model, self.data, inside)
            for _ in range(100):
                error = task.compute_error(configuration)
                if np.linalg.norm(error[:3]) < 5e-4 and np.linalg.norm(error[3:]) < 5e-3:
                    break
                try:
                    velocity = self.pink.solve_ik(configuration, [task], 1.0, solver=SOLVER, damping=1e-9)
                except Exception:  # whatever its solver raises counts as not solved
                    break
                configuration.integrate_inplace(velocity, 1.0)
            if solved(self.arm, configuration.q, pose):
                return configuration.q
        return None


class Ours:
    def __init__(self, arm):
        self.arm = arm

    def __call__(self, pose):
        try:
            return self.arm.ik(pose)
        except NoSolution:
            return None


def lacks() -> str:
    """Which of what pink is run with is not there, empty where all is."""
    modules = {"pinocchio": "pin", "pink": "pin-pink", "qpsolvers": "pin-pink", SOLVER: SOLVER}
    return " ".join(dict.fromkeys(package for module, package in modules.items() if find_spec(module) is None))


def solved(arm, q, pose) -> bool:
    if q is None:
        return False
    reached = arm.fk(q)
    turned = Rotation.from_matrix(reached[:3, :3].T @ pose[:3, :3]).magnitude()
    off = 1e3 * np.linalg.norm(reached[:3, 3] - pose[:3, 3])
    return bool(off < POSITION_MM and turned < ROTATION and arm.within_limits(q)[0])


def reachable(arm, count, peers) -> None:
    targets = arm.fk(arm.random(count, 1))
    for title, solve in peers:
        solve(targets[0])
        good, times = 0, []
        for target in targets:
            started = time.process_time()
            q = solve(target)
            times.append(1e3 * (time.process_time() - started))
            good += solved(arm, q, target)
        print(f"| {arm.name} | {title} | {good} of {count} | {np.median(times):.2f} | {np.percentile(times, 95):.2f} | {max(times):.1f} |", flush=True)


def unreachable(arm, count) -> None:
    refused, reasons, times = 0, 0, []
    targets = [*beyond(arm, count // 2), *turned_away(arm, count // 4), *barred(arm, count // 4)]
    for target in targets:
        started = time.process_time()
        try:
            arm.ik(target)
        except NoSolution as error:
            refused += 1
            reasons += "short, with" in str(error)
        times.append(1e3 * (time.process_time() - started))
    print(f"| {arm.name} | {refused} of {len(targets)} | {reasons} | {np.median(times):.1f} | {max(times):.1f} |", flush=True)


def beyond(arm, count):
    """Poses of random postures, moved out of reach."""
    poses = arm.fk(arm.random(count, 2))
    out = poses[:, :3, 3] / np.linalg.norm(poses[:, :3, 3], axis=1, keepdims=True)
    poses[:, :3, 3] += out * 1.5
    return poses


def turned_away(arm, count):
    """Poses near the rim of the reach with the hand turned inwards: the place alone can be had."""
    moving = np.flatnonzero(arm.chain[4] >= 0)
    q = arm.random(4000, 5)
    second, last = (kinematics.batch_poses(*arm.chain, q)[:, moving[k], :3, 3] for k in (1, -1))
    longest = np.linalg.norm(arm.chain[1][moving[1] + 1 : moving[-1] + 1, :3, 3], axis=1).sum()
    found, poses = [], arm.fk(q)
    tip_from_last = np.einsum("nji,nj->ni", poses[:, :3, :3], last - poses[:, :3, 3])
    for pose, shoulder, back in zip(poses, second, tip_from_last):
        out = pose[:3, 3] - shoulder
        pose[:3, :3] = Rotation.align_vectors(out[None], back[None])[0].as_matrix()
        if np.linalg.norm(pose[:3, 3] + pose[:3, :3] @ back - shoulder) > longest + 0.01 and len(found) < count:
            arm.ik(pose, position_only=True)
            found.append(pose)
    return found


def barred(arm, count):
    """Poses of postures beyond a limit that no posture inside the limits has, as far as 2,000 starts tell."""
    rng, found, starts = np.random.default_rng(3), [], np.vstack([arm.home, arm.random(2000, 4)])
    while len(found) < count:
        q = arm.random(1, int(rng.integers(1 << 30)))[0]
        j = rng.integers(len(q))
        q[j] = (arm.upper[j] + rng.uniform(0.3, 1.2)) if rng.random() < 0.5 else (arm.lower[j] - rng.uniform(0.3, 1.2))
        pose = arm.fk(q)
        _, position, rotation = kinematics.solve(arm.chain, arm.lower, arm.upper, pose, starts, POSE, 0.0, 80, 1e-3, 1e-2)
        if position > 1e-3 or rotation > 1e-2:
            found.append(pose)
    return found


def paths(arm, count) -> None:
    """Smooth joint paths between random postures, given as what their tips do."""
    for title, rows in (("pose", POSE), ("position", POSITION)):
        choose(arm, arm.fk(np.tile(arm.home, (2, 1))), rows)  # what is compiled once is no part of a path
        found, greedy, times, steps, errors = 0, 0, [], [], []
        for seed in range(count):
            ends, s = arm.random(3, 100 + seed), np.linspace(0, 1, 200)[:, None]
            known = (1 - s) ** 2 * ends[0] + 2 * s * (1 - s) * ends[1] + s**2 * ends[2]
            poses = arm.fk(known)
            try:
                arm.follow(poses if rows == POSE else poses[:, :3, 3], start=arm.ik(poses[0], position_only=rows == POSITION))
                greedy += 1
            except NoSolution:
                pass
            started = time.process_time()
            try:
                q = choose(arm, poses, rows)
                found += 1
                steps.append(np.abs(np.diff(q, axis=0)).max())
                errors.append(1e3 * np.linalg.norm(arm.fk(q)[:, :3, 3] - poses[:, :3, 3], axis=1).max())
            except NoSolution:
                pass
            times.append(time.process_time() - started)
        print(f"| {arm.name} | {title} | {greedy} | {found} of {count} | {max(steps):.3f} | {max(errors):.3f} | {np.median(times):.2f} | {max(times):.2f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", nargs="+", default=["panda", "z1"])
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--peer-poses", type=int, help="fewer for the peers, which are slow")
    options = parser.parse_args()
    arms = [Arm.load(name) for name in options.arms]
    print("| arm | | solved | median ms | 95 % ms | worst ms |\n|---|---|---|---|---|---|")
    for arm in arms:
        reachable(arm, options.poses, [("ours", Ours(arm))])
        missing = lacks()
        if missing:
            print(f"| {arm.name} | pink, 5 restarts | left out: pip install {missing} | | | |", flush=True)
        peers = [] if missing else [("pink, 5 restarts", Pink(arm, 5))]
        peers += [(f"PyBullet, {restarts} restarts", Bullet(arm, restarts)) for restarts in (5, 20)]
        reachable(arm, options.peer_poses or options.poses, peers)
    print("\n| arm | unreachable: refused | with a reason | median ms | worst ms |\n|---|---|---|---|---|")
    for arm in arms:
        unreachable(arm, 200)
    print("\n| arm | path of | first branch | best branch | largest step rad | error mm | median s | worst s |\n|---|---|---|---|---|---|---|---|")
    for arm in arms:
        paths(arm, 50)


if __name__ == "__main__":
    main()
