// One skill as it is drawn: strokes on views, what was done to them, and how they are kept.
//
// The text is that of teach/schema.py. Strokes never change once they are drawn: whoever alters one makes another, so that
// undoing is to go back to the list before, and each stroke's text is made once.

const texts = new WeakMap()
const plain = ({view, camera, orientation, strokes}) => orientation ? {view, camera, orientation, strokes} : {view, camera, strokes}
const DEPTH = 200

export class Document {
  constructor() { this.sketches = []; this.past = []; this.future = []; this.listeners = new Set() }

  /** Replace everything by what a file says; nothing to undo. */
  load(file) {
    this.sketches = file.sketches.map(plain)
    this.past = []; this.future = []
    this.tell('loaded')
  }

  onChange(listener) { this.listeners.add(listener) }
  tell(why) { for (const listener of this.listeners) listener(why) }

  sketch(view) { return this.sketches.find(s => s.view === view) }
  strokes(view) { return this.sketch(view)?.strokes ?? [] }
  motions(view) { return this.of(view, 'motion') }
  of(view, kind) { return this.strokes(view).filter(s => (s.kind ?? 'motion') === kind) }
  get all() { return this.sketches.flatMap(s => s.strokes.map(stroke => ({view: s.view, stroke}))) }

  /** Apply a change (sketches -> sketches) that can be undone. what: in words, for the status. */
  change(what, make) {
    const next = make(this.sketches)
    if (next === this.sketches) return
    this.past.push({what, sketches: this.sketches})
    if (this.past.length > DEPTH) this.past.shift()
    this.future = []
    this.sketches = next
    this.tell(what)
  }

  undo() { return this.travel(this.past, this.future, 'Undone') }
  redo() { return this.travel(this.future, this.past, 'Done again') }
  travel(from, to, word) {
    const step = from.pop()
    if (!step) return null
    to.push({what: step.what, sketches: this.sketches})
    this.sketches = step.sketches
    this.tell(`${word}: ${step.what}`)
    return step.what
  }

  addView(view, camera) {
    if (!this.sketch(view)) this.sketches = [...this.sketches, plain({view, camera, orientation: this.orientation, strokes: []})]
  }
  on(view, what, make) {
    this.change(what, sketches => sketches.map(s => s.view === view ? {...s, strokes: make(s.strokes)} : s))
  }
  add(view, stroke) { this.on(view, 'a stroke', strokes => [...strokes, stroke]) }
  remove(view, stroke) { this.on(view, 'erased a stroke', strokes => strokes.filter(s => s !== stroke)) }
  replace(view, stroke, other, what) { this.on(view, what, strokes => strokes.map(s => s === stroke ? other : s)) }
  /** How the hand is held, by what the skill says; undefined where it is free. */
  get orientation() { return this.sketches.find(s => s.orientation)?.orientation }
  orient(orientation) { this.change('how the hand is held', sketches => sketches.map(s => plain({...s, orientation}))) }
  /** The hand's arrow on a view, which the hand points along from now on. */
  point(view, stroke) {
    this.change("the hand's arrow", sketches => sketches.map(s => {
      const strokes = s.view === view ? [...s.strokes.filter(x => x.kind !== 'arrow'), stroke] : s.strokes
      return {...s, strokes, orientation: {kind: 'along'}}
    }))
  }

  clear() { this.change('cleared everything', sketches => sketches.map(s => ({...s, strokes: []}))) }

  /** Mark something on a stroke at a time of its clock; the same mark there again takes it away. */
  mark(view, stroke, name, time) {
    const near = e => e.name === name && Math.abs(e.time - time) < 0.03 * (stroke.times.at(-1) - stroke.times[0])
    const events = stroke.events ?? [], there = events.some(near)
    const other = {...stroke, events: there ? events.filter(e => !near(e)) : [...events, {name, time}]}
    this.replace(view, stroke, other, there ? 'took a mark away' : 'a mark')
    return other
  }

  /** The file's text. */
  text() {
    const sketches = this.sketches.map(s => {
      const strokes = s.strokes.map(stroke => {
        if (!texts.has(stroke)) texts.set(stroke, JSON.stringify(stroke))
        return texts.get(stroke)
      })
      return `{"view":${JSON.stringify(s.view)},"camera":${JSON.stringify(s.camera)}${s.orientation ? `,"orientation":${JSON.stringify(s.orientation)}` : ''},"strokes":[${strokes.join(',')}]}`
    })
    return `{"schema":"scene2skill.sketches","version":1,"sketches":[${sketches.join(',')}]}`
  }
}

