"""The field's inner loops for a CPU: marching rays through the grid, forward and backward.

Notation as in `scene.volume` and `scene.grid`. Every kernel works on a range [first, last) of rays or
voxels without the interpreter's lock, so `in_parallel` spreads it over threads; two threads add their
gradients to the same voxels without locks, which loses a few additions and is not bit-reproducible:
one thread is. `scene.volume` and `scene.grid` hold the same maths in torch, and the tests compare them.

A voxel's 8 floats are read and written as one SIMD vector, which numba's own vectoriser does not find;
the two intrinsics at the top say it in LLVM's words and work on every processor.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.extending import intrinsic

CHANNELS = 8
THREADS = min(2, os.cpu_count() or 1)
_POOL = ThreadPoolExecutor(THREADS)
_FAST = {"nogil": True, "cache": True, "fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}


def in_parallel(kernel, count: int, threads: int, *arguments) -> None:
    """Run ``kernel(first, last, thread, *arguments)`` over [0, count), split evenly among ``threads``."""
    if threads == 1:
        return kernel(0, count, 0, *arguments)
    bounds = [count * k // threads for k in range(threads + 1)]
    jobs = [_POOL.submit(kernel, bounds[k], bounds[k + 1], k, *arguments) for k in range(threads)]
    for job in jobs:
        job.result()


def _vector_pointer(context, builder, array_type, array, row):
    """Address of row ``row`` of a C-contiguous (n, 8) float32 array, as a pointer to <8 x float>."""
    data = context.make_array(array_type)(context, builder, array).data
    offset = builder.mul(row, ir.Constant(row.type, CHANNELS))
    return builder.bitcast(builder.gep(data, [offset]), ir.VectorType(ir.FloatType(), CHANNELS).as_pointer())


def _splat(builder, scalar):
    vector = ir.Constant(ir.VectorType(ir.FloatType(), CHANNELS), ir.Undefined)
    vector = builder.insert_element(vector, scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(vector, vector, ir.Constant(ir.VectorType(ir.IntType(32), CHANNELS), [0] * CHANNELS))


@intrinsic
def _gather(typingctx, out, out_row, values, rows, weights):
    """out[out_row] += sum_k weights[k] * values[rows[k]], for eight k."""

    def generate(context, builder, signature, arguments):
        out_type, _, values_type, _, _ = signature.args
        out_value, out_index, values_value, row_tuple, weight_tuple = arguments
        target = _vector_pointer(context, builder, out_type, out_value, out_index)
        total = builder.load(target, align=4)
        for row, weight in zip(cgutils.unpack_tuple(builder, row_tuple), cgutils.unpack_tuple(builder, weight_tuple)):
            vector = builder.load(_vector_pointer(context, builder, values_type, values_value, row), align=4)
            total = builder.fadd(total, builder.fmul(vector, _splat(builder, weight), flags=["fast"]), flags=["fast"])
        builder.store(total, target, align=4)
        return context.get_dummy_value()

    return types.none(out, out_row, values, rows, weights), generate


@intrinsic
def _scatter(typingctx, gradient, rows, weights, vector, vector_row):
    """gradient[rows[k]] += weights[k] * vector[vector_row], for eight k."""

    def generate(context, builder, signature, arguments):
        gradient_type, _, _, vector_type, _ = signature.args
        gradient_value, row_tuple, weight_tuple, vector_value, vector_index = arguments
        source = builder.load(_vector_pointer(context, builder, vector_type, vector_value, vector_index), align=4)
        for row, weight in zip(cgutils.unpack_tuple(builder, row_tuple), cgutils.unpack_tuple(builder, weight_tuple)):
            target = _vector_pointer(context, builder, gradient_type, gradient_value, row)
            added = builder.fmul(source, _splat(builder, weight), flags=["fast"])
            builder.store(builder.fadd(builder.load(target, align=4), added, flags=["fast"]), target, align=4)
        return context.get_dummy_value()

    return types.none(gradient, rows, weights, vector, vector_row), generate


@njit(forceinline=True, fastmath=_FAST["fastmath"], error_model="numpy")
def _place(ox, oy, oz, dx, dy, dz, t):
    """Contracted place of o + t d, the speed |dc/dt| there, and the L-inf norm of the point."""
    x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
    ax, ay, az = abs(x), abs(y), abs(z)
    r = max(ax, ay, az)
    if r <= 1.0:
        return x, y, z, np.float32(1.0), r
    if ax >= ay and ax >= az:
        dr = dx if x > 0 else -dx
    elif ay >= az:
        dr = dy if y > 0 else -dy
    else:
        dr = dz if z > 0 else -dz
    inverse = np.float32(1.0) / r
    g = (np.float32(2.0) - inverse) * inverse
    k = np.float32(2.0) * (np.float32(1.0) - r) * inverse * inverse * inverse * dr
    vx, vy, vz = dx * g + x * k, dy * g + y * k, dz * g + z * k
    return x * g, y * g, z * g, np.sqrt(vx * vx + vy * vy + vz * vz), r


@njit(forceinline=True, fastmath=_FAST["fastmath"], error_model="numpy")
def _corners(cx, cy, cz, size, table, start):
    """The eight voxels around a contracted place on a level of ``size`` cells, and their trilinear weights."""
    scale = np.float32(0.25) * np.float32(size)
    px, py, pz = (cx + np.float32(2.0)) * scale, (cy + np.float32(2.0)) * scale, (cz + np.float32(2.0)) * scale
    x0 = min(max(np.int64(px), 0), size - 1)
    y0 = min(max(np.int64(py), 0), size - 1)
    z0 = min(max(np.int64(pz), 0), size - 1)
    fx, fy, fz = px - np.float32(x0), py - np.float32(y0), pz - np.float32(z0)
    gx, gy, gz = np.float32(1.0) - fx, np.float32(1.0) - fy, np.float32(1.0) - fz
    bricks = (size >> 2) + 1
    bx0, bx1 = start + (x0 >> 2) * bricks * bricks, start + ((x0 + 1) >> 2) * bricks * bricks
    by0, by1 = (y0 >> 2) * bricks, ((y0 + 1) >> 2) * bricks
    bz0, bz1 = z0 >> 2, (z0 + 1) >> 2
    lx0, lx1 = (x0 & 3) << 4, ((x0 + 1) & 3) << 4
    ly0, ly1 = (y0 & 3) << 2, ((y0 + 1) & 3) << 2
    lz0, lz1 = z0 & 3, (z0 + 1) & 3
    rows = (
        (np.int64(table[bx0 + by0 + bz0]) << 6) + lx0 + ly0 + lz0,
        (np.int64(table[bx0 + by0 + bz1]) << 6) + lx0 + ly0 + lz1,
        (np.int64(table[bx0 + by1 + bz0]) << 6) + lx0 + ly1 + lz0,
        (np.int64(table[bx0 + by1 + bz1]) << 6) + lx0 + ly1 + lz1,
        (np.int64(table[bx1 + by0 + bz0]) << 6) + lx1 + ly0 + lz0,
        (np.int64(table[bx1 + by0 + bz1]) << 6) + lx1 + ly0 + lz1,
        (np.int64(table[bx1 + by1 + bz0]) << 6) + lx1 + ly1 + lz0,
        (np.int64(table[bx1 + by1 + bz1]) << 6) + lx1 + ly1 + lz1,
    )
    a, b, c, d = gx * gy, gx * fy, fx * gy, fx * fy
    return rows, (a * gz, a * fz, b * gz, b * fz, c * gz, c * fz, d * gz, d * fz)


@njit(forceinline=True, fastmath=_FAST["fastmath"], error_model="numpy")
def _cell(cx, cy, cz, size):
    """Index of a contracted place's cell in an occupancy grid of ``size`` cells an axis."""
    scale = np.float32(0.25) * np.float32(size)
    x = min(max(np.int64((cx + np.float32(2.0)) * scale), 0), size - 1)
    y = min(max(np.int64((cy + np.float32(2.0)) * scale), 0), size - 1)
    z = min(max(np.int64((cz + np.float32(2.0)) * scale), 0), size - 1)
    return (x * size + y) * size + z


