"""What a field is asked and what it answers, whoever does the marching: `scene.field.kernels` or `scene.field.twin`."""

from dataclasses import dataclass

import numpy as np


@dataclass(eq=False)
class Rays:
    """n rays in normalised coordinates. origins, directions (n, 3); near (n,): all float32."""

    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray


@dataclass(eq=False)
class Marched:
    """Composited channels (n, 8), transmittance (n,), median distance (n,), and the samples they are made of.

    samples: of each ray the first one's place and their number (n,); of each sample distance, alpha and channels.
    """

    channels: np.ndarray
    through: np.ndarray
    distance: np.ndarray
    samples: tuple
