// Holds the page's surfaces to numbers of scene/camera.py and teach/page/solid.py, which arrive as JSON.
import {test} from 'node:test'
import assert from 'node:assert/strict'
import {readFileSync} from 'node:fs'
import {gunzipSync} from 'node:zlib'

const {Raster, unpack, creased, matrixOf} = await import(process.env.RASTER)
const c = JSON.parse(readFileSync(process.env.CASES))
const WHITE = [255, 255, 255]
const drawn = (solid, settings) => { const r = new Raster(c.camera.width, c.camera.height); r.solid(c.camera, solid, settings); return r }

test('what is packed is unpacked to within a step', () => {
  const bytes = gunzipSync(Buffer.from(c.packed, 'base64')), solid = unpack(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length))
  solid.positions.forEach((x, i) => assert.ok(Math.abs(x - c.vertices.flat()[i]) <= c.step))
  assert.deepEqual([...solid.faces], c.faces.flat())
  assert.deepEqual([...solid.colours], c.colours.flat())
})

test('a pixel is painted where the ray through it meets a face, with its depth', () => {
  const r = drawn(creased(c.triangle, [[0, 1, 2]], WHITE))
  c.hits.forEach(([x, y, depth]) => {
    const near = r.near[y * r.width + x]
    assert.equal(near > 0, depth > 0, `pixel ${x}, ${y}`)
    if (depth) assert.ok(Math.abs(near * depth - 1) < 1e-4, `depth at ${x}, ${y}`)
  })
})

test('what is nearer hides what is behind it, in whatever order', () => {
  const far = creased(c.triangle, [[0, 1, 2]], [255, 0, 0]), near = creased(c.nearer, [[0, 1, 2]], [0, 0, 255]), r = new Raster(c.camera.width, c.camera.height)
  for (const solid of [near, far]) r.solid(c.camera, solid, {lit: 0})
  const [x, y, depth] = c.hits.find(hit => hit[2] > 0), colour = r.pixels[y * r.width + x]
  assert.deepEqual([colour & 255, colour >>> 16 & 255], [0, 255])
  assert.ok(r.hides([x + 0.5, y + 0.5], depth))
  assert.ok(!r.hides([x + 0.5, y + 0.5], 0.5 * depth))
})

test('a solid with a pose is drawn where its moved vertices are', () => {
  const direct = drawn(creased(c.moved, [[0, 1, 2]], WHITE)), posed = drawn(creased(c.triangle, [[0, 1, 2]], WHITE), {pose: matrixOf(c.pose)})
  let apart = 0
  direct.near.forEach((w, i) => { if (w > 0 !== posed.near[i] > 0) apart++ })
  assert.ok(apart <= 3, `${apart} pixels`) // edges, by rounding
})

test('a veil lies over each pixel once, and not over what is in front of it', () => {
  const faces = {positions: Float32Array.from(c.triangle.flat()), faces: Uint32Array.from([0, 1, 2, 0, 2, 1])}, r = new Raster(c.camera.width, c.camera.height)
  r.solid(c.camera, creased(c.farther, [[0, 1, 2]], WHITE), {lit: 0})
  r.veil(c.camera, [faces], [0, 0, 0], 0.5)
  const [x, y] = c.hits.find(hit => hit[2] > 0)
  assert.ok(Math.abs((r.pixels[y * r.width + x] & 255) - 128) <= 1)
  r.clear()
  r.solid(c.camera, creased(c.nearer, [[0, 1, 2]], WHITE), {lit: 0})
  r.veil(c.camera, [faces], [0, 0, 0], 0.5)
  assert.equal(r.pixels[y * r.width + x] & 255, 255)
})

test('edges stay sharp and what is round is smooth', () => {
  const normal = (solid, i) => { const n = solid.normals.slice(3 * i, 3 * i + 3), l = Math.hypot(...n); return [...n].map(x => x / l) }
  const roof = angle => creased([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-Math.cos(angle), 0, -Math.sin(angle)]], [[0, 2, 1], [0, 1, 3]], WHITE)
  assert.notDeepEqual(normal(roof(1.2), 0), normal(roof(1.2), 3))
  normal(roof(0.3), 0).forEach((x, i) => assert.ok(Math.abs(x - normal(roof(0.3), 3)[i]) < 1e-6))
})
