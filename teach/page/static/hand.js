// How the hand is held along the motion: as it turns out, kept, pointing down, or along an arrow that is drawn on two pictures.

const find = id => document.getElementById(id)
const WAYS = {free: 'turns as it needs to', keep: 'stays as it begins', down: 'points straight down', along: 'points along an arrow'}

export class Hand {
  constructor(page) {
    this.page = page
    this.select = find('hand')
    this.select.replaceChildren(...Object.entries(WAYS).map(([kind, words]) => new Option(words, kind)))
    this.select.addEventListener('change', () => this.choose(this.select.value))
  }

  get kind() { return this.page.document.orientation?.kind ?? 'free' }

  choose(kind) {
    const {page} = this, {document: doc} = page
    if (!doc.sketches.length) doc.addView(page.focused.name, page.focused.view.camera)
    if (kind !== this.kind) doc.orient(kind === 'free' ? undefined : {kind})
    const missing = kind === 'along' ? this.missing() : null
    if (missing) page.setTool('arrow')
    page.say(missing ?? `The hand ${WAYS[kind]}.`)
  }

  next() {
    const kinds = Object.keys(WAYS)
    this.choose(kinds[(kinds.indexOf(this.kind) + 1) % kinds.length])
  }

  /** An arrow was drawn: it takes the place of the one before on that picture, and the hand points along it. */
  drawn(view, stroke) {
    this.page.document.point(view.name, stroke)
    this.page.say(this.missing() ?? 'The hand points along the arrow.')
  }

  /** What is missing for the arrow to have a direction; null where nothing is. */
  missing() {
    const drawn = this.page.document.sketches.filter(s => this.page.document.of(s.view, 'arrow').length).map(s => s.view)
    if (drawn.length > 1 || this.page.document.orientation?.axis) return null
    return drawn.length ? `Now draw the same arrow on a second picture, beside ${drawn[0]}.` : 'Draw an arrow on one picture, from the wrist to the fingertips, then the same one on a second.'
  }

  show() { this.select.value = this.kind }
}
