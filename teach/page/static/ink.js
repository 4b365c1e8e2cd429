// Painting in image coordinates: strokes, marks, help. `px` is the size of a CSS pixel there, so that
// lines keep their width on the screen at any zoom.

import {clipped, at} from './geometry.js'

export const INKS = ['#ff6b2c', '#2f9bff', '#3ccf6a', '#d65cff', '#ffc61a', '#16c7c2', '#ff5c8a', '#a5b4fc']
export const inkOf = demonstration => INKS[((demonstration % INKS.length) + INKS.length) % INKS.length]
const RAMP = [[92, 60, 220], [206, 44, 160], [255, 112, 80], [255, 214, 92]]
const KEEP_OUT = '#ff4d4d'
export const ARROW = '#00b7ff'
export const colourOf = stroke => ({keep_out: KEEP_OUT, arrow: ARROW})[stroke.kind] ?? inkOf(stroke.demonstration ?? 0)
export const MARKS = {
  gripper_close: {label: 'Close gripper', short: 'C', glyph: '●'}, gripper_open: {label: 'Open gripper', short: 'O', glyph: '○'},
  pause: {label: 'Pause', short: 'S', glyph: 'Ⅱ'}, contact: {label: 'Touch the surface', short: 'T', glyph: '▼'},
}
const paths = new WeakMap()

/** Colour of time t in [0, 1]: indigo, magenta, orange, yellow. */
export function timeColour(t, alpha = 1) {
  const x = Math.min(Math.max(t, 0), 1) * (RAMP.length - 1), i = Math.min(Math.floor(x), RAMP.length - 2)
  const c = RAMP[i].map((a, k) => Math.round(a + (x - i) * (RAMP[i + 1][k] - a)))
  return `rgb(${c.join(' ')} / ${alpha})`
}

/** The stroke's line, made once. */
export function pathOf(stroke) {
  if (!paths.has(stroke)) {
    const path = new Path2D()
    stroke.points.forEach(([u, v], i) => i ? path.lineTo(u, v) : path.moveTo(u, v))
    if (stroke.kind === 'keep_out') path.closePath()
    paths.set(stroke, path)
  }
  return paths.get(stroke)
}

export function paintStroke(g, stroke, px, {selected = false, faded = false} = {}) {
  const path = pathOf(stroke)
  g.save()
  g.lineCap = g.lineJoin = 'round'
  if (stroke.kind === 'keep_out') {
    g.fillStyle = 'rgb(226 48 48 / .22)'
    g.fill(path)
    g.setLineDash([7 * px, 5 * px])
  }
  g.globalAlpha = faded ? 0.5 : 1
  g.strokeStyle = selected ? '#fff' : 'rgb(12 14 20 / .55)'
  g.lineWidth = (selected ? 7 : 5) * px
  g.stroke(path)
  g.strokeStyle = colourOf(stroke)
  g.lineWidth = 3 * px
  g.stroke(path)
  g.setLineDash([])
  if (stroke.kind === 'arrow') paintHead(g, stroke.points[0], stroke.points.at(-1), 15 * px, ARROW)
  else if (stroke.kind !== 'keep_out') paintStart(g, stroke, px)
  for (const event of stroke.events ?? []) paintMark(g, at(stroke.points, stroke.times, event.time), event.name, px)
  g.restore()
}

function paintStart(g, stroke, px) {
  const [u, v] = stroke.points[0]
  g.beginPath()
  g.arc(u, v, 4.5 * px, 0, 7)
  g.fillStyle = '#fff'
  g.fill()
  g.lineWidth = 2.5 * px
  g.strokeStyle = inkOf(stroke.demonstration ?? 0)
  g.stroke()
}

/** The tip of an arrow from one pixel to another. */
export function paintHead(g, [u, v], [x, y], size, colour) {
  const turn = Math.atan2(y - v, x - u)
  g.beginPath()
  g.moveTo(x + 0.3 * size * Math.cos(turn), y + 0.3 * size * Math.sin(turn))
  for (const side of [2.65, -2.65]) g.lineTo(x + size * Math.cos(turn + side), y + size * Math.sin(turn + side))
  g.closePath()
  g.fillStyle = colour
  g.fill()
}

export function paintWaypoints(g, waypoints, cursor, px, colour) {
  g.lineWidth = 2 * px
  g.strokeStyle = g.fillStyle = colour
  g.beginPath()
  waypoints.forEach((p, i) => i ? g.lineTo(...p) : g.moveTo(...p))
  if (cursor && waypoints.length) g.lineTo(...cursor)
  g.stroke()
  for (const p of waypoints) { g.beginPath(); g.arc(...p, 5 * px, 0, 7); g.fill() }
  if (!cursor) return
  const [u, v] = cursor, r = 14 * px
  for (const [w, style] of [[4, 'rgb(0 0 0 / .6)'], [2, '#fff']]) {
    g.beginPath()
    g.moveTo(u - r, v); g.lineTo(u + r, v); g.moveTo(u, v - r); g.lineTo(u, v + r)
    g.lineWidth = w * px
    g.strokeStyle = style
    g.stroke()
  }
}

