"""The faults of a person's hand: how repeated drawings of one motion differ. A Gaussian model with measured parameters.

Repetitions are compared at equal arc length. With x(u) the mean curve, c its centroid, E its extent (longest side of
its bounding box) and u in [0, 1] the arc length, a repetition deviates from it by

    d(u) = o + diag(k) (x(u) - c) + g(u)        o offset, k size of each axis, g smooth deviation
    integral g du = 0,  integral g (x - c) du = 0 for each axis       so that the three parts are unique

and the parameters are root mean squares over repetitions (over u too, for g):

    offset  |o| / E        size  |k (x - c)| / |x - c|       smooth  |g| / E        ends  |d(0)| / E and |d(1)| / E

A plane drawing has two coordinates; a motion in space has three, each as large as one of the plane, so that whoever
looks at it sees a plane drawing's fault. The faults of an end are smaller than its parts would add up to: a person aims
there.
"""

from dataclasses import dataclass, replace

import numpy as np

from teach.curve import extent, resample

PARTS = ("offset", "size", "smooth", "ends")
END_CORRELATION = 0.5
"""Of an end's fault with the offset and size it comes with: then g is as large at the ends as people's (0.036) is."""


@dataclass(frozen=True)
class Hand:
    """A person's hand.

    offset, size, smooth, ends: RMS faults of a stroke, as above; defaults are those of people's letters (2Dletters).
    correlation: length over which g forgets itself [of the arc length], the standard deviation of its kernel.
    intent_share: of the variance of these faults, the share that is in what the person means to do, a different path in
        space for each demonstration; the rest arises in drawing it, anew in each view.
    tremor: RMS of the pen's trembling [of the image width]; tremor_time: its duration [s], the kernel's deviation.
    speed: range of the standard deviation of log-speed, drawn for each stroke, at speed_knots places equally spaced
        along it. duration: range of a stroke's duration [s].
    rate: pen samples per second. grid: the pen's resolution [px], 0 for exact.
    """

    offset: float = 0.03
    size: float = 0.045
    smooth: float = 0.038
    ends: float = 0.037
    correlation: float = 0.13
    intent_share: float = 0.5
    tremor: float = 0.003
    tremor_time: float = 0.04
    speed: tuple[float, float] = (0.3, 0.6)
    speed_knots: int = 6
    duration: tuple[float, float] = (2.0, 4.0)
    rate: float = 100.0
    grid: float = 0.0

    def __post_init__(self):
        sizes = ("offset", "size", "smooth", "ends", "tremor", "grid")
        if wrong := [name for name in sizes if not 0 <= getattr(self, name) < np.inf]:
            raise ValueError(f"a hand's {', '.join(wrong)} cannot be negative")
        if not (0 <= self.intent_share <= 1 and min(self.correlation, self.tremor_time, self.rate, *self.duration) > 0):
            raise ValueError("a hand has intent_share in [0, 1], positive correlation, tremor_time, rate and duration")


def measure(curves, count: int = 200) -> dict[str, float]:
    """A person's offset, size, smooth and ends from repetitions of one drawing: curves (N_i, D), at least two.

    With n repetitions the mean takes away 1 / n of every variance; it is given back.
    """
    return _parts(np.stack([resample(curve, count) for curve in curves]))


def _parts(curves) -> dict[str, float]:
    """``measure`` of curves (n, T, D) that correspond point by point."""
    mean = curves.mean(axis=0)
    arms, total = mean - mean.mean(axis=0), curves - mean
    offset = total.mean(axis=1, keepdims=True)
    size = ((total - offset) * arms).sum(axis=1, keepdims=True) / (arms**2).sum(axis=0)
    unbiased = np.sqrt(len(curves) / (len(curves) - 1))
    plane = np.sqrt(2 / mean.shape[1]) * unbiased / extent(mean)
    return {
        "offset": float(plane * _rms(offset)),
        "size": float(unbiased * _rms(size * arms) / _rms(arms)),
        "smooth": float(plane * _rms(total - offset - size * arms)),
        "ends": float(plane * _rms(total[:, [0, -1]])),
    }


def scaled(hand: Hand, factor: float) -> Hand:
    """The hand with its offset, size, smooth and ends times ``factor``."""
    return replace(hand, **{name: factor * getattr(hand, name) for name in PARTS})


