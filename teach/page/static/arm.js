// The arm: its links as solids, where they are at a moment of a plan, and how a picture's camera would see it.

import {resized} from './geometry.js'
import {Raster, creased, matrixOf} from './raster.js'

const COLOURS = {arm: [232, 234, 240], hand: [120, 128, 148]}
const WIDTH = 640 // px of the arm's picture at most: it is drawn anew at every moment

export class Arm {
  /** links: {vertices, faces} each. home: their poses at rest. */
  constructor({links, home}) {
    const hand = links.findLastIndex(link => link.faces.length > 40)
    this.home = home
    this.links = links.map((link, i) => creased(link.vertices, link.faces, i >= hand ? COLOURS.hand : COLOURS.arm))
  }

  draw(raster, camera, poses) { this.links.forEach((link, i) => raster.solid(camera, link, {pose: matrixOf(poses[i])})) }
}

/** The arm as the camera of a picture would see it, behind what stands before it. */
export class Ghost {
  constructor(like, mesh) {
    const width = Math.min(WIDTH, like.width), height = Math.round(width * like.height / like.width)
    this.camera = resized(like, width, height)
    this.raster = new Raster(width, height)
    this.picture = Object.assign(document.createElement('canvas'), {width, height})
    if (mesh) this.raster.solid(this.camera, mesh)
    this.raster.pixels.fill(0)
    this.raster.keep()
  }

  paint(g, arm, poses, {width, height}) {
    this.raster.restore()
    arm.draw(this.raster, this.camera, poses)
    this.picture.getContext('2d').putImageData(this.raster.image, 0, 0)
    g.globalAlpha = 0.62
    g.drawImage(this.picture, 0, 0, width, height)
    g.globalAlpha = 1
  }
}

/** Where the links of a plan are at a share of its time. */
export function posesAt({times, duration, links}, t) {
  const now = t * duration, i = Math.max(0, Math.min(times.findLastIndex(time => time <= now), times.length - 2))
  const f = Math.min(Math.max((now - times[i]) / (times[i + 1] - times[i]), 0), 1)
  return links[i].map((a, k) => blended(a, links[i + 1][k], f))
}

/** Between two poses [position, quaternion] that are near to each other. */
function blended(a, b, f) {
  const same = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] >= 0 ? 1 : -1
  const mixed = a.map((x, i) => (1 - f) * x + f * (i > 2 ? same : 1) * b[i]), length = Math.hypot(...mixed.slice(3))
  return mixed.map((x, i) => i > 2 ? x / length : x)
}
