// The sketching page. Start reading here: what all views share, and what happens after each change.
//
//   document.js  strokes, undo, files       view.js   a picture, pointers -> strokes    help.js     epipolar help
//   server.js    saving, never over others  ink.js    painting                          geometry.js the maths
//   work.js      fit, check, perform        commands.js every command, its key and button
//   orbit.js     other viewpoints           scene3d.js  the motion in space

import {Document} from './document.js'
import {View} from './view.js'
import {Saver, ask, listen, readSkill, skillPath} from './server.js'
import {Work} from './work.js'
import {bindCommands} from './commands.js'
import {Orbit, choosePicture, renderFrom} from './orbit.js'
import {Scene3D} from './scene3d.js'
import {MARKS, inkOf, timeColour} from './ink.js'
import {at} from './geometry.js'

const find = id => document.getElementById(id)
const make = (tag, properties = {}, ...children) => { const e = Object.assign(document.createElement(tag), properties); e.append(...children); return e }

class Page {
  constructor(scene) {
    this.scene = scene
    this.document = new Document()
    this.saver = new Saver(() => this.document.text(), (state, why) => this.showSaving(state, why))
    this.tool = 'draw'
    this.shows = {strokes: true, motion: true, help: true}
    this.motion = this.plan = this.selected = this.demonstration = null
    this.time = 0
    this.pictures = new Map()
    this.views = [new View(this, 0), new View(this, 1)]
    this.views.forEach(view => find('views').append(view.element))
    this.focused = this.views[0]
    this.work = new Work(this)
    this.orbit = new Orbit(this)
    this.space = new Scene3D(this, find('space'))
    this.document.onChange(why => this.changed(why))
    bindCommands(this)
    for (const view of this.views) {
      const on = (name, act) => view.element.querySelector(`[data-do=${name}]`).addEventListener('click', act)
      on('choose', () => this.choose(view)); on('closer', () => view.zoomBy(1.5)); on('farther', () => view.zoomBy(1 / 1.5)); on('enlarge', () => this.enlarge(view))
    }
    find('time').addEventListener('input', event => this.setTime(event.target.value / 1000))
    find('skills').addEventListener('change', event => this.open(event.target.value))
    addEventListener('beforeunload', event => { if (this.saver.state !== 'saved') event.preventDefault() })
  }

  // Skills

  async open(name) {
    this.closeLive?.()
    this.cancel()
    this.name = name
    this.selected = null
    this.work.forget()
    const there = await readSkill(name)
    const unsaved = JSON.parse(localStorage.getItem(`unsaved:${name}`) ?? 'null')
    this.saver.open(name, there?.revision)
    this.document.load(there ? JSON.parse(there.text) : {sketches: []})
    if (unsaved && unsaved.text !== there?.text) this.recover(unsaved, there)
    history.replaceState(null, '', `?skill=${encodeURIComponent(name)}`)
    this.closeLive = listen(name, message => this.heard(message), () => this.saver.save())
    await this.listSkills()
    await this.showPictures()
    this.work.changed()
  }

  /** Strokes that the server never got: taken up where nobody changed the skill since, else as a copy. */
  recover(unsaved, there) {
    this.document.load(JSON.parse(unsaved.text))
    if (unsaved.revision === (there?.revision ?? null)) { this.say('Strokes that were not saved yet are back.'); this.saver.save() }
    else this.saver.be('conflict')
  }

  async listSkills() {
    const {skills} = await ask('/api/skills'), names = skills.map(s => s.name)
    if (!names.includes(this.name)) names.unshift(this.name)
    find('skills').replaceChildren(...names.map(name => make('option', {value: name, textContent: name, selected: name === this.name})))
    document.title = `${this.name} · ${this.scene.title}`
    return names
  }

  async newSkill(suggested = 'motion') {
    const names = await this.listSkills()
    let free = suggested
    for (let i = 2; names.includes(free); i++) free = `${suggested} ${i}`
    const name = await this.prompt('New skill', 'Its name', free)
    if (name && names.includes(name)) return this.say(`There is a skill called ${name} already.`)
    if (name) await this.open(name)
  }