@njit(forceinline=True, fastmath=_FAST["fastmath"], error_model="numpy")
def _skip(empty, cell, step, speed, r):
    """How far a ray may go [t] when the nearest occupied cell is ``empty`` cells away.

    Outside the box the speed changes along the ray (at most twofold over a quarter of r), hence the half.
    """
    length = max(np.float32(empty - 1) * cell, step) / speed
    if r > np.float32(1.0) and empty > 1:
        return max(min(np.float32(0.5) * length, np.float32(0.25) * r), step / speed)
    return length


@njit(**_FAST)
def march(
    first, last, thread, origins, directions, near, far, jitter, step, thickness, occupancy_size, distance, visible, seen,
    sizes, table, starts, values, shift, stop, thin, keep, capacity, sample_first, sample_count,
    sample_cell, sample_t, sample_stretch, sample_alpha, sample_feature, out, out_through, out_depth,
):  # fmt: skip
    """Forward: composite the grid's channels 1..7 along each ray, and keep the samples for `march_back`.

    origins, directions (n, 3); near, far, jitter (n,), jitter in [0, 1) of a step. The samples of a ray lie at
    sample_first[ray] + [0, sample_count[ray]). out (n, 8): channel 0 holds the expected distance, 1..7 the
    composited features; out_through (n,): transmittance left; out_depth (n,): distance where it crosses 1/2, or nan.
    """
    cell = np.float32(4.0) / np.float32(occupancy_size)
    cursor = capacity * first
    end = capacity * last
    for ray in range(first, last):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        t = near[ray]
        cx, cy, cz, speed, r = _place(ox, oy, oz, dx, dy, dz, t)
        t += jitter[ray] * step / speed
        through = np.float32(1.0)
        depth = np.float32(np.nan)
        expected = np.float32(0.0)
        largest = np.float32(0.0)
        sample_first[ray] = cursor
        count = 0
        stretch = np.float32(2.0)
        for c in range(CHANNELS):
            out[ray, c] = 0.0
        while t < far[ray] and through > stop and cursor < end:
            cx, cy, cz, speed, r = _place(ox, oy, oz, dx, dy, dz, t)
            place = _cell(cx, cy, cz, occupancy_size)
            empty = distance[place]
            if empty > 0:
                t += _skip(empty, cell, step, speed, r)
                continue
            length = stretch * step / speed
            for c in range(CHANNELS):
                sample_feature[cursor, c] = 0.0
            for level in range(sizes.shape[0]):
                rows, weights = _corners(cx, cy, cz, sizes[level], table, starts[level])
                _gather(sample_feature, cursor, values, rows, weights)
            raw = sample_feature[cursor, 0] + shift
            density = raw if raw > np.float32(15.0) else np.log(np.float32(1.0) + np.exp(raw))
            optical = density * thickness * stretch
            kept = np.exp(-optical)
            weight = through * (np.float32(1.0) - kept)
            if through > np.float32(0.5) and through * kept <= np.float32(0.5):
                crossing = np.log(np.float32(2.0) * through) / max(optical, np.float32(1e-12))
                depth = t + (crossing - np.float32(0.5)) * length
            largest = max(largest, weight)
            sample_cell[cursor] = place
            expected += weight * t
            for c in range(1, CHANNELS):
                out[ray, c] += weight * sample_feature[cursor, c]
            sample_t[cursor] = t
            sample_alpha[cursor] = np.float32(1.0) - kept
            sample_stretch[cursor] = stretch
            stretch = np.float32(1.0) if optical > thin * stretch else np.float32(2.0)
            through *= kept
            count += 1
            cursor += keep
            t += length
        sample_count[ray] = count
        if keep > 0:
            least = visible * max(largest, through)
            left = np.float32(1.0)
            for i in range(sample_first[ray], cursor):
                if left * sample_alpha[i] > least:
                    seen[sample_cell[i]] = 1
                left *= np.float32(1.0) - sample_alpha[i]
        out[ray, 0] = expected
        out_through[ray] = through
        out_depth[ray] = depth


