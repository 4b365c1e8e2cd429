// The motion in space: the scene's surface or points, the arm, the cameras, what was learned, regions to keep out of, the moment.
//
// Surfaces are drawn by raster.js, into a picture that is kept while only time passes; lines above it, dim where they are hidden.

import {around, project, centre, add, ray, depth} from './geometry.js'
import {Arm, posesAt} from './arm.js'
import {Raster, unpack} from './raster.js'
import {Turntable} from './turntable.js'
import {paintEvents} from './overlay.js'
import {ARROW, paintHead, timeColour} from './ink.js'
import {ask, tab} from './server.js'

const STILL = 160 // ms without a move after which it is drawn finely
const FINEST = 1.6e6 // pixels that are drawn finely

export class Scene3D {
  constructor(page, canvas) {
    Object.assign(this, {page, canvas, fine: 1, points: null, mesh: null, arm: null, picture: document.createElement('canvas')})
    this.table = new Turntable(canvas, () => this.moved(), {wheels: event => event.ctrlKey || document.activeElement === canvas})
    this.table.begin(this.beginning())
    new ResizeObserver(() => this.resize()).observe(canvas)
    document.getElementById('space-enlarge').addEventListener('click', () => this.enlarge())
  }

  /** From the side of where the first picture was taken, the arm not in the way. */
  beginning() {
    const {views: [first], target} = this.page.scene, p = first ? around(first.camera, target) : {azimuth: -2, elevation: 0.6, distance: 2}
    return {azimuth: p.azimuth + 1.1, elevation: Math.min(p.elevation, 0.5), distance: 1.15 * p.distance, target}
  }

  /** From there, but so that the arm is seen with what is looked at; not where one has turned the scene already. */
  withArm() {
    if (this.table.place !== this.table.first) return
    const points = [this.page.scene.target, ...this.arm.home], [low, high] = [Math.min, Math.max].map(f => [0, 1, 2].map(axis => f(...points.map(p => p[axis]))))
    const begin = this.beginning(), target = low.map((x, axis) => (x + high[axis]) / 2)
    this.table.begin({...begin, target, distance: Math.max(begin.distance, 1.5 * Math.hypot(...low.map((x, axis) => high[axis] - x)))})
  }

  /** The surface or the points, then the arm: after the pictures, which one draws on first. */
  async load() {
    const {can} = this.page.scene
    if (can.mesh) this.mesh = unpack(await (await ask('/api/mesh')).arrayBuffer())
    else {
      const {points, colours} = await ask('/api/points')
      this.points = {positions: Float32Array.from(points.flat()), colours: Uint8Array.from(colours.flat())}
    }
    this.changed()
    if (!can.body) return
    this.arm = new Arm(await ask('/api/body', {method: 'POST', body: {tab}}))
    this.withArm()
    this.changed()
  }

  /** As large as the pictures, in their place, or small again. */
  enlarge() {
    const large = document.getElementById('work').classList.toggle('in-space')
    document.getElementById('space-enlarge').setAttribute('aria-pressed', large)
  }

  resize() {
    this.canvas.width = this.canvas.clientWidth * devicePixelRatio
    this.canvas.height = this.canvas.clientHeight * devicePixelRatio
    this.changed()
  }

  moved() {
    this.fine = 0
    this.changed()
    clearTimeout(this.timer)
    this.timer = setTimeout(() => { this.fine = 1; this.changed() }, STILL)
  }

  /** What stands still looks different now. */
  changed() { this.kept = false; this.paint() }

  paint() { this.asked ??= requestAnimationFrame(() => { this.asked = null; this.paintNow() }) }

  /** The camera for a picture of some size. */
  camera(width, height) {
    const f = 0.95 * Math.min(width, 1.4 * height)
    return this.table.camera({K: [[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]], width, height})
  }

  paintNow() {
    const {canvas, page} = this, {width, height} = canvas
    if (!width || !height) return
    this.paintSurfaces()
    const g = canvas.getContext('2d'), r = devicePixelRatio, camera = this.camera(width, height)
    g.clearRect(0, 0, width, height)
    g.imageSmoothingQuality = 'high'
    g.drawImage(this.picture, 0, 0, width, height)
    this.share = this.raster.width / width
    const {motion, plan} = page, learned = motion && !page.stale
    for (const view of page.views) if (view.view) this.paintCamera(g, camera, view, r)
    if (learned) {
      for (const region of motion.regions) for (const edge of region.edges) this.line(g, camera, edge, '#e0283a', r, 0.35)
      for (const way of motion.ways) {
        for (const sample of way.samples) this.timed(g, camera, sample, motion.times, r, 0.4)
        this.timed(g, camera, way.mean, motion.times, 3.5 * r, 1)
      }
    }
    if (plan) plan.tip.forEach((p, i) => {
      const bad = plan.touches[i] || plan.strays[i]
      if (i) this.line(g, camera, [plan.tip[i - 1], p], bad ? '#ff2d3d' : '#12b878', (bad ? 4.5 : 2) * r)
    })
    if (learned || plan) { paintEvents(g, camera, page.happenings(), r); this.paintMoment(g, camera, r) }
  }