/** The same file, if it holds what the page can show; the server checks the rest. Throws an Error that names what is wrong. */
export function checked(file) {
  const rows = (M, n, count = M?.length) => Array.isArray(M) && M.length === count && count > 0 && M.every(row => Array.isArray(row) && row.length === n && row.every(Number.isFinite))
  const need = (right, at, what) => { if (!right) throw new Error(`${at} is not ${what}`) }
  need(file?.schema === 'scene2skill.sketches' && Array.isArray(file.sketches), 'it', 'a file of sketches ("schema": "scene2skill.sketches")')
  file.sketches.forEach((s, i) => {
    const {K, world_from_camera: M, width, height} = s?.camera ?? {}
    need(typeof s?.view === 'string', `sketches[${i}].view`, 'a name')
    need(rows(K, 3, 3) && rows(M, 4, 4) && width > 0 && height > 0, `sketches[${i}].camera`, 'a camera')
    need(Array.isArray(s.strokes), `sketches[${i}].strokes`, 'a list')
    s.strokes.forEach((stroke, k) => need(rows(stroke?.points, 2) && rows(stroke.times?.map?.(t => [t]), 1, stroke.points.length) && Array.isArray(stroke.events ?? []),
      `sketches[${i}].strokes[${k}]`, 'a stroke with a time for each point'))
  })
  return file
}

/** What was drawn as SVG, one group for each view, in its pixels. colourOf(stroke) -> CSS colour. */
export function toSVG(document, colourOf) {
  const escape = text => text.replace(/[<>&"]/g, c => `&#${c.charCodeAt(0)};`)
  let x = 0
  const groups = document.sketches.filter(s => s.strokes.length).map(s => {
    const paths = s.strokes.map(stroke => {
      const [first, ...rest] = stroke.points, keep = stroke.kind === 'keep_out'
      const d = `M${first.join(',')}L${rest.map(p => p.join(',')).join(' ')}${keep ? 'Z' : ''}`
      const data = escape(JSON.stringify({...stroke, points: undefined}))
      const look = keep ? 'fill="#d22f2733" stroke="#d22f27"' : `fill="none" stroke="${colourOf(stroke)}"`
      return `<path d="${d}" ${look} stroke-width="3" stroke-linecap="round" stroke-linejoin="round" data-stroke="${data}"/>`
    })
    const camera = escape(JSON.stringify(s.camera))
    const {width, height} = s.camera
    const group = `<g transform="translate(${x},0)" data-view="${escape(s.view)}" data-camera="${camera}"${s.orientation ? ` data-orientation="${escape(JSON.stringify(s.orientation))}"` : ''}><title>${escape(s.view)}</title>` +
      `<rect width="${width}" height="${height}" fill="none" stroke="#888"/>${paths.join('')}</g>`
    x += width + 20
    return group
  })
  const height = Math.max(1, ...document.sketches.map(s => s.camera.height))
  return `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${Math.max(x - 20, 1)} ${height}">${groups.join('')}</svg>`
}

/** The sketches in an SVG that toSVG wrote. Throws an Error that says what is missing. */
export function fromSVG(text) {
  const svg = new DOMParser().parseFromString(text, 'image/svg+xml')
  const groups = [...svg.querySelectorAll('g[data-view]')]
  if (svg.querySelector('parsererror') || !groups.length) throw new Error('this SVG was not exported by this page: no views are named in it')
  const sketches = groups.map(g => ({
    view: g.dataset.view, camera: JSON.parse(g.dataset.camera), ...g.dataset.orientation && {orientation: JSON.parse(g.dataset.orientation)},
    strokes: [...g.querySelectorAll('path[data-stroke]')].map(path => {
      const points = path.getAttribute('d').replace(/[MZ]/g, '').replace('L', ' ').trim().split(' ').map(p => p.split(',').map(Number))
      return {...JSON.parse(path.dataset.stroke), points}
    }),
  }))
  return {schema: 'scene2skill.sketches', version: 1, sketches}
}
