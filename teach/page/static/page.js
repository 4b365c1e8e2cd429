// The sketching page. Start reading here: what all views share, and what happens after each change.
//
//   document.js  strokes, undo, files        view.js      a picture               scene3d.js    the motion in space
//   skills.js    which skill is shown        pointers.js  mouse, pen, fingers     raster.js     surfaces
//   server.js    saving, never over others   pen.js       strokes being drawn     arm.js        the arm
//   work.js      fit, check, perform         choice.js    choosing strokes        turntable.js  turning
//   clock.js     the moment, playing         ink.js       painting strokes        orbit.js      other viewpoints
//   commands.js  every command, its key      overlay.js   painting the motion     geometry.js   the maths
//   pictures.js  which views are shown       help.js      epipolar help           hand.js       how the hand is held
//   redraw.js    a part drawn anew        timeline.js  along the slider      demonstrations.js, dialogs.js

import {Document} from './document.js'
import {View} from './view.js'
import {Saver, ask} from './server.js'
import {Skills} from './skills.js'
import {Work} from './work.js'
import {bindCommands} from './commands.js'
import {Clock} from './clock.js'
import {Demonstrations} from './demonstrations.js'
import {Hand} from './hand.js'
import {Orbit} from './orbit.js'
import {Pictures} from './pictures.js'
import {Redraw} from './redraw.js'
import {Scene3D} from './scene3d.js'
import {Timeline} from './timeline.js'
import {MARKS, timeColour} from './ink.js'
import {tipAt} from './overlay.js'
import {at} from './geometry.js'

const find = id => document.getElementById(id)

class Page {
  constructor(scene) {
    this.scene = scene
    this.document = new Document()
    this.saver = new Saver(() => this.document.text(), (state, why) => this.showSaving(state, why))
    this.tool = 'draw'
    this.shows = {strokes: true, motion: true, help: true, arm: true}
    this.motion = this.plan = this.selected = null
    this.demonstrations = new Demonstrations(this)
    this.pictures = new Pictures(this)
    this.redraw = new Redraw(this)
    this.timeline = new Timeline(this)
    this.clock = new Clock(() => this.duration, () => this.paintMoment())
    this.views = [new View(this, 0), new View(this, 1)]
    this.focused = this.views[0]
    this.work = new Work(this)
    this.orbit = new Orbit(this)
    this.space = new Scene3D(this, find('space'))
    this.skills = new Skills(this)
    this.hand = new Hand(this)
    this.document.onChange(why => this.changed(why))
    bindCommands(this)
    this.views.forEach(view => this.place(view))
    addEventListener('beforeunload', event => { if (this.saver.state !== 'saved') event.preventDefault() })
  }

  place(view) {
    const on = (name, act) => view.element.querySelector(`[data-do=${name}]`).addEventListener('click', act)
    find('views').append(view.element)
    on('choose', () => this.pictures.choose(view)); on('closer', () => view.zoomBy(1.5)); on('farther', () => view.zoomBy(1 / 1.5)); on('enlarge', () => this.pictures.enlarge(view))
  }

  get name() { return this.skills.name }

  focus(view) {
    this.focused = view
    this.views.forEach(v => v.element.classList.toggle('focused', v === view))
  }

  // Drawing

  startDrawing(view) { this.focus(view); this.work.pause() }

  addStroke(view, stroke) {
    this.document.addView(view.name, view.view.camera)
    if (stroke.kind === 'arrow') return this.hand.drawn(view, stroke)
    const part = this.redraw.mends(view, stroke)
    this.redraw.end()
    if (part) {
      this.document.replace(view.name, part.stroke, part.mended, 'drew a part again')
      return this.say(`That part of demonstration ${(part.stroke.demonstration ?? 0) + 1} is drawn anew on ${view.name}.`)
    }
    const {chosen} = this.demonstrations, old = chosen !== null && stroke.kind === 'motion' && this.document.motions(view.name).find(s => s.demonstration === chosen)
    if (old) this.document.replace(view.name, old, stroke, 'drew a stroke again')
    else this.document.add(view.name, stroke)
    this.demonstrations.chosen = null
    const kind = stroke.kind === 'keep_out' ? 'Keep-out region' : 'Demonstration'
    this.say(`${kind} ${stroke.demonstration + 1} is on ${view.name} (${stroke.points.length} samples).`)
    this.demonstrations.show()
  }

  /** After every change of the document. */
  changed(why) {
    if (this.selected && !this.document.strokes(this.selected.view).includes(this.selected.stroke)) this.select(null)
    if (why !== 'loaded') { this.saver.save(); this.work.changed() }
    if (/^(Undone|Done again)/.test(why)) this.say(`${why}.`)
    if (why === 'erased a stroke') this.say('Erased a stroke: Ctrl+Z brings it back.')
    this.demonstrations.show()
    this.hand.show()
    this.work.tellApart()
    this.refreshCommands?.()
    this.paint()
  }

  paint() {
    document.body.dataset.motion = !this.motion ? 'none' : this.stale ? 'old' : 'shown'
    this.views.forEach(view => view.paint())
  }

  select(selected) {
    this.selected = selected
    this.refreshCommands?.()
    this.paint()
  }

  setTool(tool) {
    this.cancel()
    this.tool = tool
    if (tool !== 'draw') this.redraw.end()
    find('views').dataset.tool = tool
    this.refreshCommands?.()
  }

  cancel() { return this.views?.map(view => view.cancel()).some(Boolean) }

