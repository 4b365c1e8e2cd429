// Which demonstration the next stroke draws, and the chips that say which there are.

import {inkOf} from './ink.js'

const find = id => document.getElementById(id)
const make = (tag, properties = {}, ...children) => { const e = Object.assign(document.createElement(tag), properties); e.append(...children); return e }

export class Demonstrations {
  constructor(page) { Object.assign(this, {page, chosen: null}) }

  /** The number of the next stroke of a kind on a view: the chosen one, else the least that is free there. */
  next(view, kind = 'motion') {
    if (kind === 'motion' && this.chosen !== null) return this.chosen
    const there = new Set(this.page.document.of(view, kind).map(s => s.demonstration ?? 0))
    let n = 0
    while (there.has(n)) n++
    return n
  }

  choose(n) {
    this.chosen = n
    this.page.say(n === null ? 'The next stroke is a new demonstration.' : `The next stroke draws demonstration ${n + 1} again.`)
    this.show()
  }

  /** To the next one or the one before; beyond them is a new one. */
  step(by) {
    const most = Math.max(0, ...this.page.document.all.map(x => (x.stroke.demonstration ?? 0) + 1)), next = (this.chosen ?? (by > 0 ? -1 : most)) + by
    this.choose(next < 0 || next >= most ? null : next)
  }

  show() {
    const {document: doc} = this.page, all = doc.sketches.flatMap(s => doc.motions(s.view).map(stroke => [stroke.demonstration ?? 0, s.view]))
    const numbers = [...new Set(all.map(([n]) => n))].sort((a, b) => a - b)
    const chips = numbers.map(n => this.chip(n, [...new Set(all.filter(([m]) => m === n).map(([, view]) => view))]))
    const outlines = doc.all.filter(x => x.stroke.kind === 'keep_out').length, arrows = doc.all.filter(x => x.stroke.kind === 'arrow').length
    if (outlines) chips.push(make('span', {className: 'chip still', textContent: `${outlines} keep-out ${outlines === 1 ? 'outline' : 'outlines'}`}))
    if (!numbers.length) chips.unshift(make('p', {className: 'quiet', textContent: 'Each stroke on a picture is one demonstration; two or three show how far the motion may vary.'}))
    if (arrows) chips.push(make('span', {className: 'chip still', textContent: `hand's arrow, ${arrows} ${arrows === 1 ? 'view' : 'views'}`}))
    find('demonstrations').replaceChildren(...chips)
  }

  chip(n, views) {
    const swatch = make('span', {className: 'swatch'}), count = make('small', {textContent: `${views.length} ${views.length === 1 ? 'view' : 'views'}`})
    swatch.style.background = inkOf(n)
    const chip = make('button', {className: 'chip', type: 'button', title: `Draw demonstration ${n + 1} again. It is on ${views.join(', ')}.`}, swatch, make('span', {textContent: `${n + 1}`}), count)
    chip.setAttribute('aria-pressed', this.chosen === n)
    chip.addEventListener('click', () => this.choose(this.chosen === n ? null : n))
    return chip
  }
}
