// Help while drawing in a further view: what the stroke in another view says about where the motion is here.

import {fundamental, epipolarLine, evenly, arcLength, at, following} from './geometry.js'

export const TOLERANCE = 0.02 // of the picture's width: two hands' strokes of one motion are rarely further apart
const POINTS = 60
const BAND = 0.06 // of the stroke's length, to either side of where the pen is

export class Helper {
  /** Help for drawing a demonstration in a view, from a share of its way on: from the same demonstration elsewhere, else from the last
   *  stroke elsewhere. */
  static of(document, view, demonstration, start = 0) {
    const others = document.sketches.filter(s => s.view !== view.name)
      .map(s => ({camera: s.camera, strokes: s.strokes.filter(x => (x.kind ?? 'motion') === 'motion')})).filter(s => s.strokes.length)
    const best = others.find(s => s.strokes.some(x => (x.demonstration ?? 0) === demonstration)) ?? others[0]
    const F = best && fundamental(best.camera, view.camera)
    if (!F) return null
    return new Helper(F, best.strokes.find(x => (x.demonstration ?? 0) === demonstration) ?? best.strokes.at(-1), start)
  }

  constructor(F, stroke, start) {
    this.F = F
    this.stroke = stroke
    this.even = evenly(stroke.points, POINTS)
    this.along = arcLength(stroke.points)
    this.s = start
    this.began = at(stroke.times.map(t => [t]), this.along, start)[0]
  }

  /** Epipolar lines of the part that the pen, at pixel q (null: not down yet), is drawing now, and of the moment seconds after the start (of where
   *  the pen is, where there is no clock). */
  at(q, seconds) {
    if (q) this.s = following(this.even, this.F, q, this.s)
    const part = Array.from({length: 9}, (_, i) => this.s + BAND * (i / 4 - 1)).filter(s => s >= 0 && s <= 1)
    const band = part.map(s => epipolarLine(this.F, at(this.stroke.points, this.along, s))).filter(Boolean)
    const {points, times} = this.stroke
    const point = seconds === null ? at(points, this.along, this.s) : at(points, times, this.began + seconds)
    return {band, line: epipolarLine(this.F, point)}
  }
}
