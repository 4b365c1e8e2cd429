// Surfaces drawn by hand: triangles into a picture with a depth for each pixel. Needs no graphics card, and tells which lines it hides.
//
// A solid is {positions: 3V, normals: 3V, colours: 3V bytes, faces: 3F}, of typed arrays. Pixels keep 1 / depth, which is linear on
// the screen; 0 is nothing.

const LIGHT = [0.36, -0.48, 0.8] // where light comes from, in the world
const NEAR = 1e-3

/** What teach/page/solid.py packed (its bytes after gzip), as a solid. */
export function unpack(buffer) {
  const [V, F] = new Uint32Array(buffer, 0, 2), low = new Float32Array(buffer, 8, 3), step = new Float32Array(buffer, 20, 3)
  const places = new Uint16Array(buffer, 32, 3 * V), faces = new Uint16Array(buffer, 32 + 6 * V, 3 * F), colours = new Uint8Array(buffer, 32 + 6 * V + 6 * F, 3 * V)
  const positions = Float32Array.from(places, (x, i) => low[i % 3] + step[i % 3] * x)
  return {positions, faces, colours, normals: smooth(positions, faces)}
}

/** A normal for each vertex: that of its faces together. */
function smooth(positions, faces) {
  const normals = new Float32Array(positions.length)
  for (let f = 0; f < faces.length; f += 3) {
    const n = faceNormal(positions, faces, f)
    for (let k = 0; k < 3; k++) for (let a = 0; a < 3; a++) normals[3 * faces[f + k] + a] += n[a]
  }
  return normals
}

/** Normal of a face, as long as twice its area. */
function faceNormal(p, faces, f) {
  const i = 3 * faces[f], j = 3 * faces[f + 1], k = 3 * faces[f + 2]
  const ax = p[j] - p[i], ay = p[j + 1] - p[i + 1], az = p[j + 2] - p[i + 2], bx = p[k] - p[i], by = p[k + 1] - p[i + 1], bz = p[k + 2] - p[i + 2]
  return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
}

/** A solid of vertices (V, 3) and faces (F, 3) in one colour: round where faces meet at less than 40 degrees, else with an edge. */
export function creased(vertices, faces, colour) {
  const flat = Float32Array.from(vertices.flat()), corners = Uint32Array.from(faces.flat()), count = corners.length
  const own = Array.from({length: faces.length}, (_, f) => faceNormal(flat, corners, 3 * f)), around = vertices.map(() => [])
  corners.forEach((v, i) => around[v].push(Math.floor(i / 3)))
  const solid = {positions: new Float32Array(3 * count), normals: new Float32Array(3 * count), colours: new Uint8Array(3 * count), faces: Uint32Array.from(corners, (_, i) => i)}
  corners.forEach((v, i) => {
    const n = own[Math.floor(i / 3)], length = Math.hypot(...n), sum = [0, 0, 0]
    for (const f of around[v]) {
      const m = own[f]
      if (n[0] * m[0] + n[1] * m[1] + n[2] * m[2] >= 0.766 * length * Math.hypot(...m)) for (let a = 0; a < 3; a++) sum[a] += m[a]
    }
    for (let a = 0; a < 3; a++) { solid.positions[3 * i + a] = flat[3 * v + a]; solid.normals[3 * i + a] = sum[a]; solid.colours[3 * i + a] = colour[a] }
  })
  return solid
}

/** 3x4 of a pose [x, y, z, qx, qy, qz, qw]. */
export function matrixOf([x, y, z, a, b, c, w]) {
  return [
    [1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w), x],
    [2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w), y],
    [2 * (a * c - b * w), 2 * (b * c + a * w), 1 - 2 * (a * a + b * b), z],
  ]
}

export class Raster {
  constructor(width, height) {
    this.width = width
    this.height = height
    this.pixels = new Uint32Array(width * height) // as ImageData has them
    this.near = new Float32Array(width * height)
    this.done = new Uint8Array(width * height)
  }

  get image() { return new ImageData(new Uint8ClampedArray(this.pixels.buffer), this.width, this.height) }

  clear() { this.pixels.fill(0); this.near.fill(0) }

  keep() { this.kept = [this.pixels.slice(), this.near.slice()] }
  restore() { this.pixels.set(this.kept[0]); this.near.set(this.kept[1]) }

  /** Whether a point seen at pixel (u, v), at a depth, is behind a surface. */
  hides([u, v], depth) {
    const x = Math.floor(u), y = Math.floor(v)
    return x >= 0 && y >= 0 && x < this.width && y < this.height && this.near[y * this.width + x] > 1.01 / depth
  }

  /** Draw a solid. pose: 3x4 of its frame in the world. lit: share of its colour that depends on the light. */
  solid(camera, {positions, normals, colours, faces}, {pose = null, lit = 0.7} = {}) {
    const seen = this.seen(camera, positions, pose), count = positions.length / 3, shade = new Float32Array(3 * count)
    const light = pose ? [0, 1, 2].map(a => LIGHT[0] * pose[0][a] + LIGHT[1] * pose[1][a] + LIGHT[2] * pose[2][a]) : LIGHT
    for (let i = 0; i < count; i++) {
      const j = 3 * i, n = Math.hypot(normals[j], normals[j + 1], normals[j + 2]) || 1
      const bright = 1 - lit + lit * (0.5 + 0.5 * (normals[j] * light[0] + normals[j + 1] * light[1] + normals[j + 2] * light[2]) / n)
      for (let a = 0; a < 3; a++) shade[j + a] = bright * colours[j + a]
    }
    for (let f = 0; f < faces.length; f += 3) this.triangle(seen, shade, faces[f], faces[f + 1], faces[f + 2])
  }

