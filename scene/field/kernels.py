"""The field's inner loops for a CPU: marching rays through the grid, forward and backward.

`scene.field.network` shades what they find, `scene.field.cells` knows the cells they pass. What is inlined into a kernel stands in its
file: numba's cache asks only whether that file has changed.

Notation as in `scene.field.volume` and `scene.field.grid`. Every kernel works on a range [first, last) of rays or
voxels without the interpreter's lock, so `in_parallel` spreads it over threads; two threads add their
gradients to the same voxels without locks, which loses a few additions and is not bit-reproducible:
one thread is. `scene.field.twin` does the same in torch, with the maths of `scene.field.volume`, and the tests compare them.

A voxel's 8 floats are read and written as one SIMD vector, which numba's own vectoriser does not find;
the two intrinsics at the top say it in LLVM's words and work on every processor.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.extending import intrinsic

CHANNELS = 8
WEIGHT = 7  # in a voxel's gradient, the place of the weight it had; the voxel itself has 0 there
THREADS = min(2, os.cpu_count() or 1)
_POOL = ThreadPoolExecutor(THREADS)
FAST = {"nogil": True, "cache": True, "fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}, "error_model": "numpy"}


def in_parallel(kernel, count: int, threads: int, *arguments) -> None:
    """Run ``kernel(first, last, piece, *arguments)`` over [0, count) in `pieces` pieces of like size."""
    if threads == 1:
        return kernel(0, count, 0, *arguments)
    bounds = [count * k // pieces(threads) for k in range(pieces(threads) + 1)]
    jobs = [_POOL.submit(kernel, bounds[k], bounds[k + 1], k, *arguments) for k in range(pieces(threads))]
    for job in jobs:
        job.result()


def pieces(threads: int) -> int:
    """How many pieces threads share: several each, as one ray is more work than another."""
    return 1 if threads == 1 else 6 * threads


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


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
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


@njit(forceinline=True)
def _row(x, y, z, roots, root, count, table):
    """Row of ``values`` of a voxel: its level's root leads to 4^3 entries of ``table``, and these to bricks."""
    block = np.int64(roots[root + ((x >> 4) * count + (y >> 4)) * count + (z >> 4)])
    entry = (block << 6) + (((x >> 2) & 3) << 4) + (((y >> 2) & 3) << 2) + ((z >> 2) & 3)
    return (np.int64(table[entry]) << 6) + ((x & 3) << 4) + ((y & 3) << 2) + (z & 3)


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
def _corners(cx, cy, cz, size, roots, root, table):
    """The eight voxels around a contracted place on a level of ``size`` cells, and their trilinear weights.

    ``root`` is where the level begins in ``roots``.
    """
    scale = np.float32(0.25) * np.float32(size)
    px, py, pz = (cx + np.float32(2.0)) * scale, (cy + np.float32(2.0)) * scale, (cz + np.float32(2.0)) * scale
    x0 = min(max(np.int64(px), 0), size - 1)
    y0 = min(max(np.int64(py), 0), size - 1)
    z0 = min(max(np.int64(pz), 0), size - 1)
    fx, fy, fz = px - np.float32(x0), py - np.float32(y0), pz - np.float32(z0)
    gx, gy, gz = np.float32(1.0) - fx, np.float32(1.0) - fy, np.float32(1.0) - fz
    count = (size >> 4) + 1
    x1, y1, z1 = x0 + 1, y0 + 1, z0 + 1
    a, b, c, d = gx * gy, gx * fy, fx * gy, fx * fy
    weights = (a * gz, a * fz, b * gz, b * fz, c * gz, c * fz, d * gz, d * fz)
    base = _row(x0, y0, z0, roots, root, count, table)
    if (x0 & 3) < 3 and (y0 & 3) < 3 and (z0 & 3) < 3:
        rows = (base, base + 1, base + 4, base + 5, base + 16, base + 17, base + 20, base + 21)
        return rows, weights
    rows = (
        base,
        _row(x0, y0, z1, roots, root, count, table),
        _row(x0, y1, z0, roots, root, count, table),
        _row(x0, y1, z1, roots, root, count, table),
        _row(x1, y0, z0, roots, root, count, table),
        _row(x1, y0, z1, roots, root, count, table),
        _row(x1, y1, z0, roots, root, count, table),
        _row(x1, y1, z1, roots, root, count, table),
    )
    return rows, weights


@njit(forceinline=True)
def _kept(rows):
    """Whether any of eight rows lies in a brick that is kept; brick 0 stands for all that are not."""
    return (rows[0] | rows[1] | rows[2] | rows[3] | rows[4] | rows[5] | rows[6] | rows[7]) >= 64


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
def _cell(cx, cy, cz, size):
    """Number of a contracted place's cell in an occupancy grid of ``size`` cells an axis: 64 * block + place in the block."""
    scale = np.float32(0.25) * np.float32(size)
    x = min(max(np.int64((cx + np.float32(2.0)) * scale), 0), size - 1)
    y = min(max(np.int64((cy + np.float32(2.0)) * scale), 0), size - 1)
    z = min(max(np.int64((cz + np.float32(2.0)) * scale), 0), size - 1)
    blocks = size >> 2
    block = ((x >> 2) * blocks + (y >> 2)) * blocks + (z >> 2)
    return (block << 6) + ((x & 3) << 4) + ((y & 3) << 2) + (z & 3)


