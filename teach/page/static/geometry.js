// The page's maths: pinhole cameras and what two views know of each other. Pure functions on arrays of numbers.
//
// As scene/camera.py: x right, y down, z forward; pixel (0, 0) is the top-left corner of the top-left pixel.
// A camera is {K: 3x3, world_from_camera: 4x4, width, height}; a line is [a, b, c] with a u + b v + c = 0, a^2 + b^2 = 1.

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
export const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
export const unit = a => a.map(x => x / Math.hypot(...a))
export const centre = camera => camera.world_from_camera.slice(0, 3).map(row => row[3])
const times = (M, x) => M.map(row => dot(row, x))
const transposed = M => M[0].map((_, j) => M.map(row => row[j]))
const rotation = camera => camera.world_from_camera.slice(0, 3).map(row => row.slice(0, 3))

/** Inverse of a 3x3 matrix. */
export function inverse(M) {
  const [a, b, c] = M, rows = [cross(b, c), cross(c, a), cross(a, b)]
  const determinant = dot(a, rows[0])
  return transposed(rows.map(row => row.map(x => x / determinant)))
}

/** World point (3) [m] -> pixel (2), null where it is not in front of the camera. */
export function project(camera, point) {
  const local = times(transposed(rotation(camera)), add(point, centre(camera), -1))
  if (!(local[2] > 1e-9)) return null
  const [u, v, w] = times(camera.K, local)
  return [u / w, v / w]
}

/** How far before the camera a world point is, along its axis. */
export function depth({world_from_camera: M}, point) { return [0, 1, 2].reduce((sum, i) => sum + M[i][2] * (point[i] - M[i][3]), 0) }

/** Derivative (2x3) [px/m] of project at a point in front of the camera. */
export function jacobian(camera, point) {
  const P = times3(camera.K, transposed(rotation(camera)))
  const [u, v, w] = times(camera.K, times(transposed(rotation(camera)), add(point, centre(camera), -1)))
  return [0, 1].map(i => [0, 1, 2].map(j => (P[i][j] - ([u, v][i] / w) * P[2][j]) / w))
}

const times3 = (A, B) => A.map(row => [0, 1, 2].map(j => row[0] * B[0][j] + row[1] * B[1][j] + row[2] * B[2][j]))

/** Pixel (2) -> unit direction (3) of its ray in the world; the ray starts at centre(camera). */
export const ray = (camera, [u, v]) => unit(times(rotation(camera), times(inverse(camera.K), [u, v, 1])))

/** Fundamental matrix (3x3) of two cameras: (b, 1)^T F (a, 1) = 0 for pixels a, b of the same point. Norm 1; null if they
 *  stand at the same place. */
export function fundamental(a, b) {
  // [e]_x M with M the homography of the plane at infinity, e the picture of a's centre in b
  const R = transposed(rotation(b))
  const e = times(b.K, times(R, add(centre(a), centre(b), -1)))
  const M = times3(b.K, times3(times3(R, rotation(a)), inverse(a.K)))
  const columns = transposed(M).map(column => cross(e, column))
  const F = transposed(columns), norm = Math.hypot(...F.flat())
  return norm > 1e-12 ? F.map(row => row.map(x => x / norm)) : null
}

/** The line in b on which the point seen at pixel p in a lies. */
export function epipolarLine(F, p) {
  const line = times(F, [p[0], p[1], 1]), norm = Math.hypot(line[0], line[1])
  return norm > 1e-300 ? line.map(x => x / norm) : null
}

/** Signed Sampson distance [px] of pixels a, b (Hartley and Zisserman 2004, eq. 11.9). */
export function sampson(F, a, b) {
  const inB = times(F, [a[0], a[1], 1]), inA = times(transposed(F), [b[0], b[1], 1])
  const gradient = Math.hypot(inB[0], inB[1], inA[0], inA[1])
  return dot(inB, [b[0], b[1], 1]) / Math.max(gradient, 1e-300)
}

/** The two ends of a line inside a picture, null where it passes by. */
export function clipped(line, width, height) {
  const [a, b, c] = line, ends = []
  if (Math.abs(b) > 1e-12) for (const u of [0, width]) ends.push([u, -(a * u + c) / b])
  if (Math.abs(a) > 1e-12) for (const v of [0, height]) ends.push([-(b * v + c) / a, v])
  const inside = ends.filter(([u, v]) => u > -1e-6 && u < width + 1e-6 && v > -1e-6 && v < height + 1e-6)
  if (inside.length < 2) return null
  let best = [inside[0], inside[1]]
  for (const p of inside) for (const q of inside) if (gap(p, q) > gap(...best)) best = [p, q]
  return best
}
const gap = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1])

/** The point nearest to the rays of pixels a and b, null where they are parallel. */
export function triangulate(cameraA, a, cameraB, b) {
  const o = centre(cameraA), p = centre(cameraB), d = ray(cameraA, a), e = ray(cameraB, b)
  const w = add(p, o, -1), c = dot(d, e), s = 1 - c * c
  if (s < 1e-12) return null
  const alongA = (dot(w, d) - c * dot(w, e)) / s, alongB = (c * dot(w, d) - dot(w, e)) / s
  return add(add(o, d, alongA), add(p, e, alongB)).map(x => x / 2)
}

/** Arc length at each point of a polyline, from 0 to 1. */
export function arcLength(points) {
  const along = [0]
  for (let i = 1; i < points.length; i++) along.push(along[i - 1] + gap(points[i], points[i - 1]))
  const whole = along[along.length - 1] || 1
  return along.map(x => x / whole)
}

