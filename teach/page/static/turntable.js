// Turning a scene with pointers and keys: around a target, nearer and farther, and the target itself.

import {add, around, centre, depth, orbiting} from './geometry.js'

const KEYS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}

export class Turntable {
  /** element: what is dragged. moved(): told of each move. lowest [rad]: of the elevation. wheels(event): whether the wheel is meant. */
  constructor(element, moved, {lowest = -1.4, wheels = () => true} = {}) {
    Object.assign(this, {element, moved, lowest, fingers: new Map()})
    element.addEventListener('pointerdown', event => { element.setPointerCapture(event.pointerId); this.fingers.set(event.pointerId, [event.clientX, event.clientY]) })
    element.addEventListener('pointermove', event => this.drag(event))
    for (const type of ['pointerup', 'pointercancel', 'lostpointercapture']) element.addEventListener(type, event => this.fingers.delete(event.pointerId))
    element.addEventListener('contextmenu', event => event.preventDefault())
    element.addEventListener('wheel', event => { if (wheels(event)) { event.preventDefault(); this.move({farther: Math.exp(event.deltaY / 500)}) } }, {passive: false})
    element.addEventListener('keydown', event => this.key(event))
  }

  /** Begin where a camera stands, around the place on its axis that is as far as a target. */
  stand(camera, target) {
    const axis = camera.world_from_camera.slice(0, 3).map(row => row[2]), middle = add(centre(camera), axis, Math.max(depth(camera, target), 0.05))
    this.begin({...around(camera, middle), target: middle})
  }

  begin(place) { this.first = this.place = place }

  /** A camera like another one, from here. */
  camera(like) { return orbiting(like, this.place.target, this.place) }

  drag(event) {
    const before = this.fingers.get(event.pointerId)
    if (!before) return
    const dx = event.clientX - before[0], dy = event.clientY - before[1], spread = this.spread()
    this.fingers.set(event.pointerId, [event.clientX, event.clientY])
    if (this.fingers.size === 2) this.move({right: -dx / 2, down: -dy / 2, farther: spread / Math.max(this.spread(), 1)})
    else if (event.shiftKey || event.buttons & 6) this.move({right: -dx, down: -dy})
    else this.move({azimuth: -dx / 160, elevation: dy / 160})
  }

  spread() {
    const [a, b] = [...this.fingers.values()]
    return b ? Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1) : 1
  }

  key(event) {
    const farther = {'+': 0.9, '=': 0.9, '-': 1.1}[event.key], way = KEYS[event.key]
    if (event.ctrlKey || event.metaKey || event.altKey || !(farther || way || event.key === '0')) return
    event.preventDefault()
    event.stopPropagation()
    if (farther) this.move({farther})
    else if (!way) { this.place = this.first; this.moved() }
    else if (event.shiftKey) this.move({right: 20 * way[0], down: -20 * way[1]})
    else this.move({azimuth: 0.1 * way[0], elevation: 0.08 * way[1]})
  }

  /** azimuth, elevation [rad]; farther: a factor; right, down: of the target, in CSS pixels of the element. */
  move({azimuth = 0, elevation = 0, farther = 1, right = 0, down = 0}) {
    const p = this.place, between = (x, low, high) => Math.min(Math.max(x, low), high), step = p.distance / Math.max(this.element.clientHeight, 100)
    const sin = Math.sin(p.azimuth), cos = Math.cos(p.azimuth), up = Math.sin(p.elevation)
    const target = add(add(p.target, [-sin, cos, 0], step * right), [up * cos, up * sin, -Math.cos(p.elevation)], step * down)
    this.place = {target, azimuth: p.azimuth + azimuth, elevation: between(p.elevation + elevation, this.lowest, 1.5), distance: between(p.distance * farther, 0.02, 100)}
    this.moved()
  }
}
