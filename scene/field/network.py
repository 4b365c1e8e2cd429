"""The network's inner loops for a CPU: composited channels and a direction of view -> a colour, forward and backward.

`scene.field.volume.shade` is the same in torch. Kernels work on a range of rays, see `scene.field.kernels.in_parallel`.
"""

import numpy as np
from numba import njit

from scene.field.kernels import FAST


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
def _inputs(channels, through, directions, ray, x):
    """The network's 15 inputs: the composited channels, and the direction's harmonics as far as the ray is opaque."""
    for c in range(6):
        x[c] = channels[ray, c + 1]
    dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
    x[6], x[7], x[8], x[9] = np.float32(1.0), dx, dy, dz
    x[10], x[11], x[12] = dx * dy, dy * dz, dx * dz
    x[13], x[14] = dx * dx - dy * dy, np.float32(3.0) * dz * dz - np.float32(1.0)
    for k in range(6, 15):
        x[k] *= np.float32(1.0) - through[ray]


@njit(**FAST)
def shade(first, last, piece, channels, through, directions, background, inner, outer, colour):
    """Composited channels (n, 8) -> colour (n, 3) = diffuse + T background + outer^T relu(inner^T x).

    background (n, 3): what each ray meets behind everything; inner (15, H), outer (H, 3). There is no bias: where a
    ray hits nothing, x = 0 and the background is seen as it is.
    """
    width = inner.shape[1]
    x, hidden = np.empty(15, np.float32), np.empty(width, np.float32)
    for ray in range(first, last):
        _inputs(channels, through, directions, ray, x)
        hidden[:] = 0.0
        for k in range(15):
            for j in range(width):
                hidden[j] += x[k] * inner[k, j]
        t = through[ray]
        r, g, b = x[0] + t * background[ray, 0], x[1] + t * background[ray, 1], x[2] + t * background[ray, 2]
        for j in range(width):
            h = max(hidden[j], np.float32(0.0))
            r += h * outer[j, 0]
            g += h * outer[j, 1]
            b += h * outer[j, 2]
        colour[ray, 0], colour[ray, 1], colour[ray, 2] = r, g, b


@njit(**FAST)
def shade_back(
    first, last, piece, channels, through, directions, background, inner, outer, grad_colour,
    grad_channels, grad_through, grad_inner, grad_outer,
):  # fmt: skip
    """Backward of `shade`. The gradients of the parameters have one more, leading, axis: a slice for each piece."""
    width = inner.shape[1]
    x, hidden, grad_hidden = np.empty(15, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    to_inner, to_outer = grad_inner[piece], grad_outer[piece]
    for ray in range(first, last):
        _inputs(channels, through, directions, ray, x)
        r, g, b = grad_colour[ray, 0], grad_colour[ray, 1], grad_colour[ray, 2]
        hidden[:] = 0.0
        for k in range(15):
            for j in range(width):
                hidden[j] += x[k] * inner[k, j]
        for j in range(width):
            h = max(hidden[j], np.float32(0.0))
            grad = r * outer[j, 0] + g * outer[j, 1] + b * outer[j, 2]
            grad_hidden[j] = grad if hidden[j] > 0 else np.float32(0.0)
            to_outer[j, 0] += h * r
            to_outer[j, 1] += h * g
            to_outer[j, 2] += h * b
        light = r * background[ray, 0] + g * background[ray, 1] + b * background[ray, 2]
        for k in range(15):
            total = np.float32(0.0)
            for j in range(width):
                total += inner[k, j] * grad_hidden[j]
                to_inner[k, j] += x[k] * grad_hidden[j]
            if k < 6:
                grad_channels[ray, k + 1] = total + (grad_colour[ray, k] if k < 3 else np.float32(0.0))
            elif through[ray] < np.float32(1.0):
                light -= total * x[k] / (np.float32(1.0) - through[ray])
        grad_channels[ray, 0] = grad_channels[ray, 7] = 0.0
        grad_through[ray] = light