/** The point at a value x of increasing xs (N), linear in between. */
export function at(points, xs, x) {
  let low = 0, high = xs.length - 1
  if (x <= xs[0]) return points[0]
  if (x >= xs[high]) return points[high]
  while (high - low > 1) { const middle = (low + high) >> 1; if (xs[middle] <= x) low = middle; else high = middle }
  const f = (x - xs[low]) / Math.max(xs[high] - xs[low], 1e-12)
  return points[low].map((value, i) => value + f * (points[high][i] - value))
}

/** A polyline at n even fractions of its arc length. */
export function evenly(points, n) {
  const along = arcLength(points)
  return Array.from({length: n}, (_, i) => at(points, along, i / (n - 1)))
}

/** Which moments of two strokes are the same one, and how far they are apart there.
 *  a, b: polylines [px] of views with fundamental matrix F. Returns rows {a, b, off}: fractions of the strokes' arc length, and
 *  the Sampson distance [px]. Dynamic programming over steps (1, 1), (1, 2), (2, 1), so that neither runs backwards. */
export function matched(a, b, F, n = 48, stiffness = 0.15) {
  const p = evenly(a, n), q = evenly(b, n)
  const cost = new Float64Array(n * n).fill(Infinity), from = new Int8Array(n * n)
  const local = (i, j) => { const e = sampson(F, p[i], q[j]); return e * e + stiffness * (i - j) ** 2 }
  const steps = [[1, 1], [1, 2], [2, 1], [0, 1], [1, 0]], price = [0, 1, 1, 4, 4]
  cost[0] = local(0, 0)
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) {
    if (!i && !j) continue
    const here = local(i, j)
    steps.forEach(([di, dj], k) => {
      if (i < di || j < dj) return
      const total = cost[(i - di) * n + j - dj] + here * (di + dj) / 2 + price[k]
      if (total < cost[i * n + j]) { cost[i * n + j] = total; from[i * n + j] = k }
    })
  }
  const rows = []
  for (let i = n - 1, j = n - 1; ;) {
    rows.push({a: i / (n - 1), b: j / (n - 1), off: Math.abs(sampson(F, p[i], q[j]))})
    if (!i && !j) break
    const [di, dj] = steps[from[i * n + j]]
    i -= di; j -= dj
  }
  return rows.reverse()
}

const SHORTEST = 0.02 // of either stroke: less of both apart is how strokes begin and end

/** The longest stretch of matched rows that are further apart than tolerance [px]: {from, to} fractions of stroke b, its
 *  length as a fraction of the stroke that has more of it, and the most [px]; null where strokes agree. */
export function disagreement(rows, tolerance) {
  let best = null, start = -1
  for (let i = 0; i <= rows.length; i++) {
    const bad = i < rows.length && rows[i].off > tolerance
    if (bad && start < 0) start = i
    if (!bad && start >= 0) {
      const part = rows.slice(start, i), last = part[part.length - 1]
      const found = {from: part[0].b, to: last.b, most: Math.max(...part.map(r => r.off)), length: Math.max(last.a - part[0].a, last.b - part[0].b)}
      if (found.length > SHORTEST && found.length > (best?.length ?? 0)) best = found
      start = -1
    }
  }
  return best
}

/** Where along stroke a (its evenly spaced points) a pen at q in the other view is, not before fraction s: the fraction whose
 *  epipolar line is nearest, near to where it was. */
export function following(even, F, q, s, reach = 0.12) {
  let best = s, least = Infinity
  for (let i = 0; i < even.length; i++) {
    const fraction = i / (even.length - 1)
    if (fraction < s || fraction > s + reach) continue
    const cost = Math.abs(sampson(F, even[i], q)) + 20 * (fraction - s)
    if (cost < least) { least = cost; best = fraction }
  }
  return best
}

/** A camera of the same kind that stands at azimuth, elevation [rad] and distance around a target and looks at it. */
export function orbiting(like, target, {azimuth, elevation, distance}) {
  const eye = add(target, [Math.cos(azimuth) * Math.cos(elevation), Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation)], distance)
  return {...like, world_from_camera: lookAt(eye, target)}
}

/** world_from_camera of a camera at eye that looks at target, up being z. */
export function lookAt(eye, target) {
  const z = unit(add(target, eye, -1))
  let x = cross(z, [0, 0, 1])
  x = Math.hypot(...x) < 1e-6 ? [1, 0, 0] : unit(x)
  const y = cross(z, x)
  return [0, 1, 2].map(i => [x[i], y[i], z[i], eye[i]]).concat([[0, 0, 0, 1]])
}

/** Azimuth, elevation [rad] and distance of a camera around a target. */
export function around(camera, target) {
  const d = add(centre(camera), target, -1), distance = Math.hypot(...d)
  return {azimuth: Math.atan2(d[1], d[0]), elevation: Math.asin(d[2] / distance), distance}
}

/** The same camera with pictures of another size. */
export function resized(camera, width, height) {
  const s = [width / camera.width, height / camera.height, 1]
  return {...camera, K: camera.K.map((row, i) => row.map(x => x * s[i])), width, height}
}

/** Ellipse of a covariance (9 numbers, row by row) [m^2] around a point as the camera sees it: {at, radii [px], turn [rad]}
 *  of one standard deviation; null behind the camera. */
export function ellipse(camera, point, C) {
  const seen = project(camera, point)
  if (!seen) return null
  const J = jacobian(camera, point), M = [C.slice(0, 3), C.slice(3, 6), C.slice(6, 9)]
  const [p, q] = J.map(row => times(M, row))
  const xx = dot(J[0], p), xy = dot(J[1], p), yy = dot(J[1], q)
  const middle = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy)
  return {at: seen, radii: [Math.sqrt(Math.max(middle + half, 0)), Math.sqrt(Math.max(middle - half, 0))], turn: Math.atan2(2 * xy, xx - yy) / 2}
}
