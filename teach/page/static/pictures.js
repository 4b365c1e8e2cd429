// Which pictures are shown to draw on: the scene's, and viewpoints of one's own.

import {choosePicture, renderFrom} from './orbit.js'

const find = id => document.getElementById(id)

export class Pictures {
  constructor(page) { Object.assign(this, {page, loaded: new Map()}) }

  /** All views that there are: the scene's, and those that this skill was drawn on with another camera. */
  get all() {
    const {scene, document: doc} = this.page, same = (v, s) => v.name === s.view && JSON.stringify(v.camera) === JSON.stringify(s.camera)
    const own = doc.sketches.filter(s => !scene.views.some(v => same(v, s))).map(s => ({name: s.view, camera: s.camera, kind: 'free'}))
    return [...scene.views.filter(v => !own.some(o => o.name === v.name)), ...own]
  }

  named(name) { return this.all.find(v => v.name === name) }

  /** Those that are drawn on first. */
  async show() {
    const {page, all} = this, drawn = page.document.sketches.map(s => all.find(v => v.name === s.view))
    const order = [...drawn, ...all].filter((v, i, list) => v && list.indexOf(v) === i)
    await Promise.all(page.views.map((view, i) => order[i] && view.show(order[i])))
    page.focus(page.focused)
  }

  /** The picture of a view; kept, since views are few. */
  of(view) {
    const key = JSON.stringify([view.name, view.camera])
    if (!this.loaded.has(key)) {
      const picture = this.load(view)
      picture.catch(() => this.loaded.delete(key))
      this.loaded.set(key, picture)
    }
    return this.loaded.get(key)
  }

  async load(view) {
    const image = new Image()
    image.src = view.kind === 'free' ? URL.createObjectURL(await renderFrom(view.camera, {keep: 1})) : `/pictures/${encodeURIComponent(view.name)}`
    try { await image.decode() } catch { throw new Error(`the picture of ${view.name} cannot be shown`) }
    return image
  }

  async choose(view) {
    const {page} = this, chosen = await choosePicture(page, view)
    if (chosen === 'orbit') return page.orbit.open(view)
    if (!chosen || chosen.name === view.name) return
    const other = page.views.find(v => v.name === chosen.name)
    if (other) await other.show(view.view) // they change places
    await view.show(chosen)
    page.space.paint()
  }

  /** A viewpoint of one's own becomes a view of this skill. seen: its picture, where it is shown already. */
  async use(view, camera, seen) {
    const {page} = this
    let n = 1
    while (this.named(`viewpoint ${n}`)) n++
    const own = {name: `viewpoint ${n}`, camera, kind: 'free'}
    page.document.addView(own.name, camera)
    if (seen) this.loaded.set(JSON.stringify([own.name, camera]), copied(seen))
    page.saver.save()
    await view.show(own)
    page.say(`Draw the motion on ${own.name}.`)
    page.space.paint()
  }

  /** One picture as large as there is room, or all again. */
  enlarge(view) {
    const large = find('views').classList.toggle('one')
    this.page.views.forEach(v => v.element.classList.toggle('hidden', large && v !== view))
    view.element.querySelector('[data-do=enlarge]').setAttribute('aria-pressed', large)
  }
}

async function copied(image) {
  const copy = new Image()
  copy.src = image.src
  await copy.decode()
  return copy
}
