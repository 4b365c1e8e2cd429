// Talking to the server: one request at a time for the file, which is saved after each stroke and never over another's work.

export const tab = sessionStorage.tab ??= crypto.randomUUID()

export class Answer extends Error {
  constructor(status, body) { super(body.error ?? `the server answered ${status}`); this.status = status; this.body = body }
}

/** JSON of an answer; throws an Answer for errors. */
export async function ask(path, {method = 'GET', body, headers = {}, signal} = {}) {
  const text = body === undefined || typeof body === 'string' ? body : JSON.stringify(body)
  const response = await fetch(path, {method, body: text, signal, headers: {'content-type': 'application/json', 'x-tab': tab, ...headers}})
  if (!response.ok) throw new Answer(response.status, await response.json().catch(() => ({})))
  return response.headers.get('content-type')?.startsWith('application/json') ? response.json() : response.blob()
}

export const skillPath = name => `/api/skills/${encodeURIComponent(name)}`

/** A skill's text and revision, or null where there is none. */
export async function readSkill(name) {
  const response = await fetch(skillPath(name))
  if (response.status === 404) return null
  if (!response.ok) throw new Answer(response.status, await response.json().catch(() => ({})))
  return {text: await response.text(), revision: response.headers.get('etag').replaceAll('"', '')}
}

/** Keeps a skill saved. state: "saved", "saving", "offline" or "conflict"; text() gives what is to be saved. */
export class Saver {
  constructor(text, changed) { this.text = text; this.changed = changed; this.name = null; this.state = 'saved'; this.pending = false; this.wait = 0; this.unanswered = [] }

  open(name, revision) { this.name = name; this.revision = revision; this.pending = false; this.unanswered = []; this.be('saved') }
  be(state, why) { this.state = state; this.changed(state, why) }

  /** Something changed: save it, at once if nothing is being saved. Kept here first: the tab may be closed before the server answers. */
  save() {
    this.pending = true
    this.backUp()
    if (this.state === 'conflict') return
    return this.running ??= this.run().finally(() => { this.running = null })
  }

  async run() {
    while (this.pending && this.state !== 'conflict') {
      this.pending = false
      this.be('saving')
      const name = this.name, text = this.text()
      const headers = this.revision ? {'if-match': `"${this.revision}"`} : {'if-none-match': '*'}
      try {
        const answer = await ask(skillPath(name), {method: 'PUT', body: text, headers})
        if (name !== this.name) continue
        this.revision = answer.revision
        this.wait = 0
        this.unanswered = []
        if (!this.pending) { localStorage.removeItem(`unsaved:${name}`); this.be('saved') }
      } catch (error) {
        if (name !== this.name) continue
        this.pending = true
        if (error instanceof Answer && error.status === 412) { if (!await this.isOurs(name)) this.be('conflict', error) }
        else if (error instanceof Answer) { this.pending = false; this.be('refused', error) }
        else {
          this.unanswered = [...this.unanswered.slice(-4), text]
          this.be('offline', error)
          await new Promise(done => setTimeout(done, this.wait = Math.min(4000, 2 * this.wait + 200)))
        }
      }
    }
  }

  /** Whether the server has a text of ours: it was killed after writing and before it could say so. */
  async isOurs(name) {
    const there = await readSkill(name).catch(() => null)
    if (!there || !this.unanswered.includes(there.text)) return false
    this.revision = there.revision
    return true
  }

  /** What is not saved survives this tab being closed too. */
  backUp() { try { localStorage.setItem(`unsaved:${this.name}`, JSON.stringify({revision: this.revision ?? null, text: this.text()})) } catch { /* full */ } }
}

/** Hear of progress and of others' changes; goes on after the server was away. */
export function listen(name, hear, back) {
  let socket, closed = false, wait = 200
  const connect = () => {
    socket = new WebSocket(`${location.origin.replace('http', 'ws')}/live?skill=${encodeURIComponent(name)}`)
    socket.onopen = () => { if (wait > 200) back(); wait = 200 }
    socket.onmessage = event => hear(JSON.parse(event.data))
    socket.onclose = () => { if (!closed) setTimeout(connect, wait = Math.min(4000, wait * 2)) }
  }
  connect()
  return () => { closed = true; socket.close() }
}
