// One picture to draw on, at any zoom: pointers.js says what is done on it, pen.js makes strokes of that, choice.js chooses among them.
//
// Layers from the back: picture, arm (as it performs a checked plan), ink (all that is finished), live (the line being drawn,
// painted as its samples arrive), help (what changes with every moment). All are painted in the picture's own pixels.

import {arcLength, at, fundamental, matched, disagreement, project} from './geometry.js'
import {TOLERANCE} from './help.js'
import {Ghost, posesAt} from './arm.js'
import {Pointers} from './pointers.js'
import {Pen} from './pen.js'
import {Choice} from './choice.js'
import * as ink from './ink.js'
import * as overlay from './overlay.js'

const LAYERS = ['picture', 'arm', 'ink', 'live', 'help']
const CLOSEST = 24 // times as large as the whole picture is shown

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
    this.pen = new Pen(this)
    this.choice = new Choice(this)
    this.pointers = new Pointers(this)
    new ResizeObserver(() => this.resize()).observe(this.frame)
    this.frame.addEventListener('click', () => { if (page.tool === 'mark' && this.choice.marking) page.offerMarks(this) })
    this.frame.addEventListener('keydown', event => this.keydown(event))
    this.frame.addEventListener('focus', () => page.focus(this))
  }

  // What is shown

  async show(view) {
    this.view = view
    this.name = view.name
    this.image = null
    this.pen.forget()
    this.ghost = null
    this.element.querySelector('.name').textContent = view.name
    this.element.querySelector('.kind').textContent = {photograph: 'photograph', rendered: this.page.scene.can.render ? 'rendered by the field' : 'rendered', free: 'your viewpoint, rendered'}[view.kind]
    this.frame.setAttribute('aria-label', `Picture ${this.number + 1}: ${view.name}. Draw here, or press W for waypoints with the arrow keys and Enter.`)
    this.frame.style.setProperty('--aspect', view.camera.width / view.camera.height)
    this.fit()
    this.frame.classList.add('waiting')
    try { this.image = await this.page.pictures.of(view) } catch (error) { this.element.querySelector('.absent').textContent = error.message }
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

  zoomBy(factor, at = [this.frame.clientWidth / 2, this.frame.clientHeight / 2]) { this.zoomFrom(this.zoom, factor, at, at) }

  /** From a zoom {scale, x, y} on: what was at a place of the frame comes to another place, so many times as large. */
  zoomFrom(zoom, factor, [x, y], [u, v]) {
    const scale = Math.min(Math.max(zoom.scale * factor, this.least), CLOSEST * this.least), f = scale / zoom.scale
    this.moveTo(scale, u - f * (x - zoom.x), v - f * (y - zoom.y))
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
    const scale = Math.min(w / (1.6 * (high[0] - low[0]) + 120), h / (1.6 * (high[1] - low[1]) + 120), 3.5 * this.least)
    const bounded = Math.max(scale, this.least)
    this.moveTo(bounded, w / 2 - bounded * (low[0] + high[0]) / 2, h / 2 - bounded * (low[1] + high[1]) / 2)
  }

  /** Position (CSS px of the window) -> pixel of the picture. */
  pixel(event) {
    const {left, top} = this.pointers.corner ?? this.frame.getBoundingClientRect()
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
      ink.paintStroke(g, stroke, this.px, {selected: stroke === page.selected?.stroke, faded: !!motion && !page.stale && page.redraw.view !== this})
    }
    if (motion) { g.globalAlpha = page.stale || page.redraw.view === this ? 0.35 : 1; overlay.paintMotion(g, camera, motion, this.px); g.globalAlpha = 1 }
    if (motion && page.redraw.marked) overlay.paintPart(g, camera, motion, motion.weakest, this.px)
    if (page.plan) overlay.paintPlan(g, camera, page.plan, this.px)
    if (motion && !page.stale) overlay.paintEvents(g, camera, page.happenings(), this.px)
    if (page.shows.strokes) this.paintDisagreements(g)
    this.pen.paint()
    this.paintMoment()
    this.showHint()
  }

  showHint() {
    const words = this.page.hint(this), hint = this.element.querySelector('.hint')
    if (hint.textContent !== words) hint.textContent = words
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

  /** What is of the moment: the arm, where the motion is, help. */
  paintMoment() { this.paintArm(); this.paintHelp() }

  paintArm() {
    const g = this.brush('arm'), {plan, shows, space, clock} = this.page
    if (!plan || !shows.arm || !space.arm) return
    this.ghost ??= new Ghost(this.view.camera, space.mesh)
    this.ghost.paint(g, space.arm, posesAt(plan, clock.time), this.view.camera)
  }

  paintHelp() {
    const g = this.brush('help'), {page} = this
    if (page.shows.motion && page.motion && !this.pen.line) overlay.paintMoment(g, this.view.camera, page.motion, page.plan, page.clock.time, this.px)
    this.choice.paint(g)
    if (page.shows.help) this.pen.paintHelp(g)
  }

  /** Keys on the picture itself; the others are commands.js. */
  keydown(event) {
    const step = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key], {tool} = this.page
    if (event.ctrlKey || event.metaKey || event.altKey || !(step || tool === 'waypoints' && event.key === 'Enter')) return
    event.preventDefault()
    if (tool === 'waypoints') this.pen.key(step, event.shiftKey ? 1 : 10)
    else if (tool === 'select' || tool === 'mark') this.choice.walk(...step, event.shiftKey ? 0.05 : 0.01)
    else this.moveTo(this.zoom.scale, this.zoom.x - 40 * step[0], this.zoom.y - 40 * step[1])
  }

  cancel() {
    const some = this.pen.cancel() || this.choice.cancel()
    if (some) { this.pointers.release(); this.paint() }
    return some
  }
}
