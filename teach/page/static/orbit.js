// Other pictures: choosing one of the scene's, or looking around with the field, coarse while moving and sharp when still.

import {ask, tab, Answer} from './server.js'
import {resized} from './geometry.js'
import {Turntable} from './turntable.js'

const find = id => document.getElementById(id)
const STILL = 180 // ms without a move after which the sharp picture is asked for
const COARSE = 160, SHARP = 640 // px of a picture's width

/** The field's picture from a camera, as a blob. */
export const renderFrom = (camera, more = {}, signal) => ask('/api/render', {method: 'POST', body: {camera, tab, ...more}, signal})

/** A person chooses a view in a dialog: the view, "orbit", or null. */
export function choosePicture(page, view) {
  const dialog = find('pictures'), list = find('picture-list')
  const drawn = name => page.document.strokes(name).length
  list.replaceChildren(...page.pictures.all.map(v => {
    const button = Object.assign(document.createElement('button'), {type: 'button', className: 'choice'})
    if (v.kind !== 'free') button.append(Object.assign(new Image(), {src: `/pictures/${encodeURIComponent(v.name)}?small`, alt: '', loading: 'lazy'}))
    button.append(Object.assign(document.createElement('span'), {textContent: v.name}))
    if (drawn(v.name)) button.append(Object.assign(document.createElement('small'), {textContent: `${drawn(v.name)} drawn`}))
    button.setAttribute('aria-pressed', v.name === view.name)
    button.addEventListener('click', () => { dialog.chosen = v; dialog.close() })
    return button
  }))
  find('to-orbit').hidden = !page.scene.can.render
  find('to-orbit').onclick = () => { dialog.chosen = 'orbit'; dialog.close() }
  dialog.chosen = null
  dialog.showModal()
  return new Promise(done => dialog.addEventListener('close', () => done(dialog.chosen), {once: true}))
}

export class Orbit {
  constructor(page) {
    this.page = page
    this.image = find('orbit-picture')
    const stage = this.stage = find('orbit-stage')
    this.table = new Turntable(stage, () => this.look(this.table.camera(this.like)), {lowest: -0.2})
    find('orbit-use').addEventListener('click', () => { find('orbit').close(); page.pictures.use(this.view, this.camera, this.shown === this.camera ? this.image : null) })
    find('orbit-suggest').addEventListener('click', () => this.suggest())
    find('orbit').addEventListener('close', () => { clearTimeout(this.timer); this.asking?.abort() })
    find('orbit-suggest').hidden = !page.scene.can.suggest
  }

  open(view) {
    this.view = view
    const like = view.view.camera, {target} = this.page.scene
    const width = SHARP, height = Math.round(SHARP * like.height / like.width)
    this.like = resized(like, width, height)
    this.table.stand(this.like, target)
    find('orbit-words').textContent = 'Drag, or use the arrow keys, to look around; the wheel, + and - go nearer and farther.'
    find('orbit').showModal()
    this.stage.focus()
    this.look(this.table.camera(this.like))
  }

  /** Show a viewpoint: coarsely at once, sharply when it stays. */
  look(camera) {
    this.camera = camera
    this.moved = true
    this.moving ??= this.coarse().finally(() => { this.moving = null })
    clearTimeout(this.timer)
    this.timer = setTimeout(async () => {
      await this.moving // a coarse picture that comes late is seen all the same
      if (this.camera === camera && this.stage.closest('[open]')) this.render(camera)
    }, STILL)
  }

  /** The coarse picture of where the camera is; one at a time, the newest. */
  async coarse() {
    while (this.moved) {
      this.moved = false
      await this.render(resized(this.camera, COARSE, Math.round(COARSE * this.camera.height / this.camera.width)))
    }
  }

  /** Show what the field shows from there, instead of what was asked for before. */
  async render(camera) {
    this.asking?.abort()
    const asking = this.asking = new AbortController(), began = performance.now()
    try {
      const url = URL.createObjectURL(await renderFrom(camera, {}, asking.signal)), old = this.image.src
      this.image.src = url
      await this.image.decode().catch(() => {})
      if (old.startsWith('blob:')) URL.revokeObjectURL(old)
      this.shown = camera
      this.image.dataset.width = camera.width
      this.image.dataset.ms = Math.round(performance.now() - began)
    } catch (error) {
      if (error instanceof Answer && error.status !== 409) find('orbit-words').textContent = error.message
    } finally { if (this.asking === asking) this.asking = null }
  }

  /** A viewpoint for the next sketch, to take the place of a picture that is not drawn on. */
  suggestNext() {
    const {page} = this
    this.open(page.views.find(v => !page.drawn.includes(v.name)) ?? page.focused)
    return this.suggest()
  }

  async suggest() {
    const free = this.page.views.find(v => !this.page.drawn.includes(v.name))
    if (free) this.view = free
    find('orbit-words').textContent = 'Looking for the best viewpoint.'
    try {
      const {camera, sentence} = await ask('/api/suggest', {method: 'POST', body: {skill: this.page.name, tab}})
      find('orbit-words').textContent = `From here your strokes say most about what is still open. ${sentence}`
      this.like = resized(camera, this.like.width, this.like.height)
      this.table.stand(this.like, this.page.scene.target)
      this.look(this.like)
    } catch (error) { find('orbit-words').textContent = error.message }
  }
}
