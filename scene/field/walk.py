"""Where on a ray the samples lie, in torch: even steps through occupied cells, and leaps over empty ones.

Notation as in `scene.field.volume`. All rays go one step or leap together, without a loop over rays; distances are those of
`scene.field.kernels.march`, which goes one ray at a time.
"""

import warnings

import torch

from scene.field.volume import along

BURST = 16
"""So many steps or leaps are made before it is asked which rays go on."""
AFTER = 4096
"""Calls of `once` before it is compiled for a GPU: thirty steps of training, or a few pictures."""


def cell(c: torch.Tensor, size: int) -> torch.Tensor:
    """Number (n,) int64 of the cell at contracted places (n, 3), of ``size`` cells an axis: 64 * block + place in the block."""
    x, y, z = ((c + 2) * (0.25 * size)).long().clamp_(0, size - 1).unbind(-1)
    blocks = size >> 2
    block = ((x >> 2) * blocks + (y >> 2)) * blocks + (z >> 2)
    return (block << 6) + ((x & 3) << 4) + ((y & 3) << 2) + (z & 3)


def burst(advance, origins, directions, t, far, step: torch.Tensor, size: int, distance, mask):
    """`BURST` times ``advance`` (`once`, or `fused`) of rays (n, 3) that are at t (n,) and end at far (n,).

    Returns the distances (n, BURST), which of them are samples (n, BURST), how fast c moves there (n, BURST), and where the rays are
    then (n,).
    """
    distances, samples, speeds = [], [], []
    for _ in range(BURST):
        distances.append(t)
        t, sample, speed = advance(origins, directions, t, far, step, size, distance, mask)
        samples.append(sample)
        speeds.append(speed)
    return torch.stack(distances, 1), torch.stack(samples, 1), torch.stack(speeds, 1), t


def once(origins, directions, t, far, step: torch.Tensor, size: int, distance, mask):
    """One step or leap from t (n,), through ``size`` cells an axis: to where, whether t is a sample, and how fast c moves there.

    step (): between samples, contracted. distance, mask: of the blocks, as in `scene.field.occupancy.Occupancy`, the mask's bits as int64.
    """
    c, v, r = along(origins, directions, t)
    speed = v.norm(dim=-1)
    number = cell(c, size)
    empty = distance[number >> 6]
    far_off = empty > 0
    occupied = (mask[number >> 6] >> (number & 63) & 1).bool() & ~far_off
    leap = _leap(c, v, r, speed, torch.where(far_off, size >> 2, size), torch.where(far_off, empty, 1), step)
    going = t < far
    return torch.where(going, t + torch.where(occupied, step / speed, leap), t), going & occupied, speed


def fused(device: torch.device):
    """`once` for a device; on a GPU, it is compiled when it has been called `AFTER` times.

    Its hundred small kernels take longer to start than to run; compiled they are a few, but compiling takes seconds, which
    do not pay for a picture or two. Where torch cannot compile, a warning says so.
    """
    function, calls = once, 0

    def advance(*arguments):
        nonlocal function, calls
        calls += 1
        if calls == AFTER and device.type == "cuda":
            function = torch.compile(once, dynamic=True)
        try:
            return function(*arguments)
        except RuntimeError as error:
            if function is once:
                raise
            reason = str(error).strip().partition("\n")[0]
            warnings.warn(f"torch cannot compile for this GPU ({reason}); the field goes on without, but is slower", stacklevel=2)
            function = once
            return once(*arguments)

    return advance


def _leap(c, v, r, speed, size, empty, step: torch.Tensor) -> torch.Tensor:
    """How far (n,) rays may go where the nearest occupied of ``size`` (n,) cells an axis is ``empty`` (n,) cells away.

    In the box they are straight: to where they leave the empty cells, or the box. Outside they are bent, but no axis
    moves faster than ``speed``, which changes at most twofold over a quarter of r, the L-inf norm of the point.
    """
    scale = (0.25 * size)[:, None]
    p = (c + 2) * scale
    index = torch.minimum(p.floor().clamp_min(0), size[:, None] - 1)
    room = torch.where(v > 0, index + empty[:, None] - p, p - index + (empty[:, None] - 1))
    out = ((room + 1e-3) / (v.abs() * scale).clamp_min(1e-9)).amin(-1)
    leaves = ((1 - torch.where(v > 0, c, -c)) / v.abs().clamp_min(1e-9)).amin(-1)
    straight = torch.minimum(out, leaves.clamp_min(step))
    bent = torch.minimum(2 * (empty - 1) / (size * speed), 0.25 * r)
    return torch.where(r <= 1, straight, torch.maximum(bent, step / speed))