def faults(curve, hand: Hand, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, T, D) deviations d of ``count`` repetitions from ``curve`` (T, D) at equal arc length, in its unit.

    Each axis by itself: g is a Gaussian process with a squared-exponential kernel, conditioned on its two integrals
    being 0 and on the faults at its ends. ``measure`` of many repetitions finds what ``hand`` says, whatever the curve.
    """
    return _uncalibrated(curve, _calibrated(curve, hand), count, rng)


def _calibrated(curve, hand, count: int = 60, rounds: int = 3) -> Hand:
    """The hand to simulate so that ``hand`` is measured: equal arc length undoes some deviations and mixes others.

    A fixed point, found on repetitions that are the same in each round and call, so the caller's rng is not touched.
    What counts is by how much measuring them differs from knowing them, so that few will do.
    """
    simulated = hand
    for _ in range(rounds):
        repetitions = curve + _uncalibrated(curve, simulated, count, np.random.default_rng(0))
        known, found = _parts(repetitions), measure(repetitions)
        gains = {name: np.clip(known[name] / found[name], 0.5, 2.0) if found[name] > 0 else 1.0 for name in PARTS}
        simulated = replace(hand, **{name: getattr(hand, name) * float(gains[name]) for name in PARTS})
    return simulated


def _uncalibrated(curve, hand, count, rng) -> np.ndarray:
    """``faults`` as simulated, before the repetitions are put at equal arc length."""
    arms, sigma = curve - curve.mean(axis=0), extent(curve) / np.sqrt(2)  # of one axis
    offset = rng.normal(0, hand.offset * sigma, (count, 1, curve.shape[1]))
    size = rng.normal(0, hand.size, (count, 1, curve.shape[1]))
    rigid = offset + size * arms
    ends = _ends(rigid[:, [0, -1]], arms[[0, -1]], hand, sigma, rng)
    smooth = [_smooth(arms[:, k], (ends - rigid[:, [0, -1]])[..., k], hand, sigma, rng) for k in range(curve.shape[1])]
    return rigid + np.stack(smooth, axis=-1)


def own_speed(count: int, deviation: float, knots: int, rng: np.random.Generator) -> np.ndarray:
    """(count,) times in [0, 1] at equal steps of arc length of a stroke drawn at its own speed.

    The log-speed is normal with ``deviation`` at ``knots`` equally spaced places and linear in between.
    """
    places = np.linspace(0, 1, knots)
    slowness = np.exp(-np.interp(np.linspace(0, 1, count), places, rng.normal(0, deviation, knots)))
    times = np.concatenate([[0.0], np.cumsum((slowness[1:] + slowness[:-1]) / 2)])
    return times / times[-1]


def tremor(times, rms: float, duration: float, rng: np.random.Generator) -> np.ndarray:
    """(N, 2) trembling at equally spaced ``times`` (N,) [s]: white noise smoothed over ``duration`` [s].

    rms: of its vector, in the unit of the result.
    """
    step = times[1] - times[0]
    reach = int(np.ceil(4 * duration / step))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / duration) ** 2)
    kernel /= np.linalg.norm(kernel)
    noise = rng.normal(0, rms / np.sqrt(2), (2, len(times) + 2 * reach))
    return np.stack([np.convolve(axis, kernel, mode="valid") for axis in noise], axis=1)


def _ends(rigid, arms, hand, sigma, rng) -> np.ndarray:
    """(count, 2, D) faults of both ends, each with the RMS ``hand.ends``, correlated with the rigid part there."""
    deviation = np.hypot(hand.offset * sigma, hand.size * arms)
    common = END_CORRELATION * rigid / np.where(deviation > 0, deviation, 1.0)
    return hand.ends * sigma * (common + np.sqrt(1 - END_CORRELATION**2) * rng.normal(size=rigid.shape))


def _smooth(arm, ends, hand, sigma, rng) -> np.ndarray:
    """(count, T) smooth deviations of an axis: integrals 0, ``ends`` (count, 2), RMS ``hand.smooth * sigma``."""
    T = len(arm)
    u = np.linspace(0, 1, T)
    kernel = np.exp(-0.5 * ((u[:, None] - u) / hand.correlation) ** 2)
    constraints = np.stack([np.full(T, 1 / T), arm / max(np.abs(arm).sum(), 1e-12), np.eye(T)[0], np.eye(T)[-1]])
    gram = constraints @ kernel @ constraints.T
    gain = kernel @ constraints.T @ np.linalg.pinv(gram, rcond=1e-9, hermitian=True)  # (T, 4)
    factor = np.linalg.cholesky(kernel + 1e-8 * np.eye(T))
    free = rng.normal(size=(len(ends), T)) @ factor.T
    free -= free @ constraints.T @ gain.T
    forced = ends @ gain[:, 2:].T
    wanted = (hand.smooth * sigma) ** 2 - (forced**2).mean()
    spread = np.trace(kernel - gain @ constraints @ kernel) / T
    return forced + np.sqrt(max(wanted, 0.0) / spread) * free


def _rms(vectors):
    """Root mean square length of vectors (..., D)."""
    return np.sqrt((vectors**2).sum(axis=-1).mean())
