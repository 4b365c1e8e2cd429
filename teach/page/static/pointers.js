// What mouse, pen and fingers do on a picture: one of them draws, two fingers zoom, palms do nothing.
//
// The first finger's line is taken back where a second one follows at once; from then on all fingers zoom, until the last is lifted.

const PALM = 1500 // ms after a pen was near, in which fingers are the palm's
const TOGETHER = 250 // ms within which a second finger means to zoom
const FEW = 12 // samples after which a line is meant

export class Pointers {
  constructor(view) {
    Object.assign(this, {view, page: view.page, frame: view.frame, touches: new Map(), penAt: -Infinity, doing: null})
    for (const type of ['pointerdown', 'pointermove', 'pointerup', 'pointercancel', 'lostpointercapture']) this.frame.addEventListener(type, event => this[type](event))
    this.frame.addEventListener('pointerleave', () => this.hover(null))
    this.frame.addEventListener('contextmenu', event => event.preventDefault())
    this.frame.addEventListener('wheel', event => this.wheel(event), {passive: false})
  }

  pointerdown(event) {
    const {view, frame} = this, touch = event.pointerType === 'touch', {pen} = view
    frame.focus({preventScroll: true})
    if (event.pointerType === 'pen') { this.penAt = event.timeStamp; if (pen.line?.pointer === 'touch') this.drop() } // it was the palm
    if (touch && (pen.line?.pointer === 'pen' || event.timeStamp - this.penAt < PALM)) return
    if (touch) { this.touches.set(event.pointerId, [event.clientX, event.clientY]); frame.setPointerCapture(event.pointerId) }
    if (touch && this.touches.size > 1) return this.secondFinger(event)
    if (this.active !== undefined) return
    event.preventDefault()
    this.corner = frame.getBoundingClientRect()
    this.active = event.pointerId
    this.began = event.timeStamp
    frame.setPointerCapture(event.pointerId)
    this.doing = event.button === 1 || event.button === 2 ? 'pan' : this.page.tool
    if (this.doing === 'pan') this.grip = [event.clientX - view.zoom.x, event.clientY - view.zoom.y]
    else if (pen.draws(this.doing)) pen.begin(event, this.doing)
    else if (!touch) this.act(event) // a finger may be the first of two: it acts when it is lifted
  }

  /** What a press does that draws no line. */
  act(event) {
    const {view, doing} = this, pixel = view.pixel(event)
    if (doing === 'waypoints') view.pen.waypoint(pixel)
    else if (doing === 'select' || doing === 'mark') view.choice.choose(pixel, doing === 'mark')
    else if (doing === 'erase') view.choice.erase(pixel)
  }

  pointermove(event) {
    const {view} = this
    if (event.pointerType === 'pen') this.penAt = event.timeStamp
    if (this.touches.has(event.pointerId)) this.pinched(event)
    if (this.active === undefined && event.pointerType !== 'touch') this.hover(event)
    if (event.pointerId !== this.active) return
    if (this.doing === 'pan') view.moveTo(view.zoom.scale, event.clientX - this.grip[0], event.clientY - this.grip[1])
    else if (this.doing === 'erase' && !this.mayZoom(event)) this.act(event)
    else view.pen.move(event)
  }

  /** Nothing is pressed: what would happen here if it were. */
  hover(event) {
    const {view} = this
    if (!view.view || this.page.views.some(v => v.pen.line)) return
    view.pen.hover(event)
    view.choice.hover(event && view.pixel(event))
  }

  mayZoom(event) { return event.pointerType === 'touch' && event.timeStamp - this.began < TOGETHER }

  pointerup(event) {
    this.touches.delete(event.pointerId)
    if (event.pointerType === 'pen') this.penAt = event.timeStamp
    if (event.pointerId === this.active) {
      if (this.view.pen.line) this.view.pen.finish(event)
      else if (event.pointerType === 'touch') this.act(event)
      this.release()
    } else if (this.doing === 'pinch' && !this.touches.size) this.release()
  }

  pointercancel(event) {
    this.touches.delete(event.pointerId)
    if (event.pointerId === this.active) this.drop()
    else if (this.doing === 'pinch' && !this.touches.size) this.release()
  }

  lostpointercapture(event) { if (event.pointerId === this.active || this.touches.has(event.pointerId)) this.pointercancel(event) }

  /** Nothing is drawn any more, and nothing is left of what was. */
  drop() { this.view.pen.drop(); this.release() }

  release() {
    this.active = this.doing = this.corner = undefined
    this.view.pen.rest()
  }

  /** A second finger soon after the first means to zoom; later it is a palm, and does nothing. */
  secondFinger(event) {
    const {line} = this.view.pen, palm = line && (line.pointer !== 'touch' || event.timeStamp - this.began > TOGETHER || line.points.length > FEW)
    if (palm || this.touches.size !== 2 || this.doing && this.active === undefined && this.doing !== 'pinch') return
    this.drop()
    this.doing = 'pinch'
    this.pinch = [...this.touches.values()].map(p => [...p])
    this.pinchFrom = {...this.view.zoom}
  }

  pinched(event) {
    this.touches.set(event.pointerId, [event.clientX, event.clientY])
    if (this.doing !== 'pinch' || this.touches.size !== 2) return
    const [a, b] = this.pinch, [c, d] = [...this.touches.values()], {left, top} = this.frame.getBoundingClientRect()
    const middle = (p, q) => [(p[0] + q[0]) / 2 - left, (p[1] + q[1]) / 2 - top]
    this.view.zoomFrom(this.pinchFrom, Math.hypot(c[0] - d[0], c[1] - d[1]) / Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1), middle(a, b), middle(c, d))
  }

  wheel(event) {
    if (!event.ctrlKey && this.page.tool !== 'pan') return
    event.preventDefault()
    const {left, top} = this.frame.getBoundingClientRect()
    this.view.zoomBy(Math.exp(-event.deltaY / 300), [event.clientX - left, event.clientY - top])
  }
}
