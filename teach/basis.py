"""Basis functions: the features of time of which a trajectory is a weighted sum.

Notation
    xi(t) = W^T Phi(t)      Phi(t) = [phi_1(t), ..., phi_M(t)]^T     M basis functions of normalised time t in [0, 1]
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SquaredExponential:
    """phi_i(t) = exp(-gamma (t - t_i)^2), centres t_i evenly in [0, 1] (Zhi et al. 2023, Section IV-B; not normalised).

    count: M, the number of functions. gamma: sharpness [1 / time^2], smaller is smoother; the width is 1 / sqrt(2
    gamma).
    """

    count: int = 20
    gamma: float = 50.0

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