  /** Lay a colour [r, g, b] over what is in front of surfaces, once for each pixel however many faces are there. */
  veil(camera, solids, [r, g, b], alpha) {
    this.done.fill(0)
    for (const {positions, faces} of solids) {
      const seen = this.seen(camera, positions, null)
      for (let f = 0; f < faces.length; f += 3) this.triangle(seen, null, faces[f], faces[f + 1], faces[f + 2])
    }
    for (let i = 0; i < this.done.length; i++) {
      if (!this.done[i]) continue
      const c = this.pixels[i], had = c >>> 24 ? 1 - alpha : 0, over = had ? alpha : 1
      const mix = (shift, x) => Math.round(had * (c >>> shift & 255) + over * x) << shift
      this.pixels[i] = ((had ? 255 : Math.round(255 * alpha)) << 24 | mix(16, b) | mix(8, g) | mix(0, r)) >>> 0
    }
  }

  /** Points (3N) as squares of a size in pixels. */
  points(camera, positions, colours, size) {
    const seen = this.seen(camera, positions, null), {width, height, near, pixels} = this, half = size / 2
    for (let i = 0; i < positions.length; i += 3) {
      const w = seen[i + 2]
      if (!(w > 0)) continue
      const colour = (255 << 24 | colours[i + 2] << 16 | colours[i + 1] << 8 | colours[i]) >>> 0
      const x1 = Math.min(width, Math.round(seen[i] + half)), y1 = Math.min(height, Math.round(seen[i + 1] + half))
      for (let y = Math.max(0, Math.round(seen[i + 1] - half)); y < y1; y++) for (let x = Math.max(0, Math.round(seen[i] - half)); x < x1; x++) {
        const at = y * width + x
        if (w > near[at]) { near[at] = w; pixels[at] = colour }
      }
    }
  }

  /** Pixel u, v and 1 / depth of each position; 0 behind the camera. */
  seen({K, world_from_camera: M}, positions, pose) {
    const R = [0, 1, 2].map(i => [0, 1, 2].map(j => M[j][i])), t = R.map(row => -(row[0] * M[0][3] + row[1] * M[1][3] + row[2] * M[2][3]))
    const A = pose ? R.map((row, i) => [0, 1, 2, 3].map(j => row[0] * pose[0][j] + row[1] * pose[1][j] + row[2] * pose[2][j] + (j === 3 ? t[i] : 0))) : R.map((row, i) => [...row, t[i]])
    const [[a, b, c, d], [e, f, g, h], [i, j, k, l]] = A, seen = new Float32Array(positions.length)
    for (let n = 0; n < positions.length; n += 3) {
      const x = positions[n], y = positions[n + 1], z = positions[n + 2], depth = i * x + j * y + k * z + l
      if (depth < NEAR) continue
      const w = 1 / depth
      seen[n] = (K[0][0] * (a * x + b * y + c * z + d) + K[0][1] * (e * x + f * y + g * z + h)) * w + K[0][2]
      seen[n + 1] = K[1][1] * (e * x + f * y + g * z + h) * w + K[1][2]
      seen[n + 2] = w
    }
    return seen
  }

  /** One triangle; without shades it only marks where it is in front. A corner behind the camera leaves it out. */
  triangle(seen, shade, i, j, k) {
    i *= 3; j *= 3; k *= 3
    const wa = seen[i + 2], wb = seen[j + 2], wc = seen[k + 2]
    if (!(wa > 0 && wb > 0 && wc > 0)) return
    const ax = seen[i], ay = seen[i + 1], bx = seen[j], by = seen[j + 1], cx = seen[k], cy = seen[k + 1]
    const {width, height, near, pixels, done} = this
    const x0 = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5)), x1 = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx) - 0.5))
    const y0 = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), y1 = Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5))
    if (x0 > x1 || y0 > y1) return
    const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if (!area) return
    const pdx = (by - cy) / area, pdy = (cx - bx) / area, qdx = (cy - ay) / area, qdy = (ax - cx) / area // of the shares of a and b
    let p0 = ((bx - x0 - 0.5) * (cy - y0 - 0.5) - (by - y0 - 0.5) * (cx - x0 - 0.5)) / area
    let q0 = ((cx - x0 - 0.5) * (ay - y0 - 0.5) - (cy - y0 - 0.5) * (ax - x0 - 0.5)) / area
    for (let y = y0; y <= y1; y++, p0 += pdy, q0 += qdy) {
      let p = p0, q = q0, at = y * width + x0
      for (let x = x0; x <= x1; x++, at++, p += pdx, q += qdx) {
        const r = 1 - p - q
        if (p < -1e-6 || q < -1e-6 || r < -1e-6) continue
        const w = p * wa + q * wb + r * wc
        if (w <= near[at]) continue
        if (!shade) { done[at] = 1; continue }
        near[at] = w
        pixels[at] = (255 << 24 | (p * shade[i + 2] + q * shade[j + 2] + r * shade[k + 2]) << 16 | (p * shade[i + 1] + q * shade[j + 1] + r * shade[k + 1]) << 8 | (p * shade[i] + q * shade[j] + r * shade[k])) >>> 0
      }
    }
  }
}