@njit(forceinline=True)
def _bit(index):
    """The bit of a cell in its block's 64, or of a voxel in its brick's."""
    return np.uint64(1) << np.uint64(index & 63)


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
def _exit(c, v, size, empty):
    """How far [t] along one axis a ray at c with velocity v stays in the cells nearer than ``empty`` to its own."""
    scale = np.float32(0.25) * np.float32(size)
    p = (c + np.float32(2.0)) * scale
    index = np.float32(min(max(np.int64(p), 0), size - 1))
    room = index + np.float32(empty) - p if v > np.float32(0.0) else p - index + np.float32(empty - 1)
    return (room + np.float32(1e-3)) / max(abs(v) * scale, np.float32(1e-9))


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
def _leaves(c, v):
    """How far [t] along one axis a ray at c in [-1, 1] with velocity v stays there."""
    return (np.float32(1.0) - (c if v > np.float32(0.0) else -c)) / max(abs(v), np.float32(1e-9))


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
def _skip(cx, cy, cz, dx, dy, dz, size, empty, step, speed, r):
    """How far a ray may go [t] when the nearest occupied cell is ``empty`` cells away.

    Outside the box rays are bent; no axis moves faster than ``speed``, which changes at most twofold over a quarter of r.
    """
    if r <= np.float32(1.0):
        leaves = min(_leaves(cx, dx), min(_leaves(cy, dy), _leaves(cz, dz)))
        t = min(_exit(cx, dx, size, empty), min(_exit(cy, dy, size, empty), _exit(cz, dz, size, empty)))
        return min(t, max(leaves, step))
    length = np.float32(4.0) / np.float32(size) * np.float32(empty - 1) / speed
    return max(min(np.float32(0.5) * length, np.float32(0.25) * r), step / speed)


@njit(**FAST)
def march(
    first, last, piece, origins, directions, near, far, jitter, step, thickness, occupancy_size, distance, mask, visible, seen, surface,
    sizes, roots, starts, table, values, shift, stop, keep, capacity, sample_first, sample_count,
    sample_cell, sample_t, sample_alpha, sample_feature, out, out_through, out_depth,
):  # fmt: skip
    """Forward: composite the grid's channels 1..6 along each ray, and keep the samples for `march_back`.

    origins, directions (n, 3); near, far, jitter (n,), jitter in [0, 1) of a step. The samples of a ray lie at
    sample_first[ray] + [0, sample_count[ray]). out (n, 8): 0, in 1..6 the
    composited features; out_through (n,): transmittance left; out_depth (n,): distance where it crosses 1/2, or nan
    (a sample stands for half a step on either side, of which what lies before near or beyond far is not seen).
    If samples are kept, ``surface`` gets a bit for each cell where that is, and ``seen`` for each with a sample
    whose weight is at least ``visible`` of the ray's largest.
    """
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
        largest = np.float32(0.0)
        sample_first[ray] = cursor
        count = 0
        for c in range(CHANNELS):
            out[ray, c] = 0.0
        while t < far[ray] and through > stop and cursor < end:
            cx, cy, cz, speed, r = _place(ox, oy, oz, dx, dy, dz, t)
            cell = _cell(cx, cy, cz, occupancy_size)
            empty = distance[cell >> 6]
            if empty > 0:
                t += _skip(cx, cy, cz, dx, dy, dz, occupancy_size >> 2, empty, step, speed, r)
                continue
            if mask[cell >> 6] & _bit(cell) == 0:
                t += _skip(cx, cy, cz, dx, dy, dz, occupancy_size, 1, step, speed, r)
                continue
            length = step / speed
            for c in range(CHANNELS):
                sample_feature[cursor, c] = 0.0
            for level in range(sizes.shape[0]):
                rows, weights = _corners(cx, cy, cz, sizes[level], roots, starts[level], table)
                if _kept(rows):
                    _gather(sample_feature, cursor, values, rows, weights)
            raw = sample_feature[cursor, 0] + shift
            density = raw if raw > np.float32(15.0) else np.log(np.float32(1.0) + np.exp(raw))
            optical = density * thickness
            kept = np.exp(-optical)
            weight = through * (np.float32(1.0) - kept)
            if through > np.float32(0.5) and through * kept <= np.float32(0.5):
                if keep > 0:
                    surface[cell >> 6] |= _bit(cell)
                crossing = np.log(np.float32(2.0) * through) / max(optical, np.float32(1e-12))
                depth = min(max(t + (crossing - np.float32(0.5)) * length, near[ray]), far[ray])
            largest = max(largest, weight)
            sample_cell[cursor] = cell
            for c in range(1, WEIGHT):
                out[ray, c] += weight * sample_feature[cursor, c]
            sample_t[cursor] = t
            sample_alpha[cursor] = np.float32(1.0) - kept
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
                    seen[sample_cell[i] >> 6] |= _bit(sample_cell[i])
                left *= np.float32(1.0) - sample_alpha[i]
        out_through[ray] = through
        out_depth[ray] = depth


