// Painting what was learned and checked over a picture, in its own pixels. `px` is the size of a CSS pixel there.

import {add, project, ellipse, at, depth} from './geometry.js'
import {ARROW, paintHead, paintMark, timeColour} from './ink.js'

/** A polyline of world points as the camera sees it, painted piece by piece in the colour of its time. */
export function paintTimed(g, camera, points, times, width, alpha, colour = timeColour) {
  g.lineWidth = width
  g.lineCap = 'round'
  let before = null
  points.forEach((point, i) => {
    const here = project(camera, point)
    if (before && here) {
      g.beginPath()
      g.moveTo(...before)
      g.lineTo(...here)
      g.strokeStyle = colour(times[i], alpha)
      g.stroke()
    }
    before = here
  })
}

/** The learned motion: its spread as ellipses of two deviations, samples, the mean. */
export function paintMotion(g, camera, motion, px) {
  const {times} = motion
  motion.ways.forEach((way, number) => {
    g.save()
    if (!number) for (let i = 0; i < times.length; i += 4) {
      const e = ellipse(camera, way.mean[i], way.covariance[i])
      if (!e || e.radii[0] > camera.width) continue
      g.beginPath()
      g.ellipse(...e.at, 2 * e.radii[0], 2 * e.radii[1], e.turn, 0, 7)
      g.fillStyle = timeColour(times[i], 0.07)
      g.fill()
    }
    for (const sample of way.samples) paintTimed(g, camera, sample, times, 1.1 * px, 0.4)
    paintTimed(g, camera, way.mean, times, 7 * px, 0.75, () => 'rgb(255 255 255 / .8)')
    paintTimed(g, camera, way.mean, times, 4 * px, 1)
    g.restore()
  })
}

/** The marks of events at their places [{name, point}] of the world. */
export function paintEvents(g, camera, events, px) {
  for (const {name, point} of events) { const here = project(camera, point); if (here) paintMark(g, here, name, px) }
}

/** A part of the motion {from, to}, marked. */
export function paintPart(g, camera, motion, {from, to}, px) {
  const inside = motion.ways[0].mean.filter((_, i) => motion.times[i] >= from && motion.times[i] <= to).map(p => project(camera, p)).filter(Boolean)
  g.save()
  g.beginPath()
  inside.forEach((p, i) => i ? g.lineTo(...p) : g.moveTo(...p))
  g.lineWidth = 18 * px
  g.lineCap = g.lineJoin = 'round'
  g.strokeStyle = 'rgb(255 205 0 / .5)'
  g.stroke()
  g.restore()
}

/** The checked motion: white where it is well, red where the arm touches something or does not follow. */
export function paintPlan(g, camera, plan, px) {
  const bad = i => plan.touches[i] || plan.strays[i] || (!plan.feasible && !plan.touches.some(Boolean) && !plan.strays.some(Boolean))
  let before = null
  g.save()
  g.lineCap = 'round'
  plan.tip.forEach((point, i) => {
    const here = project(camera, point)
    if (before && here) {
      g.beginPath()
      g.moveTo(...before)
      g.lineTo(...here)
      g.lineWidth = (bad(i) ? 6 : 2.5) * px
      g.strokeStyle = bad(i) ? '#ff2d3d' : 'rgb(120 255 190 / .95)'
      g.stroke()
    }
    before = here
  })
  g.restore()
}

/** Where the motion is at a share of its time, with its spread, and how the hand is held; of a plan, where the arm's tip is. */
export function paintMoment(g, camera, motion, plan, t, px) {
  for (const way of motion.ways) {
    const i = Math.round(t * (motion.times.length - 1)), point = plan ? tipAt(plan, t) : at(way.mean, motion.times, t), here = project(camera, point)
    if (!here) continue
    const e = !plan && ellipse(camera, way.mean[i], way.covariance[i])
    if (e) {
      g.beginPath()
      g.ellipse(...here, 2 * e.radii[0], 2 * e.radii[1], e.turn, 0, 7)
      g.fillStyle = 'rgb(255 255 255 / .2)'
      g.fill()
      g.lineWidth = 1.2 * px
      g.strokeStyle = 'rgb(255 255 255 / .8)'
      g.stroke()
    }
    if (motion.axis) paintAxis(g, camera, point, motion.axis, px)
    g.beginPath()
    g.arc(...here, 6.5 * px, 0, 7)
    g.fillStyle = timeColour(t)
    g.fill()
    g.lineWidth = 2.5 * px
    g.strokeStyle = '#fff'
    g.stroke()
    if (plan) return
  }
}

/** The direction in which the hand points, as a line that ends where it is. */
function paintAxis(g, camera, point, axis, px) {
  const here = project(camera, point), back = project(camera, add(point, axis, -0.05 * depth(camera, point)))
  if (!back) return
  const far = Math.hypot(here[0] - back[0], here[1] - back[1]), reach = far > 9 * px ? 1 - 9 * px / far : 1
  const tip = [0, 1].map(k => back[k] + reach * (here[k] - back[k]))
  g.beginPath()
  g.moveTo(...back); g.lineTo(...tip)
  g.lineCap = 'round'
  g.lineWidth = 3.5 * px
  g.strokeStyle = ARROW
  g.stroke()
  paintHead(g, back, tip, 10 * px, ARROW)
}

/** Where a plan's tip is at a share of its time. */
export const tipAt = (plan, t) => at(plan.tip, plan.times, t * plan.duration)