  async removeSkill() {
    if (!await this.confirm(`Remove the skill ${this.name}?`, 'Its file is put aside in sketches/.removed, from where it can be taken back.', 'Remove')) return
    if (this.saver.revision) await ask(skillPath(this.name), {method: 'DELETE', headers: {'if-match': `"${this.saver.revision}"`}})
    localStorage.removeItem(`unsaved:${this.name}`)
    const {skills} = await ask('/api/skills')
    await this.open(skills[0]?.name ?? 'motion')
  }

  /** Another page changed the skill that this one shows. */
  async heard(message) {
    if (message.type === 'progress') return this.work.progress(message)
    if (message.type !== 'changed' || message.revision === this.saver.revision || this.saver.state !== 'saved') return
    if (message.tab === sessionStorage.tab) return
    await this.takeTheirs('Another page changed this skill: its strokes are shown.')
  }

  async takeTheirs(words) {
    const there = await readSkill(this.name)
    this.saver.open(this.name, there?.revision)
    localStorage.removeItem(`unsaved:${this.name}`)
    this.document.load(there ? JSON.parse(there.text) : {sketches: []})
    this.say(words)
    await this.showPictures()
    this.work.changed()
  }

  async keepMine() {
    const text = this.document.text(), names = await this.listSkills()
    let copy = `${this.name} (mine)`
    for (let i = 2; names.includes(copy); i++) copy = `${this.name} (mine ${i})`
    localStorage.removeItem(`unsaved:${this.name}`)
    this.saver.open(copy, undefined)
    this.saver.save()
    await this.saver.running
    await this.open(copy)
    if (this.document.text() === text) this.say(`Your strokes are kept as ${copy}.`)
  }

  // Pictures

  /** All views that there are: the scene's, and those that this skill was drawn on with another camera. */
  get allViews() {
    const same = (v, s) => v.name === s.view && JSON.stringify(v.camera) === JSON.stringify(s.camera)
    const own = this.document.sketches.filter(s => !this.scene.views.some(v => same(v, s))).map(s => ({name: s.view, camera: s.camera, kind: 'free'}))
    return [...this.scene.views.filter(v => !own.some(o => o.name === v.name)), ...own]
  }

  async showPictures() {
    const drawn = this.document.sketches.map(s => s.view), all = this.allViews
    const order = [...drawn.map(name => all.find(v => v.name === name)), ...all].filter((v, i, list) => v && list.indexOf(v) === i)
    await Promise.all(this.views.map((view, i) => order[i] && view.show(order[i])))
    this.focus(this.focused)
  }

  /** The picture of a view; kept, since views are few. */
  picture(view) {
    const key = JSON.stringify([view.name, view.camera])
    if (!this.pictures.has(key)) {
      const url = view.kind === 'free' ? renderFrom(view.camera, {keep: 1}).then(blob => URL.createObjectURL(blob)) : Promise.resolve(`/pictures/${encodeURIComponent(view.name)}`)
      const loaded = url.then(src => { const image = new Image(); image.src = src; return image.decode().then(() => image, () => { throw new Error(`the picture of ${view.name} cannot be shown`) }) })
      loaded.catch(() => this.pictures.delete(key))
      this.pictures.set(key, loaded)
    }
    return this.pictures.get(key)
  }

  async choose(view) {
    const chosen = await choosePicture(this, view)
    if (chosen === 'orbit') return this.orbit.open(view)
    if (!chosen || chosen.name === view.name) return
    const other = this.views.find(v => v.name === chosen.name)
    if (other) await other.show(view.view) // they change places
    await view.show(chosen)
    this.work.space()
  }

  /** A viewpoint of one's own becomes a view of this skill. */
  async useViewpoint(view, camera) {
    let n = 1
    while (this.allViews.some(v => v.name === `viewpoint ${n}`)) n++
    const own = {name: `viewpoint ${n}`, camera, kind: 'free'}
    this.document.addView(own.name, camera)
    this.saver.save()
    await view.show(own)
    this.say(`Draw the motion on ${own.name}.`)
  }

  enlarge(view = this.focused) {
    const large = find('views').classList.toggle('one')
    this.views.forEach(v => v.element.classList.toggle('hidden', large && v !== view))
    view.element.querySelector('[data-do=enlarge]').setAttribute('aria-pressed', large)
  }

  focus(view) {
    this.focused = view
    this.views.forEach(v => v.element.classList.toggle('focused', v === view))
  }

  // Drawing

