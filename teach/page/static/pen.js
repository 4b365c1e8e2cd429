// Strokes as they are drawn on a picture. A sample is an event of the browser: each coalesced one, with its own time, as it came.

import {arcLength} from './geometry.js'
import {Helper} from './help.js'
import * as ink from './ink.js'

const TAP = 4 // CSS px that a stroke is longer than
const AGAIN = 6 // CSS px within which a waypoint is the last one once more
const PACE = 0.3 // picture widths per second at which waypoints are followed
const KINDS = {draw: 'motion', keep_out: 'keep_out', arrow: 'arrow'}
const exact = x => Math.round(x * 1e4) / 1e4 // a ten-thousandth of a pixel: less than any screen or pen tells

export class Pen {
  constructor(view) { Object.assign(this, {view, page: view.page, line: null, painted: 0}); this.forget() }

  /** Another picture is shown: what was begun on the one before is gone. */
  forget() { this.line = this.cursor = this.helper = this.over = null; this.waypoints = [] }

  draws(tool) { return tool in KINDS }

  // A line

  begin(event, tool) {
    const kind = KINDS[tool]
    this.line = {points: [], times: [], demonstration: this.page.demonstrations.next(this.view.name, kind), kind, events: [], pressure: [], pointer: event.pointerType || 'mouse'}
    this.start = event.timeStamp
    this.helper = this.over = null
    this.began = performance.now()
    this.painted = 0
    this.sample(event)
    this.page.startDrawing(this.view)
    this.askHelp()
  }

  sample(event) {
    const {points, times, pressure} = this.line, time = Math.round((event.timeStamp - this.start) * 1e3) / 1e6
    points.push(this.view.pixel(event).map(exact))
    times.push(Math.max(time, times.at(-1) ?? 0))
    pressure.push(exact(event.pressure ?? 0))
  }

  move(event) {
    if (!this.line) return
    const samples = event.getCoalescedEvents?.() ?? []
    for (const sample of samples.length ? samples : [event]) this.sample(sample)
    this.paintSamples()
    this.askHelp()
  }

  finish(event) {
    const {view} = this, last = this.line.points.at(-1), here = view.pixel(event)
    if (Math.hypot(here[0] - last[0], here[1] - last[1]) > 1e-3) { // where it is lifted is a sample too; without pressure, it has the last
      this.sample(event)
      this.line.pressure[this.line.pressure.length - 1] = this.line.pressure.at(-2)
    }
    const stroke = this.line, extent = axis => Math.max(...stroke.points.map(p => p[axis])) - Math.min(...stroke.points.map(p => p[axis]))
    this.line = null
    if (stroke.points.length < 2 || Math.max(extent(0), extent(1)) * view.zoom.scale < TAP) {
      this.page.say('That was a dot: press and draw a line.')
      return this.paint()
    }
    this.page.addStroke(view, stroke)
  }

  /** The pen is over the picture (or has left it: null), and nothing is being drawn. */
  hover(event) {
    const over = event && !this.line && this.page.tool === 'draw'
    if (!over && !this.over) return
    this.over = over
    this.view.paintHelp()
  }

  drop() { this.line = null; this.paint() }

  /** Nothing is being drawn: help belongs to nothing. */
  rest() { this.helper = null; this.view.paintHelp() }

  cancel() {
    const some = !!(this.line || this.waypoints.length || this.cursor)
    this.forget()
    return some
  }

  // Waypoints

  waypoint(p) {
    const last = this.waypoints.at(-1)
    if (last && Math.hypot(p[0] - last[0], p[1] - last[1]) * this.view.zoom.scale < AGAIN) return this.finishWaypoints()
    this.waypoints.push(p.map(exact))
    this.cursor = p
    this.page.say(`Waypoint ${this.waypoints.length}: add more; Enter on the last one finishes.`)
    this.paint()
    this.view.paintHelp()
  }

  finishWaypoints() {
    const points = this.waypoints, along = arcLength(points), {width} = this.view.view.camera
    this.waypoints = []
    if (points.length < 2) { this.page.say('A motion needs two waypoints or more.'); return this.view.paint() }
    const length = points.slice(1).reduce((sum, p, i) => sum + Math.hypot(p[0] - points[i][0], p[1] - points[i][1]), 0)
    const duration = Math.max(0.5, length / width / PACE)
    this.helper = null
    this.page.addStroke(this.view, {points, times: along.map(x => exact(x * duration)), demonstration: this.page.demonstrations.next(this.view.name), kind: 'motion', events: [], pointer: 'waypoints'})
  }

  /** An arrow key (step) moves the cross by so many pixels, Enter (none) sets a waypoint there. */
  key(step, far) {
    const {width, height} = this.view.view.camera
    this.cursor ??= this.waypoints.at(-1) ?? [width / 2, height / 2]
    if (!step) return this.waypoint(this.cursor)
    this.cursor = this.cursor.map((x, axis) => x + far * step[axis])
    this.page.say(`At ${Math.round(this.cursor[0])}, ${Math.round(this.cursor[1])} of the picture`)
    this.paint()
  }

  // Painting

  paint() {
    const g = this.view.brush('live')
    if (this.line) { this.painted = 0; this.paintSamples() }
    if (this.waypoints.length || this.cursor) ink.paintWaypoints(g, this.waypoints, this.cursor, this.view.px, ink.inkOf(this.page.demonstrations.next(this.view.name)))
  }

  /** Add the samples that arrived to the line: nothing of what is painted already is touched. */
  paintSamples() {
    const {points} = this.line, g = this.view.brush('live', false)
    g.beginPath()
    g.moveTo(...points[Math.max(this.painted - 1, 0)])
    for (let i = this.painted; i < points.length; i++) g.lineTo(...points[i])
    g.lineCap = g.lineJoin = 'round'
    g.lineWidth = 3 * this.view.px
    g.strokeStyle = ink.colourOf(this.line)
    g.stroke()
    this.painted = points.length
  }

  askHelp() { this.helping ??= requestAnimationFrame(() => { this.helping = null; this.view.paintHelp(); if (this.line) this.askHelp() }) }

  paintHelp(g) {
    const {line, view, page} = this
    if (this.over && !line) return this.paintBeginning(g)
    if (!(line?.kind === 'motion' || this.waypoints.length)) return
    const helper = this.helper ??= Helper.of(page.document, view.view, line?.demonstration ?? page.demonstrations.next(view.name), page.redraw.start(view))
    if (!helper) return
    const {band, line: moment} = helper.at(line ? line.points.at(-1) : this.waypoints.at(-1), line ? (performance.now() - this.began) / 1000 : null)
    ink.paintHelp(g, view.view.camera, band, moment, view.px, ink.inkOf(helper.stroke.demonstration ?? 0))
  }

  /** Where the stroke that comes next begins, where another view has it already. */
  paintBeginning(g) {
    const {view, page} = this, next = page.demonstrations.next(view.name)
    if (page.redraw.view || !page.document.sketches.some(s => s.view !== view.name && page.document.motions(s.view).some(x => (x.demonstration ?? 0) === next))) return
    const helper = Helper.of(page.document, view.view, next)
    if (!helper) return
    const {band, line} = helper.at(null, 0)
    ink.paintHelp(g, view.view.camera, band, line, view.px, ink.inkOf(next))
    if (line) ink.paintWords(g, view.view.camera, line, 'It begins on this line', view.px)
  }
}
