"""The maths of volume rendering: how a ray becomes a colour and a depth.

Notation
    x = o + t d             a point of a ray: origin o, unit direction d, distance t
    c = contract(x)         its place in contracted space, where the box of interest is [-1, 1]^3 and
                            everything outside it lies between there and [-2, 2]^3
    |dc/dt|                 how fast c moves along the ray: 1 in the box, less outside it
    sigma_i, delta_i        density of sample i [1 / contracted length] and the contracted length it stands for
    alpha_i = 1 - exp(-sigma_i delta_i)
    T_i = prod_{j<i} (1 - alpha_j)      transmittance: the light that reaches sample i
    w_i = T_i alpha_i                   its weight;   sum_i w_i + T_end = 1

Samples are spaced evenly in contracted space, so that a sample always stands for as much as the grid
resolves there. Everything here is torch, differentiable and free of state: `scene.field.twin` marches with it on any device,
and `scene.field.kernels` does the same by hand for a CPU.
"""

import numpy as np
import torch


def contract(x: torch.Tensor) -> torch.Tensor:
    """Unbounded space (..., 3) -> the cube of half width 2; mip-NeRF 360's contraction in the L-inf norm."""
    r = x.abs().amax(-1, keepdim=True).clamp_min(1.0)
    return x * (2 * r - 1) / r**2


def along(o: torch.Tensor, d: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """c and dc/dt (n, 3) at the points o + t d of rays (n, 3), and the points' L-inf norms r (n,).

    With x_k the largest of |x|, r = |x_k| > 1 and c = (2/r - 1/r^2) x:   dc/dt = (2/r - 1/r^2) d + 2 (1 - r)/r^3 dr/dt x.
    """
    x = torch.addcmul(o, d, t[:, None])
    r, k = x.abs().max(-1, keepdim=True)
    near = 1 / r.clamp_min(1.0)
    g = (2 - near) * near
    bend = 2 * (near - 1) * near**2 * (d * x.sign()).gather(-1, k)
    return x * g, d * g + x * bend, r[:, 0]


def opacity(sigma: torch.Tensor, delta: torch.Tensor) -> torch.Tensor:
    """alpha of a stretch of length delta and uniform density sigma."""
    return -torch.expm1(-sigma * delta)


def composite(alpha: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """alpha (rays, samples), front to back -> weights (rays, samples) and the transmittance left at the end (rays,)."""
    through = torch.cumprod(1 - alpha, dim=-1)
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], dim=-1)
    return before * alpha, through[:, -1]


def median_depth(alpha: torch.Tensor, near: torch.Tensor, far: torch.Tensor) -> torch.Tensor:
    """Where the transmittance crosses one half (rays,); nan where it never does.

    near, far (rays, samples): the stretch of the ray each sample stands for. Within it the density is
    uniform, so the transmittance falls exponentially: T(s) = T_i (1 - alpha_i)^s for s in [0, 1].
    """
    through = torch.cumprod(1 - alpha, dim=-1)
    crossed = through <= 0.5
    first = crossed.to(torch.int8).argmax(-1, keepdim=True)
    before = torch.where(first > 0, through.gather(-1, (first - 1).clamp_min(0)), 1.0)
    kept = 1 - alpha.gather(-1, first)
    s = (torch.log(2 * before) / -torch.log(kept.clamp_min(1e-12))).clamp(0, 1)
    start, end = near.gather(-1, first), far.gather(-1, first)
    return torch.where(crossed.any(-1, keepdim=True), start + s * (end - start), torch.nan).squeeze(-1)


def harmonics(directions: torch.Tensor) -> torch.Tensor:
    """Real spherical harmonics (n, 9) of unit directions (n, 3) to the second degree, but for their factors."""
    x, y, z = directions.unbind(-1)
    return torch.stack([torch.ones_like(x), x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], -1)


def shade(channels, through, directions, behind, inner, outer) -> torch.Tensor:
    """Composited colour and features (n, 6) -> colour (n, 3) = diffuse + T behind + outer^T relu(inner^T x).

    through (n,): T; directions (n, 3); behind (n, 3): what the rays meet behind everything. x (n, 15): the channels, and harmonics of
    the direction as far as the ray is opaque. There is no bias: where a ray hits nothing, x = 0 and one sees what is behind.
    """
    hidden = torch.relu(torch.cat([channels, harmonics(directions) * (1 - through)[:, None]], -1) @ inner)
    return channels[:, :3] + through[:, None] * behind + hidden @ outer


def psnr(a, b) -> float:
    """Peak signal-to-noise ratio [dB] of two pictures, both uint8 or both floats in [0, 1]."""
    a, b = (np.asarray(p, dtype=np.float64) / (255.0 if np.asarray(p).dtype == np.uint8 else 1.0) for p in (a, b))
    if a.shape != b.shape:
        raise ValueError(f"pictures of one shape are compared, not {a.shape} and {b.shape}")
    return float(-10 * np.log10(max(np.mean((a - b) ** 2), 1e-12)))


def ssim(a, b, sigma: float = 1.5) -> float:
    """Structural similarity of two pictures (H, W, C), uint8 both (Wang et al. 2004): 1 for equal ones.

    (2 m_a m_b + c1) (2 s_ab + c2) / ((m_a^2 + m_b^2 + c1) (s_a^2 + s_b^2 + c2)), means m and covariances s under a Gaussian of
    ``sigma`` [px] that is cut off after 5, averaged over all windows inside the picture and the channels.
    """
    import cv2

    a, b = (np.asarray(p, dtype=np.float64) for p in (a, b))
    if a.shape != b.shape or min(a.shape[:2]) < 11:
        raise ValueError(f"pictures of one shape, 11 pixels or more each way, are compared, not {a.shape} and {b.shape}")
    mean = lambda x: cv2.GaussianBlur(x, (11, 11), sigma)[5:-5, 5:-5]
    m_a, m_b, c1, c2 = mean(a), mean(b), (0.01 * 255) ** 2, (0.03 * 255) ** 2
    s_a, s_b, s_ab = mean(a * a) - m_a**2, mean(b * b) - m_b**2, mean(a * b) - m_a * m_b
    return float(((2 * m_a * m_b + c1) * (2 * s_ab + c2) / ((m_a**2 + m_b**2 + c1) * (s_a + s_b + c2))).mean())