  nextDemonstration(view) {
    if (this.demonstration !== null) return this.demonstration
    const there = new Set(this.document.motions(view).map(s => s.demonstration ?? 0))
    let n = 0
    while (there.has(n)) n++
    return n
  }

  nextRegion(view) {
    const there = new Set(this.document.strokes(view).filter(s => s.kind === 'keep_out').map(s => s.demonstration ?? 0))
    let n = 0
    while (there.has(n)) n++
    return n
  }

  startDrawing(view) { this.focus(view); this.work.pause() }

  addStroke(view, stroke) {
    this.document.addView(view.name, view.view.camera)
    const old = this.demonstration !== null && stroke.kind === 'motion' && this.document.motions(view.name).find(s => s.demonstration === this.demonstration)
    if (old) this.document.replace(view.name, old, stroke, 'drew a stroke again')
    else this.document.add(view.name, stroke)
    this.demonstration = null
    const kind = stroke.kind === 'keep_out' ? 'Keep-out region' : 'Demonstration'
    this.say(`${kind} ${stroke.demonstration + 1} on ${view.name}: ${stroke.points.length} samples.`)
    this.showDemonstrations()
  }

  /** After every change of the document. */
  changed(why) {
    if (this.selected && !this.document.strokes(this.selected.view).includes(this.selected.stroke)) this.select(null)
    if (why !== 'loaded') { this.saver.save(); this.work.changed() }
    if (/^(Undone|Done again)/.test(why)) this.say(`${why}.`)
    this.showDemonstrations()
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
    find('views').dataset.tool = tool
    this.refreshCommands?.()
  }

  cancel() { return this.views?.map(view => view.cancel()).some(Boolean) }

  mark(name) {
    const drawing = this.views.find(view => view.line)
    if (drawing) { drawing.line.events.push({name, time: drawing.line.times.at(-1)}); return this.say(`${MARKS[name].label} here.`) }
    const {selected} = this, view = this.views.find(v => v.name === selected?.view)
    if (!selected || selected.stroke.kind === 'keep_out') return this.say('Choose a place on a stroke first: the Mark tool (M), then click on it.')
    const {times} = selected.stroke
    const time = view?.marking?.stroke === selected.stroke ? view.marking.time : times[0] + this.time * (times.at(-1) - times[0])
    const stroke = this.document.mark(selected.view, selected.stroke, name, Math.round(time * 1e6) / 1e6)
    this.select({view: selected.view, stroke})
    if (view?.marking) view.marking = {stroke, time}
    this.say(`${MARKS[name].label} ${stroke.events.length ? 'marked' : 'taken away'}.`)
  }

  offerMarks(view) {
    const menu = find('marks'), {zoom, marking} = view, p = at(marking.stroke.points, marking.stroke.times, marking.time)
    const {left, top} = view.frame.getBoundingClientRect()
    menu.showPopover()
    menu.style.left = `${Math.min(left + zoom.x + zoom.scale * p[0] + 12, innerWidth - menu.offsetWidth - 8)}px`
    menu.style.top = `${Math.min(top + zoom.y + zoom.scale * p[1] + 12, innerHeight - menu.offsetHeight - 8)}px`
  }

