"""Attempts at candidate paths: each with the profile that suits it best, checked at waypoints and swept between
them."""

from dataclasses import dataclass, replace

import numpy as np

from robot.arm import Arm, NoSolution
from robot.collision import ITSELF, WORLD, CollisionModel
from robot.inverse import Tool
from robot.postures import Profile, end_profiles, path_to, taught_profile, tool_profiles

RESOLUTION = 1e-3  # m, to which clearances between waypoints are known
LANDING, HALVINGS = 0.04, 8  # m: the last of the way, which may be left out; of a step, to find where the hand touches
CAP = 0.1  # m: clearances beyond this are not told apart here
SHARED_PROFILES, OWN_POSTURES, SCREENING_STRIDE = 4, 4, 3
OWN_TRIES = 8  # so many samples in a row are tried with profiles of their own in vain, then no more
AT_ONCE = 4  # waypoints that are measured before it is asked whether an attempt may still be among the best


@dataclass(frozen=True, eq=False)
class Attempt:
    """A candidate with a profile. index: 0 is the mean, negative a mean moved away from obstacles. points (N, 3) [m]. path (N, J), shorter where the arm could not
    follow.

    clearance: to the world [m]. refusal: why it is not feasible, empty where it is. short [m]: of the taught end, where the hand
    touches before. worst: the waypoint that is least clear.
    """

    index: int
    points: np.ndarray
    path: np.ndarray
    profile: Profile | None
    clearance: float
    refusal: str = ""
    short: float = 0.0
    worst: int = 0

    @property
    def rank(self) -> tuple:
        """Better is larger: feasible, then with the hand turned early, how near to the end it lands, how much of the path could
        be followed, clearance."""
        turning = self.profile.turning if self.profile and not self.refusal else 0.0
        return not self.refusal, -turning, -round(self.short, 3), len(self.path), self.clearance


