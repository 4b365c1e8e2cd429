// Choosing among the strokes of a picture, and a place on one, with pointers and keys.

import {at} from './geometry.js'
import * as ink from './ink.js'

export class Choice {
  constructor(view) { Object.assign(this, {view, page: view.page, marking: null, hovered: null}) }

  /** The stroke under a pixel, and the time on it: {stroke, time}; null where there is none within reach [CSS px]. */
  under(p, reach = 14) {
    let best = null, least = (reach * this.view.px) ** 2
    for (const stroke of this.page.document.strokes(this.view.name)) {
      const {points, times} = stroke
      for (let i = 0; i < points.length; i++) {
        const j = Math.min(i + 1, points.length - 1), a = points[i], dx = points[j][0] - a[0], dy = points[j][1] - a[1]
        const f = Math.min(Math.max(((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / Math.max(dx * dx + dy * dy, 1e-12), 0), 1)
        const d = (a[0] + f * dx - p[0]) ** 2 + (a[1] + f * dy - p[1]) ** 2
        if (d < least) { least = d; best = {stroke, time: times[i] + f * (times[j] - times[i])} }
      }
    }
    return best
  }

  /** What the pointer is over, at a pixel (null: it has left), with a tool that chooses. */
  hover(p) {
    const {tool} = this.page, found = p && ['select', 'mark', 'erase'].includes(tool) ? this.under(p, tool === 'mark' ? 30 : 14)?.stroke ?? null : null
    this.view.frame.classList.toggle('over', !!found)
    if (found === this.hovered) return
    this.hovered = found
    this.view.paintHelp()
  }

  choose(p, marking) {
    const found = this.under(p, marking ? 30 : 14)
    this.page.select(found && {view: this.view.name, stroke: found.stroke})
    this.marking = found && (found.stroke.kind ?? 'motion') === 'motion' ? found : null
    this.view.paintHelp()
  }

  erase(p) {
    const found = this.under(p)
    if (found) this.page.document.remove(this.view.name, found.stroke)
  }

  /** Up and down choose a stroke, left and right a moment on it. */
  walk(along, among, step) {
    const strokes = this.page.document.strokes(this.view.name)
    if (!strokes.length) return this.page.say('There is no stroke on this picture yet.')
    let i = strokes.indexOf(this.page.selected?.stroke)
    i = i < 0 ? 0 : (i + among + strokes.length) % strokes.length
    const stroke = strokes[i], [first, last] = [stroke.times[0], stroke.times.at(-1)]
    const time = this.marking?.stroke === stroke ? this.marking.time : (first + last) / 2
    this.marking = {stroke, time: Math.min(Math.max(time + along * step * (last - first), first), last)}
    this.page.select({view: this.view.name, stroke})
    this.page.say(`Stroke ${i + 1} of ${strokes.length}, ${Math.round(100 * (this.marking.time - first) / Math.max(last - first, 1e-9))} % along`)
    this.view.paintHelp()
  }

  paint(g) {
    const {hovered, page, view} = this
    if (hovered && page.document.strokes(view.name).includes(hovered)) ink.paintHovered(g, hovered, page.tool === 'erase', view.px)
    this.paintMarking(g)
  }

  paintMarking(g) { if (this.marking) ink.paintMark(g, at(this.marking.stroke.points, this.marking.stroke.times, this.marking.time), '', this.view.px) }

  cancel() {
    const some = !!this.marking
    this.marking = null
    return some
  }
}
