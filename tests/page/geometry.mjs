// Holds the page's maths to numbers of scene/camera.py and teach/epipolar.py, which arrive as JSON: node geometry.mjs cases.json
import {test} from 'node:test'
import assert from 'node:assert/strict'
import {readFileSync} from 'node:fs'

const g = await import(process.env.GEOMETRY)
const cases = JSON.parse(readFileSync(process.env.CASES))

const near = (a, b, tolerance, what) => {
  const [x, y] = [[a].flat(9), [b].flat(9)]
  assert.equal(x.length, y.length, what)
  x.forEach((value, i) => assert.ok(Math.abs(value - y[i]) <= tolerance * Math.max(1, Math.abs(y[i])), `${what}: ${value} is not ${y[i]}`))
}

test('points project, and rays point, as scene/camera.py has it', () => {
  for (const c of cases) {
    c.points.forEach((p, i) => near(g.project(c.a, p), c.pixels[i], 1e-9, 'pixel'))
    c.points.forEach((p, i) => near(g.jacobian(c.a, p), c.jacobians[i], 1e-9, 'jacobian'))
    c.pixels.forEach((p, i) => near(g.ray(c.a, p), c.directions[i], 1e-9, 'ray'))
    assert.equal(g.project(c.a, c.behind), null)
  }
})

test('the fundamental matrix and the Sampson distance are those of teach/epipolar.py', () => {
  for (const c of cases) {
    const F = g.fundamental(c.a, c.b), sign = Math.sign(F.flat().reduce((s, x, i) => s + x * c.F.flat()[i], 0))
    near(F.map(row => row.map(x => sign * x)), c.F, 1e-7, 'F')
    c.pixels.forEach((p, i) => near(Math.abs(g.sampson(F, p, c.others[i])), Math.abs(c.sampson[i]), 1e-6, 'sampson'))
  }
})

test('the epipolar line of a point passes through where the other camera sees it', () => {
  for (const c of cases) {
    const F = g.fundamental(c.a, c.b)
    c.points.forEach((p, i) => {
      const [u, v] = g.project(c.b, p), [a, b, d] = g.epipolarLine(F, c.pixels[i])
      near(a * u + b * v + d, 0, 1e-6, 'distance')
    })
    assert.equal(g.fundamental(c.a, c.a), null)
  }
})

test('two pixels of a point triangulate to it', () => {
  for (const c of cases) c.points.forEach(p => near(g.triangulate(c.a, g.project(c.a, p), c.b, g.project(c.b, p)), p, 1e-8, 'point'))
})

test('a clipped line ends on the border, on the line', () => {
  const ends = g.clipped([0.6, 0.8, -300], 640, 480)
  for (const [u, v] of ends) {
    near(0.6 * u + 0.8 * v, 300, 1e-9, 'on the line')
    assert.ok([0, 640].includes(u) || [0, 480].includes(v))
  }
  assert.equal(g.clipped([1, 0, 50], 640, 480), null)
})

test('an ellipse is the covariance as the camera sees it', () => {
  for (const c of cases) {
    const {radii, turn} = g.ellipse(c.a, c.points[0], c.covariance.flat()), [x, y] = [Math.cos(turn), Math.sin(turn)]
    near([radii[0] ** 2 * x * x + radii[1] ** 2 * y * y, (radii[0] ** 2 - radii[1] ** 2) * x * y, radii[0] ** 2 * y * y + radii[1] ** 2 * x * x],
      [c.seen[0][0], c.seen[0][1], c.seen[1][1]], 1e-7, 'ellipse')
  }
})

test('orbiting is looking at the target from where one says', () => {
  for (const c of cases) {
    near(g.orbiting(c.a, c.target, c.place).world_from_camera, c.orbit, 1e-9, 'pose')
    const place = g.around(g.orbiting(c.a, c.target, c.place), c.target)
    near([place.azimuth, place.elevation, place.distance], [c.place.azimuth, c.place.elevation, c.place.distance], 1e-9, 'place')
  }
})

test('strokes of one motion agree, whatever their pace, and a part drawn elsewhere is found with how far off it is', () => {
  const {a, b, curve} = cases[0], F = g.fundamental(a, b)
  const p = curve.map(x => g.project(a, x)), q = curve.map(x => g.project(b, x)).filter((_, i) => i < 40 || i % 3 === 2)
  assert.equal(g.disagreement(g.matched(p, q, F), 4), null)
  const line = g.epipolarLine(F, p[75]), bent = curve.map(x => g.project(b, x)).map((r, i) => i >= 65 && i <= 85 ? [r[0] + 40 * line[0], r[1] + 40 * line[1]] : r)
  const part = g.disagreement(g.matched(p, bent, F), 8), along = g.arcLength(bent)
  assert.ok(part && part.from > along[65] - 0.12 && part.to < along[85] + 0.12, `${JSON.stringify(part)} lies within ${along[65]} to ${along[85]}`)
  assert.ok(part.most > 12 && part.most < 45)
})

test('the pen is followed along the other stroke, never backwards', () => {
  const {a, b, curve} = cases[0], F = g.fundamental(a, b)
  const even = g.evenly(curve.map(x => g.project(a, x)), 60)
  let s = 0, before = 0
  const q = g.evenly(curve.map(x => g.project(b, x)), 200)
  for (const pen of q) { s = g.following(even, F, pen, s); assert.ok(s >= before); before = s }
  assert.ok(s > 0.85, `the end of the stroke is at ${s}`)
})