  mark(name) {
    const drawing = this.views.find(view => view.pen.line)?.pen.line
    if (drawing) { drawing.events.push({name, time: drawing.times.at(-1)}); return this.say(`${MARKS[name].label} here.`) }
    const {selected} = this, choice = this.views.find(v => v.name === selected?.view)?.choice
    if (!selected || (selected.stroke.kind ?? 'motion') !== 'motion') return this.say('Choose a place on a stroke first: the Mark tool (M), then click on it.')
    const {times} = selected.stroke
    const time = choice?.marking?.stroke === selected.stroke ? choice.marking.time : times[0] + this.clock.time * (times.at(-1) - times[0])
    const stroke = this.document.mark(selected.view, selected.stroke, name, Math.round(time * 1e6) / 1e6)
    this.select({view: selected.view, stroke})
    if (choice?.marking) choice.marking = {stroke, time}
    this.say(`${MARKS[name].label} ${stroke.events.length > (selected.stroke.events?.length ?? 0) ? 'marked' : 'taken away'}.`)
  }

  offerMarks(view) {
    const menu = find('marks'), {zoom, choice: {marking}} = view, p = at(marking.stroke.points, marking.stroke.times, marking.time)
    const {left, top} = view.frame.getBoundingClientRect()
    menu.showPopover()
    menu.style.left = `${Math.min(left + zoom.x + zoom.scale * p[0] + 12, innerWidth - menu.offsetWidth - 8)}px`
    menu.style.top = `${Math.min(top + zoom.y + zoom.scale * p[1] + 12, innerHeight - menu.offsetHeight - 8)}px`
  }

  duplicate() {
    const {selected} = this
    if (!selected) return this.say('Choose a stroke first (V).')
    if (selected.stroke.kind === 'arrow') return this.say('The hand has one arrow: draw it again to change it.')
    const same = this.document.of(selected.view, selected.stroke.kind ?? 'motion')
    const demonstration = Math.max(...same.map(s => s.demonstration ?? 0)) + 1
    const copy = {...selected.stroke, demonstration}
    this.document.add(selected.view, copy)
    this.select({view: selected.view, stroke: copy})
    this.say(`A copy is demonstration ${demonstration + 1}.`)
  }

  eraseSelected() {
    if (!this.selected) return this.say('Choose a stroke first (V), or use the eraser (E).')
    this.document.remove(this.selected.view, this.selected.stroke)
  }

  // Time

  /** Of the motion, or of the checked one [s]; null while there is none. */
  get duration() { return this.plan?.duration ?? this.motion?.duration ?? null }

  setTime(t) { this.clock.set(t) }

  /** Where the motion is now [m]. */
  moment() { return this.where(this.clock.time) }
  where(t) { return this.plan ? tipAt(this.plan, t) : at(this.motion.ways[0].mean, this.motion.times, t) }

  /** What happens along the motion, or the checked one, and where: {name, point} each. */
  happenings() {
    return this.timeline.events.map(({name, at: t}) => ({name, point: this.where(t)}))
  }

  paintMoment() {
    this.timeline.show()
    this.views.forEach(view => view.view && view.paintMoment())
    this.space.paint()
  }

  play() { this.clock.play(() => this.refreshCommands()) }

  // What the page says

  say(words) { find('says').textContent = words }

  showSaving(state, why) {
    const words = {saved: 'Saved', saving: 'Saving', offline: 'Server away, will save', conflict: 'Changed elsewhere', refused: 'Not saved'}
    find('saving').textContent = words[state]
    find('saving').dataset.state = state
    if (state === 'refused') this.say(why.message)
    find('conflict').hidden = state !== 'conflict'
  }

  /** Names of the views on which the motion is drawn. */
  get drawn() { return this.document.sketches.filter(s => this.document.motions(s.view).length).map(s => s.view) }

  /** The command that a person is led to next. */
  get next() {
    const {can} = this.scene
    if (!this.motion || this.stale) return null
    if (can.plan && !this.plan) return 'Check'
    if (this.plan?.feasible && can.perform && !this.performed) return 'Perform'
    return this.plan && !this.plan.feasible ? null : 'Done'
  }

  /** What to do on a picture, while it is not plain: shown on it. */
  hint(view) {
    const {drawn} = this
    if (this.tool !== 'draw' && this.tool !== 'waypoints' || drawn.length > 1 || drawn.includes(view.name) || view.pen.line) return ''
    if (drawn.length) return 'Now the same motion here'
    return view.number ? 'Then once more here' : this.tool === 'draw' ? 'Draw the motion here, from beginning to end' : 'Click the motion, point by point'
  }

  /** What to do next, in a sentence. */
  advice() {
    const {drawn} = this
    if (!drawn.length) return 'Draw the motion on one picture, from its beginning to its end.'
    if (drawn.length === 1) return 'Now draw the same motion on a second picture: the bright band shows where it can be.'
    return null
  }
}

function paintRamp() {
  const stops = Array.from({length: 9}, (_, i) => timeColour(i / 8)).join(', ')
  document.documentElement.style.setProperty('--ramp', `linear-gradient(90deg, ${stops})`)
}

async function start() {
  paintRamp()
  const page = new Page(await ask('/api/scene'))
  globalThis.page = page // for the console, and for tests
  find('scene').textContent = page.scene.title
  const {skills} = await ask('/api/skills')
  await page.skills.open(new URLSearchParams(location.search).get('skill') || skills[0]?.name || 'motion')
  document.body.dataset.ready = 'yes'
  page.space.load().catch(error => page.say(`The view in space lacks a part: ${error.message}`))
}

start().catch(error => { find('says').textContent = `The page did not start: ${error.message}` })
