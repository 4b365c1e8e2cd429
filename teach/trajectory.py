"""A Gaussian distribution over continuous trajectories, and the skill that holds it.

Notation (Zhi et al. 2023, Section IV-B; Paraschos et al. 2013)
    xi(t) = W^T Phi(t)                  position [m] at normalised time t in [0, 1]; W (M, 3) weights [m]; eq. (4)
    w = W.ravel() ~ N(m, S)             basis-major: w[3 i + axis] = W[i, axis]; S (3M, 3M) [m^2]
    Psi(t) = Phi(t) kron I_3            (3M, 3), so that xi(t) = Psi(t)^T w
"""

import json
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from jaxtyping import Float

from scene.files import parse_npz, replacing
from teach.basis import Periodic, SquaredExponential
from teach.sketch import Event, Sketch, dumps, held, loads

CONDITIONING = ("gaussian", "first_weight")
EXACT = 1e-9
"""A condition without covariance is met to this distance [m]."""
LIKELY, BUMP, FAR = 11.3, 0.07, 10.0
"""Squared Mahalanobis distance of 99 % of the points of a trajectory; deviation in time of a bump beyond it; its
largest variance over the squared way to the point."""
BASES = {basis.__name__: basis for basis in (SquaredExponential, Periodic)}
"""The bases that a skill's file can name."""