  paintSurfaces() {
    const {canvas, page} = this, most = Math.sqrt(FINEST / (canvas.width * canvas.height)), share = this.fine ? Math.min(2, most, 3 / devicePixelRatio) : Math.min(1, 1 / devicePixelRatio)
    const width = Math.max(2, Math.round(canvas.width * share)), height = Math.max(2, Math.round(canvas.height * share)), camera = this.camera(width, height)
    if (this.raster?.width !== width || this.raster.height !== height) {
      this.raster = new Raster(width, height)
      Object.assign(this.picture, {width, height})
      this.kept = false
    }
    const {raster} = this
    if (!this.kept) {
      raster.clear()
      if (this.mesh) raster.solid(camera, this.mesh, {lit: 0.35})
      if (this.points) raster.points(camera, this.points.positions, this.points.colours, 2 * devicePixelRatio * share)
      raster.keep()
      this.kept = true
    } else raster.restore()
    this.arm?.draw(raster, camera, page.plan ? posesAt(page.plan, page.clock.time) : this.arm.home)
    const regions = page.motion && !page.stale ? page.motion.regions : []
    for (const region of regions) raster.veil(camera, region.solids ??= region.pieces.map(solidOf), [255, 59, 72], 0.3)
    this.picture.getContext('2d').putImageData(raster.image, 0, 0)
  }

  /** Where the tip is now, and how the hand is held. */
  paintMoment(g, camera, r) {
    const {page} = this, point = page.moment(), here = project(camera, point)
    if (!here) return
    if (page.motion?.axis) {
      const from = add(point, page.motion.axis, -0.07 * this.table.place.distance), back = project(camera, from)
      this.line(g, camera, [from, point], ARROW, 3.5 * r)
      if (back) paintHead(g, back, here, 12 * r, ARROW)
    }
    g.beginPath()
    g.arc(...here, 5 * r, 0, 7)
    g.fillStyle = timeColour(page.clock.time)
    g.fill()
    g.lineWidth = 2 * r
    g.strokeStyle = '#fff'
    g.stroke()
  }

  paintCamera(g, camera, {view, number}, r) {
    const {camera: c} = view, far = 0.1 * this.table.place.distance, colour = getComputedStyle(this.canvas).color
    const corners = [[0, 0], [c.width, 0], [c.width, c.height], [0, c.height]].map(p => add(centre(c), ray(c, p), far))
    for (let i = 0; i < 4; i++) {
      this.line(g, camera, [centre(c), corners[i]], colour, r)
      this.line(g, camera, [corners[i], corners[(i + 1) % 4]], colour, r)
    }
    const here = project(camera, centre(c))
    if (here) { g.fillStyle = colour; g.font = `600 ${12 * r}px system-ui, sans-serif`; g.fillText(number + 1, here[0] + 6 * r, here[1] - 6 * r) }
  }

  /** A line between two points of the world, dim where a surface hides it. */
  line(g, camera, [a, b], colour, width, alpha = 1) {
    const p = project(camera, a), q = project(camera, b)
    if (!p || !q) return
    const parts = Math.min(24, Math.ceil(Math.hypot(q[0] - p[0], q[1] - p[1]) / (12 * devicePixelRatio)))
    g.lineWidth = width
    g.lineCap = 'round'
    g.strokeStyle = colour
    const point = s => add(a, add(b, a, -1), s), place = s => project(camera, point(s))
    for (let i = 0; i < parts; i++) {
      const middle = place((i + 0.5) / parts), hidden = this.raster.hides([middle[0] * this.share, middle[1] * this.share], depth(camera, point((i + 0.5) / parts)))
      g.globalAlpha = alpha * (hidden ? 0.25 : 1)
      g.beginPath()
      g.moveTo(...place(i / parts))
      g.lineTo(...place((i + 1) / parts))
      g.stroke()
    }
    g.globalAlpha = 1
  }

  timed(g, camera, points, times, width, alpha) {
    for (let i = 1; i < points.length; i++) this.line(g, camera, [points[i - 1], points[i]], timeColour(times[i]), width, alpha)
  }
}

const solidOf = ({vertices, faces}) => ({positions: Float32Array.from(vertices.flat()), faces: Uint32Array.from(faces.flat())})