export function paintMark(g, [u, v], name, px) {
  g.save()
  g.translate(u, v)
  g.scale(px, px)
  g.beginPath()
  g.arc(0, 0, 10, 0, 7)
  g.fillStyle = '#14161c'
  g.fill()
  g.lineWidth = 2
  g.strokeStyle = '#fff'
  g.stroke()
  g.fillStyle = '#fff'
  g.font = '700 11px system-ui, sans-serif'
  g.textAlign = 'center'
  g.textBaseline = 'middle'
  g.fillText(MARKS[name]?.short ?? '?', 0, 0.5)
  g.restore()
}

/** Help from another view: the band of lines, and the line of the moment. */
export function paintHelp(g, {width, height}, band, line, px, colour) {
  g.save()
  for (let i = 1; i < band.length; i++) {
    const a = clipped(band[i - 1], width, height), b = clipped(band[i], width, height)
    if (!a || !b) continue
    const flip = Math.hypot(a[0][0] - b[0][0], a[0][1] - b[0][1]) > Math.hypot(a[0][0] - b[1][0], a[0][1] - b[1][1])
    const [c, d] = flip ? [b[0], b[1]] : [b[1], b[0]]
    g.beginPath()
    g.moveTo(...a[0]); g.lineTo(...a[1]); g.lineTo(...c); g.lineTo(...d)
    g.closePath()
    g.fillStyle = 'rgb(255 255 255 / .22)'
    g.fill()
  }
  const ends = line && clipped(line, width, height)
  if (ends) {
    for (const [w, style] of [[4, 'rgb(12 14 20 / .5)'], [2, colour]]) {
      g.beginPath()
      g.moveTo(...ends[0]); g.lineTo(...ends[1])
      g.setLineDash([10 * px, 6 * px])
      g.lineWidth = w * px
      g.strokeStyle = style
      g.stroke()
    }
  }
  g.restore()
}

/** Words on a line, near the left end of what is seen of it. */
export function paintWords(g, {width, height}, line, words, px) {
  const ends = clipped(line, width, height)
  if (!ends) return
  const [[x, y], [u, v]] = ends[0][0] < ends[1][0] ? ends : [ends[1], ends[0]], far = Math.max(Math.hypot(u - x, v - y), 1e-9), share = Math.min(1, 90 * px / far)
  paintPill(g, [x + share * (u - x), y + share * (v - y)], words, px, 'rgb(16 18 26 / .86)')
}

/** White words on a rounded ground, in the middle of a place. */
function paintPill(g, [u, v], words, px, colour) {
  g.save()
  g.font = `600 ${12 * px}px system-ui, sans-serif`
  const w = g.measureText(words).width + 16 * px
  g.fillStyle = colour
  g.beginPath()
  g.roundRect(u - w / 2, v - 11 * px, w, 22 * px, 11 * px)
  g.fill()
  g.fillStyle = '#fff'
  g.textAlign = 'center'
  g.textBaseline = 'middle'
  g.fillText(words, u, v + 0.5 * px)
  g.restore()
}

/** The stroke that a click would choose, or take away. */
export function paintHovered(g, stroke, erases, px) {
  g.lineCap = g.lineJoin = 'round'
  g.lineWidth = 11 * px
  g.strokeStyle = erases ? 'rgb(255 45 61 / .55)' : 'rgb(255 255 255 / .55)'
  g.stroke(pathOf(stroke))
}

/** A part of a stroke that its other view contradicts. */
export function paintDisagreement(g, stroke, along, {from, to, most}, px) {
  const room = Math.max(0, 0.03 - (to - from) / 2), inside = stroke.points.filter((_, i) => along[i] >= from - room && along[i] <= to + room)
  if (inside.length < 2) return
  g.save()
  g.beginPath()
  inside.forEach((p, i) => i ? g.lineTo(...p) : g.moveTo(...p))
  g.lineCap = g.lineJoin = 'round'
  g.lineWidth = 13 * px
  g.strokeStyle = 'rgb(255 45 61 / .45)'
  g.stroke()
  g.restore()
  const [u, v] = inside[Math.floor(inside.length / 2)]
  paintPill(g, [u, v - 24 * px], `${Math.round(most)} px apart`, px, 'rgb(160 12 28 / .95)')
}