@dataclass(frozen=True, eq=False)
class TrajectoryDistribution:
    """xi(t) = W^T Phi(t) with Gaussian weights. mean: (M, 3) [m]. covariance: (3M, 3M) [m^2], basis-major."""

    basis: SquaredExponential | Periodic
    mean: Float[np.ndarray, "M 3"]
    covariance: Float[np.ndarray, "3*M 3*M"]

    def __post_init__(self):
        mean, covariance = np.array(self.mean, dtype=float), np.array(self.covariance, dtype=float)
        M = self.basis.count
        if mean.shape != (M, 3) or covariance.shape != (3 * M, 3 * M):
            raise ValueError(f"{M} basis functions need mean ({M}, 3) and covariance ({3 * M}, {3 * M}), "
                             f"not {mean.shape} and {covariance.shape}")
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise ValueError("a trajectory distribution's mean and covariance must be finite numbers")
        if not np.allclose(covariance, covariance.T, rtol=0, atol=1e-6 * np.abs(covariance).max()):
            raise ValueError("a covariance must be symmetric")
        for name, array in (("mean", mean), ("covariance", (covariance + covariance.T) / 2)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def features(self, t) -> np.ndarray:
        """Psi at times t (T,), one under the other: (3T, 3M), so that features @ w is xi(t).ravel()."""
        return np.kron(self.basis(t), np.eye(3))

    def mean_at(self, t) -> np.ndarray:
        """Mean position (T, 3) [m] at times t (T,)."""
        return self.basis(t) @ self.mean

    def covariance_at(self, t) -> np.ndarray:
        """Covariance of the position (T, 3, 3) [m^2] at times t (T,)."""
        Phi, M = self.basis(t), self.basis.count
        return np.einsum("ti,iajb,tj->tab", Phi, self.covariance.reshape(M, 3, M, 3), Phi, optimize=True)

    def sample(self, n: int, t, rng: np.random.Generator) -> np.ndarray:
        """n trajectories at times t (T,): (n, T, 3) [m]."""
        return self.basis(t) @ self.sample_weights(n, rng)

    def sample_weights(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """n weight matrices (n, M, 3) [m]."""
        deviations = rng.standard_normal((n, len(self.covariance))) @ self._root.T
        return self.mean + deviations.reshape(n, *self.mean.shape)

    def log_prob(self, t, x) -> np.ndarray:
        """log N(x; xi's mean and covariance at t) (T,) of positions x (T, 3) [m] at times t (T,), each on its own."""
        covariance = self.covariance_at(t)
        offset = np.asarray(x, dtype=float) - self.mean_at(t)
        mahalanobis = np.einsum("ta,ta->t", offset, np.linalg.solve(covariance, offset[..., None])[..., 0])
        return -0.5 * (mahalanobis + np.linalg.slogdet(covariance)[1] + 3 * np.log(2 * np.pi))

    def condition(self, t, x, covariance=None, local: bool = True) -> "TrajectoryDistribution":
        """The distribution of the trajectories that pass x at t; the rest of their shape follows by correlation.

        t: () or (K,) times. x: (3,) or (K, 3) [m]. covariance: None (exactly there), (3, 3) for each of them or (K, 3,
        3) [m^2]. local: a point further away than the distribution explains is reached by a bump of its own around t,
        and says the less of the rest the further away it is; False: all of it is explained by correlation. Where the
        distribution has no such motion (a singular S), what is missing is bridged by the least change of the weights.
        Raises ValueError where conditions contradict each other. K = S Psi (Psi^T S Psi + R)^-1 (Paraschos et al. 2013).
        """
        t = np.atleast_1d(np.asarray(t, dtype=float))
        x = np.asarray(x, dtype=float).reshape(-1, 3)
        if x.shape != (len(t), 3) or not (np.isfinite(t).all() and np.isfinite(x).all()):
            raise ValueError(f"{len(t)} conditioned time(s) need as many finite positions (3,), not {x.shape}")
        H, R = self.features(t), _blocks(covariance, len(t))
        root, w = self._root, self.mean.ravel()
        if local:
            root = np.concatenate([root, self._bumps(t, x, R)], axis=1)
        S = root @ root.T
        K = np.linalg.lstsq(_symmetric(H @ S @ H.T + R).T, H @ S, rcond=1e-12)[0].T
        w = w + K @ (x.ravel() - H @ w)
        root = root - K @ (H @ root)  # of roots, since what is left of a bump is but the rounding of its square
        S = root @ root.T + K @ R @ K.T
        if covariance is None:  # roundoff and singular S leave a remainder: the nearest weights that have none
            w = _nearest(w, H, x.ravel())
            free = np.eye(len(w)) - np.linalg.pinv(H, rcond=1e-10) @ H
            S = free @ S @ free.T
            if np.abs(H @ w - x.ravel()).max() > EXACT:
                raise ValueError(f"no trajectory of this basis passes all {len(t)} points at t = {np.round(t, 4)}: "
                                 "conditions at (nearly) the same time contradict each other")
        return replace(self, mean=w.reshape(-1, 3), covariance=_symmetric(S))

    @property
    def _root(self) -> np.ndarray:
        """(3M, 3M) with _root _root^T = S; an eigendecomposition, since S may be singular: what is but rounding is 0."""
        values, vectors = np.linalg.eigh(self.covariance)
        rounding = len(values) * np.finfo(float).eps * values[-1]
        return vectors * np.sqrt(np.where(values > rounding, values, 0.0))

    def _bumps(self, t, x, R) -> np.ndarray:
        """Root (3M, B) [m] of the covariance of bumps of free height around the conditions that S does not explain.

        A condition's squared Mahalanobis distance m beyond LIKELY comes down to LIKELY^2 / m by the bump's variance, so
        that S answers for the share (LIKELY / m)^2 of the way: all of it at LIKELY, nearly nothing of it far away.
        """
        bumps = [np.zeros((len(self.covariance), 0))]
        for k, (time, position) in enumerate(zip(t, x, strict=True)):
            C = self.covariance_at(time)[0] + R[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            C = C + (EXACT**2 + 1e-12 * np.trace(C)) * np.eye(3)
            off = position - self.mean_at(time)[0]
            m = off @ np.linalg.solve(C, off)
            if m > LIKELY:
                variance = (off @ off) * min(m / LIKELY**2 - 1 / m, FAR)
                bumps.append(np.sqrt(variance) * self._bump(time))
        return np.concatenate(bumps, axis=1)

    def _bump(self, time) -> np.ndarray:
        """(3M, 3): weights of a bump of height 1 around a time, along each axis, as near to it as what S leaves free comes."""
        grid = np.linspace(0, 1, 200)
        away = grid - time
        if self.basis.period:
            away = (away + self.basis.period / 2) % self.basis.period - self.basis.period / 2
        values, vectors = np.linalg.eigh(self.covariance)
        free = vectors[:, values > 1e-11 * values[-1]]  # what was met exactly before stays so
        H = self.features(grid) @ free
        A, target = H.T @ H, np.kron(np.exp(-(away**2) / (2 * BUMP**2))[:, None], np.eye(3))
        return free @ np.linalg.solve(A + 1e-6 * np.trace(A) / len(A) * np.eye(len(A)), H.T @ target)

    def with_first_weight(self, x) -> "TrajectoryDistribution":
        """The paper's way to start at x (3,) [m]: every sample keeps W_2: and alters W_1 so that xi(0) = x, eq.
        (10).

        Only the first bump of the basis moves; ``condition(0, x)`` moves all that is correlated with the start.
        """
        Phi, M = self.basis(0.0)[0], self.basis.count
        A = np.eye(M)
        A[0] = -Phi / Phi[0]
        A[0, 0] = 0.0
        mean = A @ self.mean
        mean[0] += np.asarray(x, dtype=float).reshape(3) / Phi[0]
        A = np.kron(A, np.eye(3))
        return replace(self, mean=mean, covariance=_symmetric(A @ self.covariance @ A.T))


@dataclass(frozen=True, eq=False)
class Route:
    """One of several ways to perform a motion. share: of the strokes that draw it, in (0, 1]."""

    share: float
    distribution: TrajectoryDistribution


@dataclass(frozen=True, eq=False)
class Skill:
    """What was taught.

    distribution: of the motion, or of the way that most strokes draw. routes: all ways, that one first, where there
    are several: the motion is their mixture, weighted by shares. conditioning: how a motion starts where the hand is,
    "gaussian" or the paper's "first_weight". duration: of the motion [s]. events: Events at times [s] of the skill. orientation: of the
    hand: None, rows (t, quat_xyzw) (K, 5), or what teach.orientation says, such as {"kind": "down"}. keep_out: Sketches of the regions to avoid. report: plain numbers and sentences about the fit
    (JSON).
    """

    distribution: TrajectoryDistribution
    duration: float
    events: tuple[Event, ...] = ()
    orientation: Float[np.ndarray, "K 5"] | dict | None = None
    keep_out: tuple[Sketch, ...] = ()
    report: dict = field(default_factory=dict)
    routes: tuple[Route, ...] = ()
    conditioning: str = "gaussian"

    def __post_init__(self):
        if self.conditioning not in CONDITIONING:
            raise ValueError(f"conditioning is one of {', '.join(CONDITIONING)}, not {self.conditioning!r}")
        if not 0 < self.duration < np.inf:
            raise ValueError(f"a skill's duration is positive, not {self.duration} s")
        if isinstance(self.orientation, dict):
            object.__setattr__(self, "orientation", _pointed(self.orientation))
        elif self.orientation is not None:
            orientation = np.array(self.orientation, dtype=float)
            if orientation.ndim != 2 or orientation.shape[1] != 5:
                raise ValueError(f"a skill's orientation has rows (t, quat_xyzw) (K, 5), not {orientation.shape}")
            object.__setattr__(self, "orientation", orientation)
        object.__setattr__(self, "duration", float(self.duration))
        object.__setattr__(self, "events", tuple(self.events))
        object.__setattr__(self, "keep_out", tuple(self.keep_out))
        object.__setattr__(self, "routes", tuple(self.routes))

    @property
    def hand(self) -> str | list | None:
        """How the hand is to be turned, in the words of robot.planner.orientation: "keep", "down" or an axis [x, y, z]; None
        where nothing is said, or rows of orientations are."""
        return self.orientation.get("axis", self.orientation["kind"]) if isinstance(self.orientation, dict) else None

    @property
    def ways(self) -> tuple[Route, ...]:
        """The routes; a skill without any goes one way."""
        return self.routes or (Route(1.0, self.distribution),)

    def starting_at(self, x) -> tuple[Route, ...]:
        """The ways, each conditioned to start at x (3,) [m]."""
        start = (lambda d: d.condition(0.0, x)) if self.conditioning == "gaussian" else lambda d: d.with_first_weight(x)
        return tuple(Route(way.share, start(way.distribution)) for way in self.ways)

    def save(self, path) -> None:
        """Write an npz file, whole or not at all."""
        d = self.distribution
        text = {
            "kind": "scene2skill.skill",
            "version": 2,
            "basis": {"kind": type(d.basis).__name__, **asdict(d.basis)},
            "events": [[event.name, event.time] for event in self.events],
            "keep_out": dumps(self.keep_out),
            "report": self.report,
            "conditioning": self.conditioning,
            "hand": self.orientation if isinstance(self.orientation, dict) else None,
        }
        arrays = {"mean": d.mean, "covariance": d.covariance, "duration": self.duration, "text": json.dumps(text)}
        if isinstance(self.orientation, np.ndarray):
            arrays["orientation"] = self.orientation
        if self.routes:
            arrays["route_shares"] = [route.share for route in self.routes]
            arrays["route_means"] = np.stack([route.distribution.mean for route in self.routes])
            arrays["route_covariances"] = np.stack([route.distribution.covariance for route in self.routes])
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **arrays)

    @classmethod
    def load(cls, path) -> "Skill":
        """Read what ``save`` wrote. Raises FileNotFoundError, or ValueError for any other file."""
        return parse_npz(path, "a skill file", "teach.fit", cls._parsed)

    @classmethod
    def _parsed(cls, arrays) -> "Skill":
        text = json.loads(str(arrays["text"]))
        if text["kind"] != "scene2skill.skill" or text["version"] not in (1, 2):
            raise ValueError(f"version {text['version']!r} of {text['kind']!r}, expected 1 or 2 of 'scene2skill.skill'")
        basis = _basis(**text["basis"])
        distribution = TrajectoryDistribution(basis, arrays["mean"], arrays["covariance"])
        variances = np.linalg.eigvalsh(distribution.covariance)
        if variances[0] < -1e-6 * max(variances[-1], 1e-12):
            raise ValueError("its covariance is none: it has negative variances")
        parts = [arrays.get(f"route_{name}", ()) for name in ("shares", "means", "covariances")]
        routes = tuple(Route(float(p), TrajectoryDistribution(basis, m, S)) for p, m, S in zip(*parts, strict=True))
        events = tuple(Event(str(name), float(time)) for name, time in text["events"])
        return cls(distribution, float(arrays["duration"]), events, text.get("hand") or arrays.get("orientation"),
                   tuple(loads(text["keep_out"])), text["report"], routes, text.get("conditioning", "gaussian"))


def _pointed(orientation: dict) -> dict:
    """What is said of a hand, with the axis along which it points."""
    if orientation.get("kind") == "along" and orientation.get("axis") is None:
        raise ValueError("a hand that points along something has an axis [x, y, z]")
    return held(orientation)


def _basis(kind: str = "SquaredExponential", **settings) -> SquaredExponential | Periodic:
    """The basis that a file describes; one of version 1 names no kind."""
    if kind not in BASES:
        raise ValueError(f"its basis is {kind!r}, known are {', '.join(BASES)}")
    return BASES[kind](**settings)


def _blocks(covariance, count: int) -> np.ndarray:
    """(3K, 3K) block diagonal of None (zero), (3, 3) or (K, 3, 3)."""
    R = np.zeros((count, 3, count, 3))
    if covariance is not None:
        R[range(count), :, range(count)] = np.broadcast_to(np.asarray(covariance, dtype=float), (count, 3, 3))
    return R.reshape(3 * count, 3 * count)


def _nearest(w, H, x) -> np.ndarray:
    """The weights nearest to w with H w = x; two steps, the second against roundoff."""
    inverse = np.linalg.pinv(H, rcond=1e-10)
    for _ in range(2):
        w = w + inverse @ (x - H @ w)
    return w


def _symmetric(A) -> np.ndarray:
    return (A + A.T) / 2
