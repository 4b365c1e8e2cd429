// One picture to draw on: what pointers do on it becomes strokes in the picture's own pixels, whatever the zoom.
//
// Layers from the back: picture, ink (all that is finished), live (the line being drawn, painted as its samples arrive), help
// (what changes with every moment). A sample is an event of the browser: each coalesced one, with its own time.

import {arcLength, at, fundamental, matched, disagreement, project} from './geometry.js'
import {Helper, TOLERANCE} from './help.js'
import * as ink from './ink.js'

const TAP = 4 // CSS px that a stroke is longer than
const LAYERS = ['picture', 'ink', 'live', 'help']
const exact = x => Math.round(x * 1e4) / 1e4 // a ten-thousandth of a pixel: less than any screen or pen tells
const PACE = 0.3 // picture widths per second at which waypoints are followed

export class View {
  /** page: what all views share (page.js). number: its place. */
  constructor(page, number) {
    this.page = page
    this.number = number
    this.element = document.getElementById('view').content.cloneNode(true).firstElementChild
    this.frame = this.element.querySelector('.frame')
    this.layers = {}
    for (const name of LAYERS) this.frame.append(this.layers[name] = Object.assign(document.createElement('canvas'), {className: name}))
    this.zoom = {scale: 1, x: 0, y: 0}
    this.pen = 0
    this.cursor = null
    this.waypoints = []
    new ResizeObserver(() => this.resize()).observe(this.frame)
    for (const type of ['pointerdown', 'pointermove', 'pointerup', 'pointercancel', 'lostpointercapture']) this.frame.addEventListener(type, event => this[type](event))
    this.frame.addEventListener('click', () => { if (page.tool === 'mark' && this.marking) page.offerMarks(this) })
    this.frame.addEventListener('contextmenu', event => event.preventDefault())
    this.frame.addEventListener('wheel', event => this.wheel(event), {passive: false})
    this.frame.addEventListener('keydown', event => this.keydown(event))
    this.frame.addEventListener('focus', () => page.focus(this))
    this.touches = new Map()
  }

  // What is shown

  async show(view) {
    this.view = view
    this.name = view.name
    this.image = null
    this.cursor = null
    this.waypoints = []
    this.element.querySelector('.name').textContent = view.name
    this.element.querySelector('.kind').textContent = {photograph: 'photograph', rendered: 'rendered by the field', free: 'your viewpoint, rendered'}[view.kind]
    this.frame.setAttribute('aria-label', `Picture ${this.number + 1}: ${view.name}. Draw here, or press W for waypoints with the arrow keys and Enter.`)
    this.frame.style.aspectRatio = `${view.camera.width} / ${view.camera.height}`
    this.fit()
    this.frame.classList.add('waiting')
    try { this.image = await this.page.picture(view) } catch (error) { this.element.querySelector('.absent').textContent = error.message }
    this.frame.classList.toggle('waiting', false)
    this.frame.classList.toggle('without', !this.image)
    this.paint()
  }