@njit(forceinline=True)
def _mark(touched, rows):
    """Set the bit of each voxel in its brick's 64."""
    for row in rows:
        touched[row >> 6] |= np.uint64(1) << np.uint64(row & 63)


@njit(**_FAST)
def march_back(
    first, last, thread, origins, directions, step, thickness, sizes, table, starts, shift, distortion,
    sample_first, sample_count, sample_t, sample_stretch, sample_alpha, sample_feature, out, out_through, grad_out, grad_through, gradient, touched,
):  # fmt: skip
    """Backward of `march`: adds dL/d(values) to ``gradient`` and marks the voxels it wrote to in ``touched``.

    grad_out (n, 8), grad_through (n,): dL/d(out), dL/d(out_through). With dL/dw_i = g . f_i,
        dL/dsigma_i = step (T_{i+1} dL/dw_i - sum_{j>i} w_j dL/dw_j - T_end dL/dT_end)
    ``distortion`` adds the gradient of distortion * sum_ij w_i w_j |s_i - s_j|, s = t / (1 + t) (mip-NeRF 360).
    """
    small = np.float32(1e-9)
    for ray in range(first, last):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        behind = out_through[ray] * grad_through[ray]
        for c in range(1, CHANNELS):
            behind += grad_out[ray, c] * out[ray, c]
        total = np.float32(1.0) - out_through[ray]
        weight_before = np.float32(0.0)
        place_before = np.float32(0.0)
        place_total = np.float32(0.0)
        begin = sample_first[ray]
        if distortion > 0:
            through = np.float32(1.0)
            spread = np.float32(0.0)
            for k in range(sample_count[ray]):
                weight = through * sample_alpha[begin + k]
                place = sample_t[begin + k] / (np.float32(1.0) + sample_t[begin + k])
                spread += 2 * weight * (place * weight_before - place_before)
                weight_before += weight
                place_before += weight * place
                through *= np.float32(1.0) - sample_alpha[begin + k]
            place_total = place_before
            behind += 2 * distortion * spread
            weight_before = np.float32(0.0)
            place_before = np.float32(0.0)
        through = np.float32(1.0)
        for k in range(sample_count[ray]):
            i = begin + k
            alpha = sample_alpha[i]
            weight = through * alpha
            through *= np.float32(1.0) - alpha
            slope = np.float32(0.0)
            for c in range(1, CHANNELS):
                slope += grad_out[ray, c] * sample_feature[i, c]
            if distortion > 0:
                place = sample_t[i] / (np.float32(1.0) + sample_t[i])
                after = total - weight_before - weight
                slope += 2 * distortion * (
                    place * weight_before - place_before + (place_total - place_before - weight * place) - place * after
                )
                weight_before += weight
                place_before += weight * place
            behind -= weight * slope
            grad_density = thickness * sample_stretch[i] * (through * slope - behind)
            raw = sample_feature[i, 0] + shift
            sample_feature[i, 0] = grad_density / (np.float32(1.0) + np.exp(-raw))
            largest = abs(sample_feature[i, 0])
            for c in range(1, CHANNELS):
                sample_feature[i, c] = weight * grad_out[ray, c]
                largest = max(largest, abs(sample_feature[i, c]))
            if largest < small:
                continue
            cx, cy, cz, speed, r = _place(ox, oy, oz, dx, dy, dz, sample_t[i])
            for level in range(sizes.shape[0]):
                rows, weights = _corners(cx, cy, cz, sizes[level], table, starts[level])
                _scatter(gradient, rows, weights, sample_feature, i)
                _mark(touched, rows)


