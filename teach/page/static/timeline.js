// What lies along the slider: the events of the motion, and its least certain part.

import {MARKS} from './ink.js'

const find = id => document.getElementById(id)
const place = t => `calc(10px + ${t} * (100% - 20px))` // the slider's thumb is 20 px wide

export class Timeline {
  constructor(page) { this.page = page }

  /** Events that are shown: {name, at} with at from 0 to 1, of the checked motion where there is one. */
  get events() {
    const {plan, motion, stale} = this.page, {events, duration} = plan ?? (stale ? null : motion) ?? {events: []}
    return (events ?? []).map(({name, time}) => ({name, at: Math.min(time / duration, 1)}))
  }

  show() {
    const {plan, redraw} = this.page, weak = find('weak')
    find('ticks').replaceChildren(...this.events.map(({name, at}) => {
      const tick = Object.assign(document.createElement('span'), {textContent: MARKS[name]?.short ?? '?', title: MARKS[name]?.label ?? name})
      tick.style.left = place(at)
      return tick
    }))
    weak.hidden = !!plan || !redraw.marked
    if (weak.hidden) return
    weak.style.left = place(redraw.weak.from)
    weak.style.right = `calc(100% - (10px + ${redraw.weak.to} * (100% - 20px)))`
  }
}
