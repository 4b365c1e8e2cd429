// What the server works on for this skill: learning after each change, checking, performing.

import {ask, skillPath, tab, Answer} from './server.js'

const find = id => document.getElementById(id)
const DELAY = 120 // ms after a change: the last of several strokes is the one that counts
const unknown = error => error instanceof Answer ? error.message : 'the server does not answer'

export class Work {
  constructor(page) { this.page = page; this.running = {} }

  forget() {
    clearTimeout(this.timer)
    this.stop() // what another skill asked for is not this one's
    this.page.motion = this.page.plan = null
    this.page.stale = this.page.performed = false
    find('video').removeAttribute('src')
    this.tellAll('')
  }

  /** Strokes changed: what was learned is of yesterday until it is learned anew. */
  changed() {
    this.page.stale = true
    this.page.plan = null
    this.page.performed = false
    clearTimeout(this.timer)
    const advice = this.page.advice()
    if (advice) { this.page.motion = null; this.tellAll(advice) }
    else if (this.page.scene.can.fit) this.timer = setTimeout(() => this.fit(), DELAY)
    this.page.setTime(this.page.clock.time)
    this.page.refreshCommands?.()
    this.space()
  }

  pause() { clearTimeout(this.timer) }

  async fit() {
    const {page} = this, {saver} = page
    await saver.running
    if (saver.state !== 'saved' || page.views.some(v => v.pen.line)) return
    const began = performance.now()
    const learned = await this.do('fit', 'Learning the motion')
    if (!learned) return
    page.motion = learned
    page.stale = learned.revision !== saver.revision
    this.seconds = (performance.now() - began) / 1000
    this.tellAll(learned.sentence, learned.warnings)
    this.redrawOffered()
    page.setTime(page.clock.time)
    page.refreshCommands()
    page.paint()
    this.space()
  }

  /** One piece of work by its name; null where it could not be done, which is said. */
  async do(name, words) {
    this.running[name]?.abort()
    const controller = this.running[name] = new AbortController()
    this.busy(words, null)
    try {
      return await ask(`${skillPath(this.page.name)}/${name}`, {method: 'POST', body: {tab}, signal: controller.signal})
    } catch (error) {
      if (controller.signal.aborted || error.status === 409 && error.body?.field === 'tab') return null
      if (name === 'fit') { this.page.motion = null; this.page.paint(); this.space() }
      this.tellAll(sentence(unknown(error)), [], 'bad')
      return null
    } finally {
      if (this.running[name] === controller) { delete this.running[name]; this.busy('') }
    }
  }

  stop() {
    const some = Object.keys(this.running).length > 0
    for (const controller of Object.values(this.running)) controller.abort()
    return some
  }

  progress({work, share, words, tab: whose}) { if (whose === tab && this.running[work]) this.busy(words, share) }

  busy(words, share) {
    find('busy').hidden = !words
    find('busy-words').textContent = words ?? ''
    if (share == null) find('busy-bar').removeAttribute('value')
    else find('busy-bar').value = share
  }

  tellAll(text, warnings = [], mood = '') {
    find('sentence').textContent = text
    find('sentence').dataset.mood = mood
    const list = find('warnings')
    list.replaceChildren(...warnings.map(w => Object.assign(document.createElement('li'), {textContent: w})))
    list.tabIndex = list.scrollHeight > list.clientHeight ? 0 : -1 // what has to be scrolled can be by keys
    find('redraw').hidden = true
    find('verdict').hidden = true
    find('suggest').hidden = !this.page.scene.can.suggest || !this.page.drawn.length
  }

  /** Where the strokes of the views that are shown contradict each other: which part, and by how much. */
  tellApart() {
    const found = this.page.views.filter(v => v.view).flatMap(v => v.disagreements().map(d => ({...d, view: v.name})))
    find('apart').replaceChildren(...found.map(({stroke, part, other, view}) => Object.assign(document.createElement('li'), {
      textContent: `Demonstration ${(stroke.demonstration ?? 0) + 1}, ${about(part)} on ${view}: up to ${Math.round(part.most)} px from where ${other} puts it.`,
    })))
  }

  redrawOffered() {
    const {redraw} = this.page, {weak} = redraw
    find('redraw').hidden = !weak
    if (weak) find('redraw-words').textContent = weak.clear ? '' : redraw.words() // where it is clear, the sentence says it
  }

  async check() {
    const {page} = this
    if (!page.motion || page.stale) return page.say(page.advice() ?? 'The motion is being learned: check it in a moment.')
    const plan = await this.do('plan', 'Looking for a way for the arm')
    if (!plan) return
    page.plan = plan
    const verdict = find('verdict')
    verdict.hidden = false
    verdict.dataset.mood = plan.feasible ? 'good' : 'bad'
    verdict.textContent = plan.feasible
      ? `The arm can do it: ${plan.duration.toFixed(1)} s, never nearer than ${Math.max(plan.least_mm, 0).toFixed(0)} mm to anything.`
      : `The arm cannot do it: ${plan.sentence}.`
    page.say(plan.feasible ? 'Press play: the arm shows it, in space and on the pictures.' : 'Where it goes wrong is red.')
    page.setTime(page.clock.time)
    page.refreshCommands()
    page.paint()
  }

  async perform() {
    const {page} = this
    if (!page.plan) await this.check()
    if (!page.plan) return
    if (!page.plan.feasible) return page.say('What cannot be done is not performed: change the motion first.')
    const done = await this.do('perform', 'The arm performs it in simulation')
    if (!done) return
    page.performed = true
    page.refreshCommands()
    find('video').src = `${skillPath(page.name)}/video?${Date.now()}`
    find('video-words').textContent = sentence(done.sentence)
    find('film').showModal()
    find('video').play().catch(() => {})
  }

  async done() {
    const {page} = this
    await page.saver.running
    try {
      await ask(`${skillPath(page.name)}/done`, {method: 'POST', body: {tab}})
      page.skills.closeLive()
      find('farewell').showModal()
    } catch (error) { page.say(sentence(unknown(error))) }
  }

  space() { this.page.space?.paint() }
}

const about = ({from, to}) => to - from < 0.05 ? `around ${Math.round(50 * (from + to))} %` : `${Math.round(100 * from)} % to ${Math.round(100 * to)} %`
const sentence = text => text.charAt(0).toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? '' : '.')
