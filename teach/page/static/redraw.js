// Drawing the least certain part anew: what is drawn takes the place of what lies between where it begins and ends on a stroke.

import {arcLength, at} from './geometry.js'

const NEAR = 40 // CSS px from a stroke within which a part begins and ends on it
const ROOM = 0.08 // of the motion, that is seen before and after the part
const WHOLE = 0.85 // of a stroke: who draws more than this draws the whole motion

export class Redraw {
  constructor(page) { Object.assign(this, {page, view: null, shown: false}) }

  get weak() { return this.page.stale ? null : this.page.motion?.weakest }

  /** Whether the part is marked on the pictures: where it clearly is the worst, or where one asks for it. */
  get marked() { return !!this.weak && (this.weak.clear || this.shown || !!this.view) }

  /** Marked while the pointer or the focus is on the offer. */
  show(shown) { this.shown = shown; this.page.paint(); this.page.timeline.show() }

  words() {
    const {from, to, view} = this.weak
    return `Least certain, by a little: ${Math.round(100 * from)} to ${Math.round(100 * to)} %, best seen on ${view}.`
  }

  /** Go to the view that sees best what is least known, close up on that part. */
  async begin() {
    const {page, weak} = this
    if (!weak) return page.say('There is no motion yet whose part could be drawn again.')
    let view = page.views.find(v => v.name === weak.view)
    if (!view) { view = page.focused; await view.show(page.pictures.named(weak.view)) }
    page.setTool('draw')
    this.view = view
    page.setTime((weak.from + weak.to) / 2)
    page.focus(view)
    view.frame.focus()
    view.look(page.motion.ways[0].mean.filter((_, i) => page.motion.times[i] >= weak.from - ROOM && page.motion.times[i] <= weak.to + ROOM))
    page.paint()
    page.say(`Draw the yellow part anew on ${weak.view}: begin and end on a stroke. Or draw the whole motion once more.`)
  }

  /** Where along the motion the line that begins on a view is, as far as is known. */
  start(view) { return this.view === view && this.weak ? Math.max(this.weak.from - 0.05, 0) : 0 }

  /** Nothing is drawn again any more. Whether something was. */
  end() {
    const {view} = this
    this.view = null
    if (view) view.fit()
    return !!view
  }

  /** What a line drawn on a view mends: {stroke, mended}; null where it is a motion of its own. */
  mends(view, line) {
    if (this.view !== view || line.kind !== 'motion') return null
    const ends = [line.points[0], line.points.at(-1)], reach = NEAR / view.zoom.scale
    const found = this.page.document.motions(view.name).map(stroke => ({stroke, ends: ends.map(p => nearest(stroke, p))}))
      .filter(({stroke, ends: [a, b]}) => Math.max(a.far, b.far) < reach && Math.abs(b.along - a.along) < WHOLE && a.time !== b.time && stroke.points.length > 2)
    if (!found.length) return null
    const {stroke, ends: [a, b]} = found.reduce((best, one) => one.ends[0].far + one.ends[1].far < best.ends[0].far + best.ends[1].far ? one : best)
    return {stroke, mended: a.time < b.time ? spliced(stroke, line, a.time, b.time) : spliced(stroke, backwards(line), b.time, a.time)}
  }
}

/** The place of a stroke nearest to a pixel: how far, its time, its share of the length. */
function nearest({points, times}, p) {
  const along = arcLength(points)
  let best = {far: Infinity}
  for (let i = 1; i < points.length; i++) {
    const [a, b] = [points[i - 1], points[i]], d = [b[0] - a[0], b[1] - a[1]]
    const f = Math.min(Math.max(((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1]) / Math.max(d[0] ** 2 + d[1] ** 2, 1e-12), 0), 1)
    const far = Math.hypot(a[0] + f * d[0] - p[0], a[1] + f * d[1] - p[1])
    if (far < best.far) best = {far, time: times[i - 1] + f * (times[i] - times[i - 1]), along: along[i - 1] + f * (along[i] - along[i - 1])}
  }
  return best
}

function backwards(line) {
  const last = line.times.at(-1)
  return {...line, points: line.points.toReversed(), times: line.times.map(t => last - t).reverse(), pressure: line.pressure?.toReversed()}
}

/** A stroke whose samples between two of its times are those of a line; what comes after happens as much later as the line took longer.
 *  Samples stay as they were drawn. */
export function spliced(stroke, line, from, to) {
  const exact = x => Math.round(x * 1e6) / 1e6, took = line.times.at(-1) - line.times[0], later = from + took - to
  const head = stroke.times.findLastIndex(t => t < from) + 1, rest = stroke.times.findIndex(t => t > to), tail = rest < 0 ? stroke.times.length : rest
  const joined = key => [...stroke[key].slice(0, head), ...line[key], ...stroke[key].slice(tail)]
  const when = t => t <= from ? t : t >= to ? t + later : from + (t - from) / (to - from) * took
  return {
    ...stroke, points: joined('points'), pressure: stroke.pressure && line.pressure ? joined('pressure') : undefined,
    times: [...stroke.times.slice(0, head), ...line.times.map(t => from + t - line.times[0]), ...stroke.times.slice(tail).map(t => t + later)].map(exact),
    events: (stroke.events ?? []).map(e => ({...e, time: exact(when(e.time))})),
  }
}
