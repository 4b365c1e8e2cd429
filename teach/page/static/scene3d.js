// The motion in space: the scene's points, the cameras, what was learned, regions to keep out of, the arm's tip, the moment.

import {project, orbiting, around, at, centre, add, ray} from './geometry.js'
import {timeColour} from './ink.js'
import {ask} from './server.js'

export class Scene3D {
  constructor(page, canvas) {
    this.page = page
    this.canvas = canvas
    this.points = []
    this.target = page.scene.target
    const first = page.scene.views[0]
    this.place = first ? around(first.camera, this.target) : {azimuth: -2, elevation: 0.6, distance: 2}
    this.place = {...this.place, azimuth: this.place.azimuth + 0.5, distance: this.place.distance * 1.3}
    new ResizeObserver(() => this.resize()).observe(canvas)
    canvas.addEventListener('pointerdown', event => { canvas.setPointerCapture(event.pointerId); this.grip = [event.clientX, event.clientY] })
    canvas.addEventListener('pointermove', event => this.drag(event))
    canvas.addEventListener('pointerup', () => { this.grip = null })
    canvas.addEventListener('wheel', event => { if (event.ctrlKey || document.activeElement === canvas) { event.preventDefault(); this.move(0, 0, Math.exp(event.deltaY / 500)) } }, {passive: false})
    canvas.addEventListener('keydown', event => this.key(event))
    ask('/api/points').then(({points, colours}) => {
      this.points = points.map((p, i) => [p, `rgb(${colours[i]})`])
      this.paint()
    })
  }

  resize() {
    this.canvas.width = this.canvas.clientWidth * devicePixelRatio
    this.canvas.height = this.canvas.clientHeight * devicePixelRatio
    this.paint()
  }

  drag(event) {
    if (!this.grip) return
    this.move(-(event.clientX - this.grip[0]) / 150, (event.clientY - this.grip[1]) / 150, 1)
    this.grip = [event.clientX, event.clientY]
  }

  key(event) {
    const step = {ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, 0.08, 1], ArrowDown: [0, -0.08, 1], '+': [0, 0, 0.9], '=': [0, 0, 0.9], '-': [0, 0, 1.1]}[event.key]
    if (!step) return
    event.preventDefault()
    event.stopPropagation()
    this.move(...step)
  }

  move(azimuth, elevation, farther) {
    const p = this.place
    this.place = {azimuth: p.azimuth + azimuth, elevation: Math.min(Math.max(p.elevation + elevation, -1.4), 1.5), distance: Math.min(Math.max(p.distance * farther, 0.02), 100)}
    this.paint()
  }

  paint() { this.asked ??= requestAnimationFrame(() => { this.asked = null; this.paintNow() }) }

  paintNow() {
    const {canvas, page} = this, g = canvas.getContext('2d'), r = devicePixelRatio
    const {width, height} = canvas, f = 0.95 * Math.min(width, 1.4 * height)
    if (!width) return
    const camera = orbiting({K: [[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]], width, height}, this.target, this.place)
    g.clearRect(0, 0, width, height)
    g.globalAlpha = 0.85
    for (const [point, colour] of this.points) {
      const here = project(camera, point)
      if (here) { g.fillStyle = colour; g.fillRect(here[0], here[1], 2 * r, 2 * r) }
    }
    g.globalAlpha = 1
    for (const view of page.views) if (view.view) this.paintCamera(g, camera, view, r)
    const {motion, plan} = page
    if (motion && !page.stale) {
      for (const edge of motion.regions) this.polyline(g, camera, edge, '#ff4d4d', 1.2 * r)
      for (const way of motion.ways) {
        g.globalAlpha = 0.45
        for (const sample of way.samples) this.timed(g, camera, sample, motion.times, r)
        g.globalAlpha = 1
        this.timed(g, camera, way.mean, motion.times, 3 * r)
      }
    }
    if (plan) plan.tip.forEach((p, i) => {
      if (i) this.polyline(g, camera, [plan.tip[i - 1], p], plan.touches[i] || plan.strays[i] ? '#ff2d3d' : '#4be3a0', (plan.touches[i] || plan.strays[i] ? 4 : 1.5) * r)
    })
    if (motion && !page.stale) {
      const here = project(camera, at(motion.ways[0].mean, motion.times, page.time))
      if (here) { g.beginPath(); g.arc(...here, 5 * r, 0, 7); g.fillStyle = timeColour(page.time); g.fill(); g.lineWidth = 2 * r; g.strokeStyle = '#fff'; g.stroke() }
    }
  }

  paintCamera(g, camera, {view, number}, r) {
    const {camera: c} = view, far = 0.12 * this.place.distance
    const corners = [[0, 0], [c.width, 0], [c.width, c.height], [0, c.height]].map(p => add(centre(c), ray(c, p), far))
    const colour = getComputedStyle(this.canvas).color
    for (let i = 0; i < 4; i++) this.polyline(g, camera, [centre(c), corners[i], corners[(i + 1) % 4]], colour, r)
    const here = project(camera, centre(c))
    if (here) { g.fillStyle = colour; g.font = `600 ${12 * r}px system-ui, sans-serif`; g.fillText(number + 1, here[0] + 5 * r, here[1] - 5 * r) }
  }

  polyline(g, camera, points, colour, width) {
    const seen = points.map(p => project(camera, p))
    if (seen.some(p => !p)) return
    g.beginPath()
    seen.forEach((p, i) => i ? g.lineTo(...p) : g.moveTo(...p))
    g.lineWidth = width
    g.strokeStyle = colour
    g.stroke()
  }

  timed(g, camera, points, times, width) {
    for (let i = 1; i < points.length; i++) this.polyline(g, camera, [points[i - 1], points[i]], timeColour(times[i]), width)
  }
}