@njit(forceinline=True, fastmath=_FAST["fastmath"], error_model="numpy")
def _inputs(channels, through, directions, ray, x):
    """The network's 16 inputs: the composited channels, and the direction's harmonics as far as the ray is opaque."""
    for c in range(7):
        x[c] = channels[ray, c + 1]
    dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
    x[7], x[8], x[9], x[10] = np.float32(1.0), dx, dy, dz
    x[11], x[12], x[13] = dx * dy, dy * dz, dx * dz
    x[14], x[15] = dx * dx - dy * dy, np.float32(3.0) * dz * dz - np.float32(1.0)
    for k in range(7, 16):
        x[k] *= np.float32(1.0) - through[ray]


@njit(**_FAST)
def shade(first, last, thread, channels, through, directions, background, inner, outer, colour):
    """Composited channels (n, 8) -> colour (n, 3) = diffuse + T background + outer^T relu(inner^T x).

    background (3,), inner (16, H), outer (H, 3). There is no bias: where a ray hits nothing, x = 0 and the background is
    seen as it is. It does not depend on the direction, or it would explain surfaces away before they are found.
    """
    width = inner.shape[1]
    x, hidden = np.empty(16, np.float32), np.empty(width, np.float32)
    for ray in range(first, last):
        _inputs(channels, through, directions, ray, x)
        hidden[:] = 0.0
        for k in range(16):
            for j in range(width):
                hidden[j] += x[k] * inner[k, j]
        t = through[ray]
        r, g, b = x[0] + t * background[0], x[1] + t * background[1], x[2] + t * background[2]
        for j in range(width):
            h = max(hidden[j], np.float32(0.0))
            r += h * outer[j, 0]
            g += h * outer[j, 1]
            b += h * outer[j, 2]
        colour[ray, 0], colour[ray, 1], colour[ray, 2] = r, g, b