@dataclass(frozen=True, eq=False)
class Search:
    """For each candidate the best attempt. start (J,). margin: least clearance [m]. comfortable: a larger one is not
    looked for [m]. postures: end postures tried on the mean. tool: how the hand is to be turned. touch (3,) [m]: where the hand is to
    touch what the model lets it land on, at the motion's end; None where it is not to touch anything."""

    arm: Arm
    model: CollisionModel
    start: np.ndarray
    margin: float
    comfortable: float
    postures: int
    tool: Tool = Tool()
    touch: np.ndarray | None = None

    @property
    def lands(self) -> bool:
        return self.touch is not None

    def all(self, candidates, orientation=None) -> list[Attempt]:
        """Candidates (S, N, 3), the mean first; orientation: None or rows (t, quat_xyzw) that were taught.

        A sample is tried with the mean's best profiles; where none of them serves, with its own. Of those refused only the
        best is measured to its worst waypoint: the others are left where they are seen to be no better than one before.
        """
        if orientation is not None:
            taught = [taught_profile(self.arm, orientation, self.start, candidates.shape[1])]
            return [self.best(k, points, taught, self.comfortable)[0] for k, points in enumerate(candidates)]
        mean, profiles = self.best(0, candidates[0], self._profiles(candidates[0], self.postures), np.inf, SHARED_PROFILES)
        attempts, in_vain, leading = [mean], 0, mean
        for k, points in enumerate(candidates[1:], start=1):
            shared = self._profiles(points, OWN_POSTURES) if self.tool.kind == "tangent" else profiles
            attempt, _ = self.best(k, points, shared[:SHARED_PROFILES], self.comfortable, than=leading)
            if attempt.refusal and in_vain < OWN_TRIES:
                own, _ = self.best(k, points, self._profiles(points, OWN_POSTURES), self.comfortable, than=leading)
                attempt = max(attempt, own, key=lambda a: a.rank)
                in_vain = in_vain + 1 if attempt.refusal else 0
            attempts.append(attempt)
            leading = max(leading, attempt, key=lambda a: a.rank)
        return attempts

    def ends_clear(self, points) -> bool:
        """Whether the arm has a posture, clear of everything, at the end of a path (N, 3)."""
        ends = [profile.end for profile in self._profiles(points, self.postures)]
        return bool(ends) and bool((self.model.clearance(np.array(ends)) >= self.margin - LANDING * self.lands).any())

    def _profiles(self, points, count):
        if self.tool.kind != "free":
            return tool_profiles(self.arm, self.tool, points, self.start)
        margin = self.margin - LANDING * self.lands  # the end itself lies in what the hand lands on
        return end_profiles(self.arm, self.model, points, self.start, count, margin)

    def best(self, index, points, profiles, enough, ranked=1, than=None) -> tuple[Attempt, list[Profile]]:
        """The best attempt at a path, and the profiles, the ``ranked`` best of them first and in order. All are screened at
        some waypoints, until one has a clearance of ``enough`` [m]; then the best are checked in full. Refused ones that are
        no better than the attempt ``than`` are not told apart."""
        screened = []
        for profile in profiles:
            beaten = max([than] * (than is not None) + screened[ranked - 1 : ranked], key=lambda a: a.rank, default=None)
            attempt = self._screen(index, points, profile, beaten)
            screened = sorted([*screened, attempt], key=lambda a: a.rank, reverse=True)
            if not attempt.refusal and attempt.clearance >= enough:
                break
        if not screened:
            return self._unreached(index, points), []
        checked = []
        for attempt in screened[:SHARED_PROFILES]:
            checked.append(self._check(attempt))
            if not checked[-1].refusal:
                break
        best = max(checked, key=lambda a: a.rank)
        return best, [a.profile for a in screened]

    def _unreached(self, index, points) -> Attempt:
        end = ", ".join(f"{x:.3f}" for x in points[-1])
        turned = "" if self.tool.kind == "free" else f" with the hand {self.tool}"
        refusal = f"{title(index)}: at t = 1.00 no posture of the arm reaches the end ({end}) m{turned}"
        return Attempt(index, points, self.start[None], None, -np.inf, refusal)

    def _screen(self, index, points, profile, beaten) -> Attempt:
        try:
            path = path_to(self.arm, points, self.start, profile)
        except NoSolution as error:
            t = error.waypoint / (len(points) - 1)
            reached = np.vstack([self.start, error.path])[: max(error.waypoint, 1)]
            return Attempt(index, points, reached, profile, -np.inf, f"{title(index)}: at t = {t:.2f} {error}")
        attempt = Attempt(index, points, path, profile, -np.inf)
        attempt = self._landed(attempt) if self.lands else attempt
        rows = _every(attempt, SCREENING_STRIDE)
        if beaten is None:
            return self._measured(attempt, rows)
        there_first = np.argsort(np.abs(rows - beaten.worst), kind="stable")  # what met one is likely to meet the next
        return self._measured(attempt, rows[there_first], beaten.rank)

    def _landed(self, attempt) -> Attempt:
        """The attempt as far as the hand may go before it touches what it lands on: that may be the side of a hand that is
        not upright there. Only the last of the way is left out."""
        points, path = attempt.points, attempt.path
        last = np.flatnonzero(np.linalg.norm(points - points[-1], axis=1) > LANDING).max(initial=-1) + 1
        bad = np.flatnonzero(self.model.clearance(path[last:]) < self.margin)
        if not len(bad) or last + bad[0] == 0:
            return attempt
        k = last + bad[0]
        clear, near = path[k - 1], path[k]
        for _ in range(HALVINGS):
            middle = (clear + near) / 2
            clear, near = (middle, near) if self.model.clearance(middle) >= self.margin else (clear, middle)
        arrived = self.arm.fk(clear)[:3, 3]
        short = float(np.linalg.norm(points[-1] - arrived))
        return replace(attempt, points=np.vstack([points[:k], arrived]), path=np.vstack([path[:k], clear]), short=short)

    def _measured(self, attempt, rows, floor=None) -> Attempt:
        """The attempt measured at waypoints ``rows``, in this order; not at the rest once its rank falls below ``floor``."""
        parts, count = [], len(rows) if floor is None else AT_ONCE
        for first in range(0, len(rows), count):
            parts.append(self.model.measure(attempt.path[rows[first : first + count]], cap=CAP))
            seen = self._seen(attempt, rows, *map(np.concatenate, zip(*parts)))
            if floor is not None and seen.refusal and seen.rank < floor:
                break
        return seen

    def _seen(self, attempt, rows, distance, pair) -> Attempt:
        """The attempt by what was measured (M, 2) at the first M of its waypoints ``rows``."""
        row, group = np.unravel_index(distance.argmin(), distance.shape)
        refusal = ""
        if distance[row, group] < self.margin:
            names, last = self.model.pair_names(pair[row, group]), len(attempt.path) - 1
            refusal = touch(attempt.index, rows[row] / last, distance[row, group], names, self.margin)
        clearance = distance[:, WORLD].min() if distance[:, ITSELF].min() >= self.margin else distance.min()
        return replace(attempt, clearance=clearance, refusal=refusal, worst=int(rows[row]))

    def _check(self, attempt) -> Attempt:
        """The attempt measured at every waypoint and swept between them; one already refused is left as it is."""
        if attempt.refusal:
            return attempt
        full = self._measured(attempt, _every(attempt, 1))
        if full.refusal:
            return full
        t = np.linspace(0, 1, len(full.path))
        return replace(full, refusal=swept_refusal(self.model, full.path, t, full.index, self.margin))


def _every(attempt, stride) -> np.ndarray:
    """Waypoints that lie ``stride`` apart, and the last."""
    last = len(attempt.path) - 1
    return np.union1d(np.arange(0, last, stride), last)


def swept_refusal(model, path, t, index, margin) -> str:
    """Empty where the motion along ``path`` (T, J), at fractions t (T,), keeps the margin to within the resolution."""
    sweep = model.sweep(path, required=margin, resolution=RESOLUTION, cap=CAP)
    worst = int(sweep.clearance.argmin())
    if sweep.clearance[worst] >= margin - RESOLUTION:
        return ""
    return touch(index, t[worst], sweep.clearance[worst], sweep.pairs[worst], margin)


def title(index) -> str:
    return "the mean" if index == 0 else f"sample {index}" if index > 0 else "the moved mean"


def touch(index, t, clearance, pair, margin) -> str:
    """Which bodies come too close, and where along the path."""
    a, b = pair
    far = (
        f"runs {-1e3 * clearance:.0f} mm into {b}" if clearance < 0 else f"comes within {1e3 * clearance:.1f} mm of {b}"
    )
    return f"{title(index)}: at t = {t:.2f} {a} {far} (margin {1e3 * margin:.0f} mm)"