  duplicate() {
    const {selected} = this
    if (!selected) return this.say('Choose a stroke first (V).')
    const same = this.document.strokes(selected.view).filter(s => (s.kind ?? 'motion') === (selected.stroke.kind ?? 'motion'))
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

  chooseDemonstration(step) {
    const most = Math.max(0, ...this.document.all.map(x => (x.stroke.demonstration ?? 0) + 1))
    const now = this.demonstration ?? (step > 0 ? -1 : most)
    const next = now + step
    this.demonstration = next < 0 || next >= most ? null : next
    this.say(this.demonstration === null ? 'The next stroke is a new demonstration.' : `The next stroke draws demonstration ${next + 1} again.`)
    this.showDemonstrations()
  }

  // What the page says

  say(words) { find('says').textContent = words }

  showSaving(state, why) {
    const words = {saved: 'Saved', saving: 'Saving', offline: 'Server away, will save', conflict: 'Changed elsewhere', refused: 'Not saved'}
    find('saving').textContent = words[state]
    find('saving').dataset.state = state
    if (state === 'refused') this.say(why.message)
    find('conflict').hidden = state !== 'conflict'
  }

  showDemonstrations() {
    const views = this.document.sketches.filter(s => s.strokes.length)
    const numbers = [...new Set(this.document.all.filter(x => (x.stroke.kind ?? 'motion') === 'motion').map(x => x.stroke.demonstration ?? 0))].sort((a, b) => a - b)
    const chips = numbers.map(n => {
      const on = views.filter(s => s.strokes.some(x => (x.kind ?? 'motion') === 'motion' && (x.demonstration ?? 0) === n)).map(s => s.view)
      const swatch = make('span', {className: 'swatch'}), words = make('span', {textContent: `${n + 1}`})
      swatch.style.background = inkOf(n)
      const chip = make('button', {className: 'chip', type: 'button', title: `Draw demonstration ${n + 1} again. It is on ${on.join(', ')}.`}, swatch, words, make('small', {textContent: `${on.length} ${on.length === 1 ? 'view' : 'views'}`}))
      chip.setAttribute('aria-pressed', this.demonstration === n)
      chip.addEventListener('click', () => { this.demonstration = this.demonstration === n ? null : n; this.say(this.demonstration === n ? `The next stroke draws demonstration ${n + 1} again.` : 'The next stroke is a new demonstration.'); this.showDemonstrations() })
      return chip
    })
    const regions = this.document.all.filter(x => x.stroke.kind === 'keep_out').length
    if (regions) chips.push(make('span', {className: 'chip still', textContent: `${regions} keep-out ${regions === 1 ? 'outline' : 'outlines'}`}))
    find('demonstrations').replaceChildren(...chips)
  }

  /** What to do next, in a sentence. */
  advice() {
    const drawn = this.document.sketches.filter(s => s.strokes.some(x => (x.kind ?? 'motion') === 'motion'))
    if (!drawn.length) return 'Draw the motion on one picture, from its beginning to its end.'
    if (drawn.length === 1) return `Now draw the same motion on a second picture. The bright band shows where it can be.`
    return null
  }

  // Time

  setTime(t) {
    this.time = t
    find('time').value = Math.round(1000 * t)
    find('time').setAttribute('aria-valuetext', this.motion ? `${(t * this.motion.duration).toFixed(1)} of ${this.motion.duration.toFixed(1)} seconds` : `${Math.round(100 * t)} %`)
    find('clock').textContent = this.motion ? `${(t * this.motion.duration).toFixed(1)} s` : ''
    this.views.forEach(view => view.view && view.paintHelp())
    this.space.paint()
  }

  play() {
    this.playing = !this.playing
    this.refreshCommands()
    if (!this.playing || !this.motion) { this.playing = false; return this.refreshCommands() }
    if (this.time >= 1) this.time = 0
    let before = performance.now()
    const step = now => {
      if (!this.playing || !this.motion) return
      this.setTime(Math.min(1, this.time + (now - before) / 1000 / this.motion.duration))
      before = now
      if (this.time < 1) return requestAnimationFrame(step)
      this.playing = false
      this.refreshCommands()
    }
    requestAnimationFrame(step)
  }

  // Dialogs

  async prompt(title, label, value) {
    const dialog = find('prompt')
    dialog.querySelector('h2').textContent = title
    dialog.querySelector('label span').textContent = label
    dialog.querySelector('input').value = value
    dialog.showModal()
    dialog.querySelector('input').select()
    return await this.agreed(dialog) ? dialog.querySelector('input').value.trim() : null
  }

  async confirm(title, words, act) {
    const dialog = find('confirm')
    dialog.querySelector('h2').textContent = title
    dialog.querySelector('p').textContent = words
    dialog.querySelector('[value=ok]').textContent = act
    dialog.showModal()
    return this.agreed(dialog)
  }

  agreed(dialog) {
    return new Promise(done => dialog.addEventListener('close', () => done(dialog.returnValue === 'ok'), {once: true}))
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
  find('take-theirs').addEventListener('click', () => page.takeTheirs('Shown is what the other page saved.'))
  find('keep-mine').addEventListener('click', () => page.keepMine())
  await page.open(new URLSearchParams(location.search).get('skill') || skills[0]?.name || 'motion')
  document.body.dataset.ready = 'yes'
}

start().catch(error => { find('says').textContent = `The page did not start: ${error.message}` })