@njit(**_FAST)
def shade_back(
    first, last, thread, channels, through, directions, background, inner, outer, grad_colour,
    grad_channels, grad_through, grad_background, grad_inner, grad_outer,
):  # fmt: skip
    """Backward of `shade`. The gradients of the parameters have one more, leading, axis: a slice for each thread."""
    width = inner.shape[1]
    x, hidden, grad_hidden = np.empty(16, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    to_background, to_inner, to_outer = grad_background[thread], grad_inner[thread], grad_outer[thread]
    for ray in range(first, last):
        _inputs(channels, through, directions, ray, x)
        r, g, b = grad_colour[ray, 0], grad_colour[ray, 1], grad_colour[ray, 2]
        hidden[:] = 0.0
        for k in range(16):
            for j in range(width):
                hidden[j] += x[k] * inner[k, j]
        for j in range(width):
            h = max(hidden[j], np.float32(0.0))
            grad = r * outer[j, 0] + g * outer[j, 1] + b * outer[j, 2]
            grad_hidden[j] = grad if hidden[j] > 0 else np.float32(0.0)
            to_outer[j, 0] += h * r
            to_outer[j, 1] += h * g
            to_outer[j, 2] += h * b
        light = r * background[0] + g * background[1] + b * background[2]
        for k in range(16):
            total = np.float32(0.0)
            for j in range(width):
                total += inner[k, j] * grad_hidden[j]
                to_inner[k, j] += x[k] * grad_hidden[j]
            if k < 7:
                grad_channels[ray, k + 1] = total + (grad_colour[ray, k] if k < 3 else np.float32(0.0))
            elif through[ray] < np.float32(1.0):
                light -= total * x[k] / (np.float32(1.0) - through[ray])
        grad_channels[ray, 0] = 0.0
        for c in range(3):
            to_background[c] += grad_colour[ray, c] * through[ray]
        grad_through[ray] = light


@njit(**_FAST)
def pass_through(origins, directions, lengths, size, camera, least, cameras_through, last):
    """Count ``camera`` once in ``cameras_through`` (size^3,) uint8 for each cell its rays pass on ``lengths`` (n,).

    On the first half of the way, where other cameras seldom look, it counts as ``least``.
    last (size^3,) uint8: the camera that was counted last in each cell.
    """
    step = np.float32(2.0) / np.float32(size)
    for ray in range(len(lengths)):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        t = np.float32(0.0)
        while t < lengths[ray]:
            cx, cy, cz, speed, r = _place(ox, oy, oz, dx, dy, dz, t)
            cell = _cell(cx, cy, cz, size)
            if t < np.float32(0.5) * lengths[ray]:
                cameras_through[cell] = max(cameras_through[cell], least)
            elif last[cell] != camera:
                last[cell] = camera
                cameras_through[cell] += np.uint8(cameras_through[cell] < 255)
            t += step / speed


@njit(**_FAST)
def look_up(first, last, thread, places, sizes, table, starts, values, out):
    """The grid's 8 channels (n, 8) at contracted places (n, 3)."""
    for i in range(first, last):
        for c in range(CHANNELS):
            out[i, c] = 0.0
        for level in range(sizes.shape[0]):
            rows, weights = _corners(places[i, 0], places[i, 1], places[i, 2], sizes[level], table, starts[level])
            _gather(out, i, values, rows, weights)


@njit(**_FAST)
def adam(first, last, thread, values, gradient, mean, square, touched, rates, beta1, beta2, correction, epsilon):
    """One Adam step on the touched voxels (a bit for each of a brick's 64); clears gradient and marks.

    rates (8,): learning rate of each channel; correction: sqrt(1 - beta2^k) / (1 - beta1^k).
    """
    for brick in range(max(first, 1), last):
        marks = touched[brick]
        touched[brick] = 0
        v = brick * 64
        while marks != 0:
            if marks & np.uint64(1):
                for c in range(CHANNELS):
                    g = gradient[v, c]
                    gradient[v, c] = 0.0
                    m = beta1 * mean[v, c] + (np.float32(1.0) - beta1) * g
                    s = beta2 * square[v, c] + (np.float32(1.0) - beta2) * g * g
                    mean[v, c] = m
                    square[v, c] = s
                    values[v, c] -= rates[c] * correction * m / (np.sqrt(s) + epsilon)
            marks >>= np.uint64(1)
            v += 1


@njit(**_FAST)
def chebyshev(occupied, limit):
    """occupied (n, n, n) uint8 -> distance [cells] of each cell to the nearest occupied one, at most ``limit``."""
    n = occupied.shape[0]
    near = np.empty((n, n, n), np.uint8)
    for x in range(n):
        for y in range(n):
            for z in range(n):
                near[x, y, z] = 0 if occupied[x, y, z] else limit
    line = np.empty(n, np.uint8)
    # The distance in the L-inf norm: one pass per axis of min_k max(|k|, d(. + k)), by two-sided sweeps to ``limit``.
    for x in range(n):
        for y in range(n):
            for z in range(1, n):
                near[x, y, z] = min(near[x, y, z], near[x, y, z - 1] + 1)
            for z in range(n - 2, -1, -1):
                near[x, y, z] = min(near[x, y, z], near[x, y, z + 1] + 1)
    for x in range(n):
        for z in range(n):
            for y in range(n):
                line[y] = near[x, y, z]
            for y in range(n):
                near[x, y, z] = _best(line, y, n)
    for y in range(n):
        for z in range(n):
            for x in range(n):
                line[x] = near[x, y, z]
            for x in range(n):
                near[x, y, z] = _best(line, x, n)
    return near


@njit(forceinline=True, fastmath=_FAST["fastmath"], error_model="numpy")
def _best(line, at, n):
    best = line[at]
    k = 1
    while k < best:
        if at >= k:
            best = min(best, max(k, line[at - k]))
        if at + k < n:
            best = min(best, max(k, line[at + k]))
        k += 1
    return best