@njit(forceinline=True)
def _mark(touched, rows):
    """Set the bit of each voxel in its brick's 64."""
    for row in rows:
        touched[row >> 6] |= _bit(row)


@njit(**FAST)
def march_back(
    first, last, piece, origins, directions, step, thickness, sizes, roots, starts, table, shift,
    sample_first, sample_count, sample_t, sample_alpha, sample_feature, out, out_through, grad_out, grad_through, least, lightest, gradient, touched,
):  # fmt: skip
    """Backward of `march`: adds dL/d(values) to ``gradient`` and marks the voxels it wrote to in ``touched``.

    grad_out (n, 8), grad_through (n,): dL/d(out), dL/d(out_through). With dL/dw_i = g . f_i,
        dL/dsigma_i = step (T_{i+1} dL/dw_i - sum_{j>i} w_j dL/dw_j - T_end dL/dT_end)
    In the channel WEIGHT the gradient is the sum of the weights w_i by which samples were seen. Samples with no gradient above
    ``least`` in any channel and a weight below ``lightest`` teach nothing.
    """
    for ray in range(first, last):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        behind = out_through[ray] * grad_through[ray]
        for c in range(1, WEIGHT):
            behind += grad_out[ray, c] * out[ray, c]
        begin = sample_first[ray]
        through = np.float32(1.0)
        for k in range(sample_count[ray]):
            i = begin + k
            alpha = sample_alpha[i]
            weight = through * alpha
            through *= np.float32(1.0) - alpha
            slope = np.float32(0.0)
            for c in range(1, WEIGHT):
                slope += grad_out[ray, c] * sample_feature[i, c]
            behind -= weight * slope
            grad_density = thickness * (through * slope - behind)
            raw = sample_feature[i, 0] + shift
            sample_feature[i, 0] = grad_density / (np.float32(1.0) + np.exp(-raw))
            largest = abs(sample_feature[i, 0])
            for c in range(1, WEIGHT):
                sample_feature[i, c] = weight * grad_out[ray, c]
                largest = max(largest, abs(sample_feature[i, c]))
            if largest < least and weight < lightest:
                continue
            sample_feature[i, WEIGHT] = weight
            cx, cy, cz, speed, r = _place(ox, oy, oz, dx, dy, dz, sample_t[i])
            for level in range(sizes.shape[0]):
                rows, weights = _corners(cx, cy, cz, sizes[level], roots, starts[level], table)
                if _kept(rows):
                    _scatter(gradient, rows, weights, sample_feature, i)
                    _mark(touched, rows)


@njit(**FAST)
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


@njit(**FAST)
def look_up(first, last, piece, places, sizes, roots, starts, table, values, out):
    """The grid's 8 channels (n, 8) at contracted places (n, 3)."""
    for i in range(first, last):
        for c in range(CHANNELS):
            out[i, c] = 0.0
        for level in range(sizes.shape[0]):
            rows, weights = _corners(places[i, 0], places[i, 1], places[i, 2], sizes[level], roots, starts[level], table)
            _gather(out, i, values, rows, weights)


@njit(**FAST)
def move(first, last, piece, values, gradient, past, touched, rates, beta, unbiased, epsilon, kept, slight, most):
    """One step on the touched voxels (a bit for each of a brick's 64); clears gradient and marks.

    Diffuse colours (1..3) go by the mean residual of the rays that saw the voxel, each weighted by how much: past[:, WEIGHT] is
    the sum of the weights so far, of which ``kept`` stays at each step, and ``slight`` is added to it; they move by ``most`` at most. The others follow
    RMSProp: past is the mean of their squared gradients, 1 - beta the weight of the newest one; unbiased: sqrt(1 - beta^k) at step k.
    rates (8,): of each channel.
    """
    for brick in range(max(first, 1), last):
        marks = touched[brick]
        touched[brick] = 0
        v = brick * 64
        while marks != 0:
            if marks & np.uint64(1):
                seen = kept * past[v, WEIGHT] + gradient[v, WEIGHT]
                past[v, WEIGHT] = seen
                for c in range(WEIGHT):
                    g = gradient[v, c]
                    if 1 <= c <= 3:
                        values[v, c] -= min(max(rates[c] * g / (seen + slight), -most), most)
                    else:
                        s = beta * past[v, c] + (np.float32(1.0) - beta) * g * g
                        past[v, c] = s
                        values[v, c] -= rates[c] * unbiased * g / (np.sqrt(s) + epsilon)
                for c in range(CHANNELS):
                    gradient[v, c] = 0.0
            marks >>= np.uint64(1)
            v += 1
