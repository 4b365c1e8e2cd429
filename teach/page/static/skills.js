// Which skill the page shows: opening, making and removing skills, and what happens where two pages change one.

import {ask, listen, readSkill, skillPath} from './server.js'
import {confirm, prompt} from './dialogs.js'

const find = id => document.getElementById(id)
const NAME = /^[\p{L}\p{N}_][\p{L}\p{N}_ .()-]*(?<!\.)$/u // as teach/page/store.py

export class Skills {
  constructor(page) {
    this.page = page
    find('skills').addEventListener('change', event => this.open(event.target.value))
    find('take-theirs').addEventListener('click', () => this.takeTheirs('Shown is what the other page saved.'))
    find('keep-mine').addEventListener('click', () => this.keepMine())
  }

  async open(name) {
    this.closeLive?.()
    this.page.cancel()
    this.name = name
    this.page.selected = null
    this.page.say('')
    this.page.work.forget()
    const there = await readSkill(name)
    const unsaved = JSON.parse(localStorage.getItem(`unsaved:${name}`) ?? 'null')
    this.page.saver.open(name, there?.revision)
    this.page.document.load(there ? JSON.parse(there.text) : {sketches: []})
    if (unsaved && unsaved.text !== there?.text) this.recover(unsaved, there)
    history.replaceState(null, '', `?skill=${encodeURIComponent(name)}`)
    this.closeLive = listen(name, message => this.heard(message), () => this.page.saver.save())
    await this.list()
    await this.page.pictures.show()
    this.page.work.changed()
  }

  /** Strokes that the server never got: taken up where nobody changed the skill since, else as a copy. */
  recover(unsaved, there) {
    this.page.document.load(JSON.parse(unsaved.text))
    if (unsaved.revision === (there?.revision ?? null)) { this.page.say('Strokes that were not saved yet are back.'); this.page.saver.save() }
    else this.page.saver.be('conflict')
  }

  async list() {
    const {skills} = await ask('/api/skills'), names = skills.map(s => s.name)
    if (!names.includes(this.name)) names.unshift(this.name)
    find('skills').replaceChildren(...names.map(name => new Option(name, name, false, name === this.name)))
    document.title = `${this.name} · ${this.page.scene.title}`
    return names
  }

  async create(suggested = 'motion') {
    const names = await this.list()
    let free = suggested
    for (let i = 2; names.includes(free); i++) free = `${suggested} ${i}`
    const name = await prompt('New skill', 'Its name', free)
    if (name && names.includes(name)) return this.page.say(`There is a skill called ${name} already.`)
    if (!name) return
    if (!NAME.test(name)) return this.page.say(`${name} cannot be a skill's name: use letters, digits, spaces and . - _ ( ), a letter or digit first.`)
    await this.open(name)
    this.page.setTool('draw')
  }

  async remove() {
    if (!await confirm(`Remove the skill ${this.name}?`, 'Its file is put aside in sketches/.removed, from where it can be taken back.', 'Remove')) return
    if (this.page.saver.revision) await ask(skillPath(this.name), {method: 'DELETE', headers: {'if-match': `"${this.page.saver.revision}"`}})
    localStorage.removeItem(`unsaved:${this.name}`)
    const {skills} = await ask('/api/skills')
    await this.open(skills[0]?.name ?? 'motion')
  }

  /** Another page changed the skill that this one shows. */
  async heard(message) {
    if (message.type === 'progress') return this.page.work.progress(message)
    if (message.type !== 'changed' || message.revision === this.page.saver.revision || this.page.saver.state !== 'saved') return
    if (message.tab === sessionStorage.tab) return
    await this.takeTheirs('Another page changed this skill: its strokes are shown.')
  }

  async takeTheirs(words) {
    const there = await readSkill(this.name)
    this.page.saver.open(this.name, there?.revision)
    localStorage.removeItem(`unsaved:${this.name}`)
    this.page.document.load(there ? JSON.parse(there.text) : {sketches: []})
    this.page.say(words)
    await this.page.pictures.show()
    this.page.work.changed()
  }

  async keepMine() {
    const text = this.page.document.text(), names = await this.list()
    let copy = `${this.name} (mine)`
    for (let i = 2; names.includes(copy); i++) copy = `${this.name} (mine ${i})`
    localStorage.removeItem(`unsaved:${this.name}`)
    this.page.saver.open(copy, undefined)
    this.page.saver.save()
    await this.page.saver.running
    await this.open(copy)
    if (this.page.document.text() === text) this.page.say(`Your strokes are kept as ${copy}.`)
  }
}
