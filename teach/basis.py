"""Basis functions: the features of time of which a trajectory is a weighted sum.

Notation
    xi(t) = W^T Phi(t)      Phi(t) = [phi_1(t), ..., phi_M(t)]^T     M basis functions of normalised time t; eq. (4)

A basis says its ``period``: None, or the time after which all that it expresses repeats.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SquaredExponential:
    """phi_i(t) = exp(-gamma (t - t_i)^2), centres t_i evenly in [0, 1] (Zhi et al. 2023, eq. (5); not normalised).

    count: M, the number of functions. gamma: sharpness [1 / time^2], smaller is smoother; the width is 1 / sqrt(2
    gamma): by default a fiftieth of the time, since wider ones cut corners.
    """

    count: int = 100
    gamma: float = 1250.0

    period = None

    def __post_init__(self):
        if self.count < 2 or not 0 < self.gamma < np.inf:
            raise ValueError(f"a basis has count >= 2 and gamma > 0, not {self.count} and {self.gamma}")

    @property
    def centres(self) -> np.ndarray:
        """t_i, (M,)."""
        return np.linspace(0.0, 1.0, self.count)

    def __call__(self, t) -> np.ndarray:
        """Phi at times t (T,) -> (T, M)."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        return np.exp(-self.gamma * (t[:, None] - self.centres) ** 2)

    def wrapped(self) -> "Periodic":
        """The periodic basis with as many functions, as wide near their centres: gamma = 2 pi^2 kappa."""
        return Periodic(self.count, self.gamma / (2 * np.pi**2))


@dataclass(frozen=True)
class Periodic:
    """phi_i(t) = exp(kappa (cos(2 pi (t - t_i)) - 1)), centres t_i = i / M: von Mises bumps (Ijspeert et al. 2013).

    Time goes round a circle: xi(t) = xi(t + 1) with all derivatives, for any weights. count: M, the number of
    functions. kappa: concentration, smaller is smoother; near its centre a bump is exp(-gamma (t - t_i)^2) with gamma =
    2 pi^2 kappa.
    """

    count: int = 20
    kappa: float = 2.5

    period = 1.0

    def __post_init__(self):
        if self.count < 2 or not 0 < self.kappa < np.inf:
            raise ValueError(f"a basis has count >= 2 and kappa > 0, not {self.count} and {self.kappa}")

    @property
    def centres(self) -> np.ndarray:
        """t_i, (M,)."""
        return np.arange(self.count) / self.count

    def __call__(self, t) -> np.ndarray:
        """Phi at times t (T,) -> (T, M)."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        return np.exp(self.kappa * (np.cos(2 * np.pi * (t[:, None] - self.centres)) - 1))