  resize() {
    const {clientWidth: w, clientHeight: h} = this.frame, ratio = devicePixelRatio
    if (!w || !h) return
    for (const canvas of Object.values(this.layers)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio) }
    this.ratio = ratio
    this.fit()
  }

  fit() {
    if (!this.view || !this.frame.clientWidth) return
    const {width, height} = this.view.camera, scale = Math.min(this.frame.clientWidth / width, this.frame.clientHeight / height)
    this.least = scale
    this.zoom = {scale, x: (this.frame.clientWidth - scale * width) / 2, y: (this.frame.clientHeight - scale * height) / 2}
    this.paint()
  }

  zoomBy(factor, [x, y] = [this.frame.clientWidth / 2, this.frame.clientHeight / 2]) {
    const scale = Math.min(Math.max(this.zoom.scale * factor, this.least), 24 * this.least), f = scale / this.zoom.scale
    this.moveTo(scale, x - f * (x - this.zoom.x), y - f * (y - this.zoom.y))
  }

  moveTo(scale, x, y) {
    const {width, height} = this.view.camera, {clientWidth: w, clientHeight: h} = this.frame
    const within = (value, size, room) => size < room ? (room - size) / 2 : Math.min(0, Math.max(room - size, value))
    this.zoom = {scale, x: within(x, scale * width, w), y: within(y, scale * height, h)}
    this.paint()
  }

  /** Zoom in on points (N, 3) of the world, with room around them. */
  look(points) {
    const seen = points.map(p => project(this.view.camera, p)).filter(Boolean), {clientWidth: w, clientHeight: h} = this.frame
    if (!seen.length) return
    const [low, high] = [Math.min, Math.max].map(f => [0, 1].map(axis => f(...seen.map(p => p[axis]))))
    const scale = Math.min(w / (3 * (high[0] - low[0]) + 60), h / (3 * (high[1] - low[1]) + 60), 6 * this.least)
    const bounded = Math.max(scale, this.least)
    this.moveTo(bounded, w / 2 - bounded * (low[0] + high[0]) / 2, h / 2 - bounded * (low[1] + high[1]) / 2)
  }

  /** Position (CSS px of the window) -> pixel of the picture. */
  pixel(event) {
    const {left, top} = this.corner ?? this.frame.getBoundingClientRect()
    return [(event.clientX - left - this.zoom.x) / this.zoom.scale, (event.clientY - top - this.zoom.y) / this.zoom.scale]
  }

  get px() { return 1 / this.zoom.scale }

  brush(layer, clear = true) {
    const canvas = this.layers[layer], g = canvas.getContext('2d'), s = this.zoom.scale * this.ratio
    if (clear) { g.setTransform(1, 0, 0, 1, 0, 0); g.clearRect(0, 0, canvas.width, canvas.height) }
    g.setTransform(s, 0, 0, s, this.zoom.x * this.ratio, this.zoom.y * this.ratio)
    return g
  }

  /** Paint everything anew, once in the next frame. */
  paint() {
    this.asked ??= requestAnimationFrame(() => { this.asked = null; this.paintNow() })
  }

  paintNow() {
    if (!this.view || !this.ratio) return
    const {page, view: {camera}} = this, picture = this.brush('picture')
    picture.imageSmoothingEnabled = this.zoom.scale < 4
    picture.imageSmoothingQuality = 'high'
    if (this.image) picture.drawImage(this.image, 0, 0, camera.width, camera.height)
    const g = this.brush('ink'), motion = page.shows.motion && page.motion
    if (page.shows.strokes) for (const stroke of page.document.strokes(this.name)) {
      ink.paintStroke(g, stroke, this.px, {selected: stroke === page.selected?.stroke, faded: !!motion && !page.stale})
    }
    if (motion) { g.globalAlpha = page.stale ? 0.35 : 1; ink.paintMotion(g, camera, motion, this.px); g.globalAlpha = 1 }
    if (page.plan) ink.paintPlan(g, camera, page.plan, this.px)
    if (page.shows.strokes) this.paintDisagreements(g)
    this.paintLive()
    this.paintHelp()
  }

  paintDisagreements(g) {
    for (const {stroke, part} of this.disagreements()) ink.paintDisagreement(g, stroke, arcLength(stroke.points), part, this.px)
  }

  /** Where strokes of this view contradict the same demonstration in an earlier view. */
  disagreements() {
    const all = this.page.document.sketches
    const mine = all.findIndex(s => s.view === this.name), found = []
    for (const stroke of this.page.document.motions(this.name)) for (const other of all.slice(0, Math.max(mine, 0))) {
      const same = other.strokes.find(s => (s.kind ?? 'motion') === 'motion' && (s.demonstration ?? 0) === (stroke.demonstration ?? 0))
      const part = same && this.contradiction(other.camera, same, stroke)
      if (part) found.push({stroke, part, other: other.view})
    }
    return found
  }

  contradiction(camera, other, stroke) {
    const known = (this.known ??= new WeakMap()).get(stroke)
    if (known?.other === other) return known.part
    const F = fundamental(camera, this.view.camera)
    const part = F && disagreement(matched(other.points, stroke.points, F), TOLERANCE * this.view.camera.width)
    this.known.set(stroke, {other, part})
    return part
  }

  paintLive() {
    const g = this.brush('live')
    if (this.line) { this.painted = 0; this.paintSamples() }
    if (this.waypoints.length || this.cursor) this.paintWaypoints(g)
  }

  /** Add the samples that arrived to the line: nothing of what is painted already is touched. */
  paintSamples() {
    const {points} = this.line, g = this.brush('live', false)
    g.beginPath()
    g.moveTo(...points[Math.max(this.painted - 1, 0)])
    for (let i = this.painted; i < points.length; i++) g.lineTo(...points[i])
    g.lineCap = g.lineJoin = 'round'
    g.lineWidth = 3 * this.px
    g.strokeStyle = this.line.kind === 'keep_out' ? '#ff4d4d' : ink.inkOf(this.line.demonstration)
    g.stroke()
    this.painted = points.length
  }

  paintWaypoints(g) {
    g.lineWidth = 2 * this.px
    g.strokeStyle = g.fillStyle = ink.inkOf(this.page.nextDemonstration(this.name))
    g.beginPath()
    this.waypoints.forEach((p, i) => i ? g.lineTo(...p) : g.moveTo(...p))
    if (this.cursor && this.waypoints.length) g.lineTo(...this.cursor)
    g.stroke()
    for (const p of this.waypoints) { g.beginPath(); g.arc(...p, 5 * this.px, 0, 7); g.fill() }
    if (!this.cursor) return
    const [u, v] = this.cursor, r = 14 * this.px
    for (const [w, style] of [[4, 'rgb(0 0 0 / .6)'], [2, '#fff']]) {
      g.beginPath()
      g.moveTo(u - r, v); g.lineTo(u + r, v); g.moveTo(u, v - r); g.lineTo(u, v + r)
      g.lineWidth = w * this.px
      g.strokeStyle = style
      g.stroke()
    }
  }

  paintHelp() {
    const g = this.brush('help'), {page} = this
    const motion = page.shows.motion && page.motion
    if (motion && !this.line) ink.paintMoment(g, this.view.camera, motion, page.time, this.px)
    if (this.marking) ink.paintMark(g, at(this.marking.stroke.points, this.marking.stroke.times, this.marking.time), '', this.px)
    if (!page.shows.help || !(this.line?.kind === 'motion' || this.waypoints.length)) return
    const helper = this.helper ??= Helper.of(page.document, this.view, this.line?.demonstration ?? page.nextDemonstration(this.name))
    if (!helper) return
    const pen = this.line ? this.line.points.at(-1) : this.waypoints.at(-1)
    const {band, line} = helper.at(pen, this.line ? (performance.now() - this.began) / 1000 : null)
    ink.paintHelp(g, this.view.camera, band, line, this.px, ink.inkOf(helper.stroke.demonstration ?? 0))
  }

  // Pointers

  pointerdown(event) {
    this.frame.focus({preventScroll: true})
    if (event.pointerType === 'touch') this.touches.set(event.pointerId, [event.clientX, event.clientY])
    if (event.pointerType === 'pen') { this.pen = event.timeStamp; if (this.line?.pointer === 'touch') this.drop() } // it was the palm
    if (event.pointerType === 'touch' && (this.line?.pointer === 'pen' || event.timeStamp - this.pen < 1500 && this.pen)) return
    if (this.active !== undefined) return this.secondFinger()
    event.preventDefault()
    this.corner = this.frame.getBoundingClientRect()
    this.active = event.pointerId
    this.frame.setPointerCapture(event.pointerId)
    const tool = event.button === 1 || event.button === 2 || this.page.panning ? 'pan' : this.page.tool
    this.doing = tool
    if (tool === 'draw' || tool === 'keep_out') this.begin(event, tool === 'draw' ? 'motion' : 'keep_out')
    else if (tool === 'pan') this.grip = [event.clientX - this.zoom.x, event.clientY - this.zoom.y]
    else if (tool === 'waypoints') this.waypoint(this.pixel(event))
    else if (tool === 'select' || tool === 'mark') this.select(this.pixel(event), tool === 'mark')
    else if (tool === 'erase') this.erase(this.pixel(event))
  }

  pointermove(event) {
    if (event.pointerType === 'pen') this.pen = event.timeStamp
    if (this.touches.has(event.pointerId)) this.pinched(event)
    if (event.pointerId !== this.active) return
    if (this.doing === 'pan') return this.moveTo(this.zoom.scale, event.clientX - this.grip[0], event.clientY - this.grip[1])
    if (this.doing === 'erase') return this.erase(this.pixel(event))
    if (!this.line) return
    const samples = event.getCoalescedEvents?.() ?? []
    for (const sample of samples.length ? samples : [event]) this.sample(sample)
    this.paintSamples()
    this.askHelp()
  }

  pointerup(event) {
    this.touches.delete(event.pointerId)
    if (event.pointerType === 'pen') this.pen = event.timeStamp
    if (event.pointerId !== this.active) return
    if (this.line) this.finish(event)
    this.release()
  }

  pointercancel(event) {
    this.touches.delete(event.pointerId)
    if (event.pointerId !== this.active) return
    this.drop()
    this.release()
  }

  lostpointercapture(event) { if (event.pointerId === this.active) this.pointercancel(event) }

  release() { this.active = this.doing = this.corner = undefined; this.helper = undefined; this.paintHelp() }

  drop() {
    this.line = null
    this.active = undefined
    this.paintLive()
  }

  /** A second finger soon after the first means to zoom; later it is a palm, and does nothing. */
  secondFinger() {
    if (this.touches.size !== 2 || !this.line || this.line.pointer !== 'touch') return
    if (performance.now() - this.began > 250 || this.line.points.length > 12) return
    this.drop()
    this.pinch = [...this.touches.values()].map(p => [...p])
    this.pinchFrom = {...this.zoom}
    this.doing = 'pinch'
  }

  pinched(event) {
    this.touches.set(event.pointerId, [event.clientX, event.clientY])
    if (this.doing !== 'pinch' || this.touches.size !== 2) return
    const [a, b] = this.pinch, [c, d] = [...this.touches.values()], {left, top} = this.frame.getBoundingClientRect()
    const middle = (p, q) => [(p[0] + q[0]) / 2 - left, (p[1] + q[1]) / 2 - top], from = middle(a, b), to = middle(c, d)
    const spread = Math.hypot(c[0] - d[0], c[1] - d[1]) / Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1)
    const scale = Math.min(Math.max(this.pinchFrom.scale * spread, this.least), 24 * this.least), f = scale / this.pinchFrom.scale
    this.moveTo(scale, to[0] - f * (from[0] - this.pinchFrom.x), to[1] - f * (from[1] - this.pinchFrom.y))
  }

  wheel(event) {
    if (!event.ctrlKey && this.page.tool !== 'pan') return
    event.preventDefault()
    const {left, top} = this.frame.getBoundingClientRect()
    this.zoomBy(Math.exp(-event.deltaY / 300), [event.clientX - left, event.clientY - top])
  }

  // Strokes

  begin(event, kind) {
    const demonstration = kind === 'motion' ? this.page.nextDemonstration(this.name) : this.page.nextRegion(this.name)
    this.line = {points: [], times: [], demonstration, kind, events: [], pressure: [], pointer: event.pointerType || 'mouse'}
    this.start = event.timeStamp
    this.began = performance.now()
    this.painted = 0
    this.sample(event)
    this.page.startDrawing(this)
    this.askHelp()
  }

  sample(event) {
    const {points, times, pressure} = this.line, time = Math.round((event.timeStamp - this.start) * 1e3) / 1e6
    points.push(this.pixel(event).map(exact))
    times.push(Math.max(time, times.at(-1) ?? 0))
    pressure.push(exact(event.pressure ?? 0))
  }

  askHelp() { this.helping ??= requestAnimationFrame(() => { this.helping = null; this.paintHelp(); if (this.line) this.askHelp() }) }

  finish(event) {
    const last = this.line.points.at(-1), here = this.pixel(event)
    if (Math.hypot(here[0] - last[0], here[1] - last[1]) > 1e-3) { // where it is lifted is a sample too; without pressure, it has the last
      this.sample(event)
      this.line.pressure[this.line.pressure.length - 1] = this.line.pressure.at(-2)
    }
    const stroke = this.line, extent = axis => Math.max(...stroke.points.map(p => p[axis])) - Math.min(...stroke.points.map(p => p[axis]))
    this.line = null
    if (stroke.points.length < 2 || Math.max(extent(0), extent(1)) * this.zoom.scale < TAP) {
      this.page.say('That was a dot: press and draw a line.')
      return this.paintLive()
    }
    this.page.addStroke(this, stroke)
  }

  waypoint(p) {
    const last = this.waypoints.at(-1)
    if (last && Math.hypot(p[0] - last[0], p[1] - last[1]) * this.zoom.scale < 6) return this.finishWaypoints()
    this.waypoints.push(p.map(exact))
    this.cursor = p
    this.page.say(`Waypoint ${this.waypoints.length}: add more; Enter on the last one finishes.`)
    this.paintLive()
    this.paintHelp()
  }

  finishWaypoints() {
    const points = this.waypoints, along = arcLength(points)
    this.waypoints = []
    if (points.length < 2) { this.page.say('A motion needs two waypoints or more.'); return this.paint() }
    const length = points.slice(1).reduce((sum, p, i) => sum + Math.hypot(p[0] - points[i][0], p[1] - points[i][1]), 0)
    const duration = Math.max(0.5, length / this.view.camera.width / PACE)
    const stroke = {points, times: along.map(x => exact(x * duration)), demonstration: this.page.nextDemonstration(this.name), kind: 'motion', events: [], pointer: 'waypoints'}
    this.helper = undefined
    this.page.addStroke(this, stroke)
  }

  /** The stroke under a pixel: {stroke, index of its nearest point}. */
  under(p, reach = 14) {
    let best = null, least = (reach * this.px) ** 2
    for (const stroke of this.page.document.strokes(this.name)) {
      const {points} = stroke
      for (let i = 0; i < points.length; i++) {
        const a = points[i], b = points[Math.min(i + 1, points.length - 1)], dx = b[0] - a[0], dy = b[1] - a[1]
        const f = Math.min(Math.max(((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / Math.max(dx * dx + dy * dy, 1e-12), 0), 1)
        const d = (a[0] + f * dx - p[0]) ** 2 + (a[1] + f * dy - p[1]) ** 2
        if (d < least) { least = d; best = {stroke, time: stroke.times[i] + f * (stroke.times[Math.min(i + 1, points.length - 1)] - stroke.times[i])} }
      }
    }
    return best
  }

  select(p, marking) {
    const found = this.under(p, marking ? 30 : 14)
    this.page.select(found && {view: this.name, stroke: found.stroke})
    this.marking = found && found.stroke.kind !== 'keep_out' ? found : null
    this.paintHelp()
  }

  erase(p) {
    const found = this.under(p)
    if (found) this.page.document.remove(this.name, found.stroke)
  }

  // Keys on the picture itself; the others are commands.js

  keydown(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return
    const arrows = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}, step = arrows[event.key]
    const {tool} = this.page
    if (tool === 'waypoints' && (step || event.key === 'Enter')) {
      const {width, height} = this.view.camera, far = event.shiftKey ? 1 : 10
      this.cursor ??= this.waypoints.at(-1) ?? [width / 2, height / 2]
      if (step) this.cursor = [this.cursor[0] + far * step[0], this.cursor[1] + far * step[1]]
      else this.waypoint(this.cursor)
      if (step) this.page.say(`At ${Math.round(this.cursor[0])}, ${Math.round(this.cursor[1])} of the picture`)
      this.paintLive()
      event.preventDefault()
    } else if ((tool === 'select' || tool === 'mark') && step) {
      this.walk(...step, event.shiftKey ? 0.05 : 0.01)
      event.preventDefault()
    } else if (step) {
      this.moveTo(this.zoom.scale, this.zoom.x - 40 * step[0], this.zoom.y - 40 * step[1])
      event.preventDefault()
    }
  }

  /** Up and down choose a stroke, left and right a moment on it. */
  walk(along, among, step) {
    const strokes = this.page.document.strokes(this.name)
    if (!strokes.length) return this.page.say('There is no stroke on this picture yet.')
    let i = strokes.indexOf(this.page.selected?.stroke)
    i = i < 0 ? 0 : (i + among + strokes.length) % strokes.length
    const stroke = strokes[i], [first, last] = [stroke.times[0], stroke.times.at(-1)]
    const time = this.marking?.stroke === stroke ? this.marking.time : (first + last) / 2
    this.marking = {stroke, time: Math.min(Math.max(time + along * step * (last - first), first), last)}
    this.page.select({view: this.name, stroke})
    this.page.say(`Stroke ${i + 1} of ${strokes.length}, ${Math.round(100 * (this.marking.time - first) / Math.max(last - first, 1e-9))} % along`)
    this.paintHelp()
  }

  cancel() {
    if (this.line || this.waypoints.length || this.cursor || this.marking) {
      this.waypoints = []
      this.cursor = this.marking = null
      if (this.active !== undefined) { this.drop(); this.release() }
      this.paint()
      return true
    }
    return false
  }
}
