// Every command once: its key, its button, its words. The key list and the menu are made of these.

import {checked, toSVG, fromSVG} from './document.js'
import {MARKS, colourOf} from './ink.js'

const find = id => document.getElementById(id)
const ICONS = {
  draw: 'M4 20c4 0 4-4 8-4s4-6 0-6-3-5 3-6M15 4l5 5', waypoints: 'M5 18 10 8l5 6 4-9M5 18h.01M10 8h.01M15 14h.01M19 5h.01', keep_out: 'M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18M6 6l12 12',
  arrow: 'M6 19 18 6M9.500 6H18v8.500',
  mark: 'M12 21s7-6.2 7-11a7 7 0 0 0-14 0c0 4.8 7 11 7 11M12 10h.01', select: 'M5 3l6 17 2.5-7L20 10.5z', erase: 'M8 20h12M5 13l8-8 6 6-9 9H8l-3-3z', pan: 'M12 3v18M3 12h18M12 3l-3 3M12 3l3 3M12 21l-3-3M12 21l3-3M3 12l3-3M3 12l3 3M21 12l-3-3M21 12l-3 3',
  undo: 'M4 9h10a6 6 0 0 1 0 12h-3M4 9l5-5M4 9l5 5', redo: 'M20 9H10a6 6 0 0 0 0 12h3M20 9l-5-5M20 9l-5 5', play: 'M7 4l13 8-13 8z', pause: 'M7 4v16M17 4v16', keys: 'M9 9a3 3 0 1 1 4 2.8c-1 .4-1 1.2-1 2.200M12 18h.01', more: 'M5 12h.01M12 12h.01M19 12h.01',
}

function icon(name) {
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg'), path = document.createElementNS(svg.namespaceURI, 'path')
  svg.setAttribute('viewBox', '0 0 24 24')
  svg.setAttribute('aria-hidden', 'true')
  path.setAttribute('d', ICONS[name])
  svg.append(path)
  return svg
}

const TOOLS = [['draw', 'D', 'Draw a stroke'], ['waypoints', 'W', 'Waypoints'], ['keep_out', 'K', 'Keep-out region'], ['arrow', 'P', 'Arrow for the hand to point along'], ['mark', 'M', 'Mark on a stroke'],
  ['select', 'V', 'Select'], ['erase', 'E', 'Erase'], ['pan', 'H', 'Move the picture']]

function commands(page) {
  const {document: doc, work} = page, view = () => page.focused
  return [
    ...TOOLS.map(([tool, key, label]) => ({group: 'Tools', key, label, place: 'tools', icon: tool, on: () => page.tool === tool, run: () => page.setTool(tool)})),
    {group: 'Edit', key: 'Ctrl+Z', label: 'Undo', place: 'history', icon: 'undo', can: () => doc.past.length, run: () => doc.undo()},
    {group: 'Edit', key: 'Ctrl+Shift+Z', also: 'Ctrl+Y', label: 'Redo', place: 'history', icon: 'redo', can: () => doc.future.length, run: () => doc.redo()},
    {group: 'Edit', key: 'Delete', also: 'Backspace', label: 'Erase the selected stroke', place: 'menu', can: () => page.selected, run: () => page.eraseSelected()},
    {group: 'Edit', key: 'Ctrl+D', label: 'Copy the selected stroke to a new demonstration', place: 'menu', can: () => page.selected, run: () => page.duplicate()},
    {group: 'Edit', key: 'Shift+X', label: 'Clear all strokes (can be undone)', place: 'menu', can: () => doc.all.length, run: () => { doc.clear(); page.say('Cleared. Ctrl+Z brings everything back.') }},
    {group: 'Edit', key: 'G', label: 'Hold the hand another way', run: () => page.hand.next()},
    {group: 'Edit', key: ']', label: 'Draw the next demonstration again', run: () => page.demonstrations.step(1)},
    {group: 'Edit', key: '[', label: 'Draw the previous demonstration again', run: () => page.demonstrations.step(-1)},
    ...Object.entries(MARKS).map(([name, {label, short}]) => ({group: 'Marks', key: short, label: `${label}, here on the stroke`, place: 'marks', short: label, run: () => page.mark(name)})),
    {group: 'Motion', key: 'Space', label: 'Play', place: 'play', icon: () => page.clock.playing ? 'pause' : 'play', can: () => page.motion, run: () => page.play()},
    {group: 'Motion', key: ',', label: 'A moment back', run: () => page.setTime(Math.max(0, page.clock.time - 0.02))},
    {group: 'Motion', key: '.', label: 'A moment on', run: () => page.setTime(Math.min(1, page.clock.time + 0.02))},
    {group: 'Motion', key: 'R', label: 'Redraw the least certain part, on the view that sees it best', place: 'redraw', short: 'Redraw this part', can: () => page.motion && !page.stale, run: () => page.redraw.begin()},
    {group: 'Motion', key: 'Ctrl+Enter', label: 'Check reach, clearance and timing', place: 'act', short: 'Check', off: !page.scene.can.plan, can: () => page.motion, run: () => work.check()},
    {group: 'Motion', key: 'Shift+Enter', label: 'Perform in simulation', place: 'act', short: 'Perform', off: !page.scene.can.perform, can: () => page.motion, run: () => work.perform()},
    {group: 'Motion', key: 'Ctrl+Shift+Enter', label: 'Done: go on with this skill', place: 'act', short: 'Done', off: !page.scene.can.finish, can: () => page.motion, run: () => work.done()},
    {group: 'Pictures', key: '1', label: 'To the first picture', run: () => page.views[0].frame.focus()},
    {group: 'Pictures', key: '2', label: 'To the second picture', run: () => page.views[1].frame.focus()},
    {group: 'Pictures', key: 'L', label: 'Another picture here', run: () => page.pictures.choose(view())},
    {group: 'Pictures', key: 'A', label: 'Another viewpoint here', off: !page.scene.can.render, run: () => page.orbit.open(view())},
    {group: 'Pictures', key: 'Y', label: 'Suggest a viewpoint for the next sketch, and why', place: 'suggest', short: 'Suggest a viewpoint', off: !page.scene.can.suggest, can: () => page.drawn.length, run: () => page.orbit.suggestNext()},
    {group: 'Pictures', key: '3', label: 'To the motion in space', run: () => find('space').focus()},
    {group: 'Pictures', key: 'F', label: 'Enlarge this picture, or the motion in space', run: () => document.activeElement === find('space') ? page.space.enlarge() : page.pictures.enlarge(view())},
    {group: 'Pictures', key: '+', also: '=', label: 'Closer', run: () => view().zoomBy(1.5)},
    {group: 'Pictures', key: '-', label: 'Farther', run: () => view().zoomBy(1 / 1.5)},
    {group: 'Pictures', key: '0', label: 'Whole picture', run: () => view().fit()},
    {group: 'Show', key: 'Shift+S', label: 'Strokes', place: 'menu', on: () => page.shows.strokes, run: () => toggle(page, 'strokes')},
    {group: 'Show', key: 'Shift+M', label: 'Learned motion', place: 'menu', on: () => page.shows.motion, run: () => toggle(page, 'motion')},
    {group: 'Show', key: 'Shift+H', label: 'Help lines while drawing', place: 'menu', on: () => page.shows.help, run: () => toggle(page, 'help')},
    {group: 'Show', key: 'Shift+R', label: 'The arm on the pictures, once checked', place: 'menu', on: () => page.shows.arm, run: () => toggle(page, 'arm')},
    {group: 'Skill', key: 'N', label: 'New skill', place: 'menu', run: () => page.skills.create()},
    {group: 'Skill', key: 'Shift+Delete', label: 'Remove this skill', place: 'menu', run: () => page.skills.remove()},
    {group: 'Skill', key: 'Ctrl+S', label: 'Export as JSON', place: 'menu', run: () => download(`${page.name}.json`, doc.text(), 'application/json')},
    {group: 'Skill', key: 'Ctrl+Shift+S', label: 'Export as SVG', place: 'menu', run: () => download(`${page.name}.svg`, toSVG(doc, colourOf), 'image/svg+xml')},
    {group: 'Skill', key: 'Ctrl+O', label: 'Import JSON or SVG', place: 'menu', run: () => find('file').click()},
    {group: 'Help', key: '?', label: 'All keys', place: 'history', icon: 'keys', run: () => find('keys').showModal()},
    {group: 'Help', key: 'Escape', label: 'Stop what is going on', run: () => { if (!page.cancel() && !page.redraw.end() && !work.stop()) page.select(null) }},
  ].filter(command => !command.off)
}

function toggle(page, what) { page.shows[what] = !page.shows[what]; page.refreshCommands(); page.paint() }

function download(name, text, type) {
  const url = URL.createObjectURL(new Blob([text], {type}))
  Object.assign(document.createElement('a'), {href: url, download: name}).click()
  setTimeout(() => URL.revokeObjectURL(url), 1000)
}

/** A file takes the place of what is drawn, which can be undone. */
async function importFile(page, file) {
  try {
    if (file.size > 32 * 2 ** 20) throw new Error('it has more than 32 MB')
    const text = await file.text(), plain = checked(text.trimStart().startsWith('<') ? fromSVG(text) : JSON.parse(text))
    page.document.change(`imported ${file.name}`, () => plain.sketches)
    await page.saver.running
    if (page.saver.state === 'refused') { page.document.undo(); return }
    await page.pictures.show()
    page.say(`${file.name} is imported; Ctrl+Z takes it back.`)
  } catch (error) { page.say(`${file.name} cannot be imported: ${error.message}.`) }
}

/** "Ctrl+Shift+Z" of a key event. Shift counts with letters and named keys; of other signs it is part of them. */
function keyOf(event) {
  const named = event.key === ' ' ? 'Space' : event.key.length === 1 ? event.key.toUpperCase() : event.key
  const shift = event.shiftKey && (named.length > 1 || /[A-Z]/.test(named))
  return [(event.ctrlKey || event.metaKey) && 'Ctrl', shift && 'Shift', named].filter(Boolean).join('+')
}

export function bindCommands(page) {
  const all = commands(page), byKey = new Map(), buttons = []
  for (const command of all) for (const key of [command.key, command.also]) if (key) byKey.set(key, command)
  for (const command of all.filter(c => c.place)) {
    const button = Object.assign(document.createElement('button'), {type: 'button'})
    button.setAttribute('aria-keyshortcuts', command.key.replaceAll('Ctrl', 'Control'))
    if (command.icon) { button.setAttribute('aria-label', command.label); button.dataset.tip = `${command.label}   ${command.key}` }
    else button.title = `${command.label} (${command.key})`
    if (!command.icon) button.append(command.short ?? command.label)
    if (['menu', 'marks'].includes(command.place)) button.append(Object.assign(document.createElement('kbd'), {textContent: command.key}))
    button.addEventListener('click', event => {
      if (event.detail) button.blur() // pressed with a pointer: the next key is not for it
      button.closest('[popover]')?.hidePopover()
      command.run()
    })
    find(command.place).append(button)
    buttons.push([command, button])
  }
  page.refreshCommands = () => {
    for (const [command, button] of buttons) {
      const drawn = typeof command.icon === 'function' ? command.icon() : command.icon
      if (drawn && button.dataset.icon !== drawn) { button.dataset.icon = drawn; button.replaceChildren(icon(drawn)) }
      if (command.on) button.setAttribute('aria-pressed', !!command.on())
      if (command.can) button.disabled = !command.can()
      if (command.place === 'act') button.classList.toggle('main', command.short === page.next)
    }
  }
  for (const type of ['pointerenter', 'focusin']) find('redraw').addEventListener(type, () => page.redraw.show(true))
  for (const type of ['pointerleave', 'focusout']) find('redraw').addEventListener(type, () => page.redraw.show(false))
  page.refreshCommands()
  addEventListener('keydown', event => {
    const typing = event.target.matches?.('input:not([type=range]), select, textarea'), open = document.querySelector('dialog[open]')
    if (typing || open || event.isComposing) return
    const key = keyOf(event), command = byKey.get(key)
    if (key === 'Space' && event.target.matches?.('button, summary')) return
    if (!command || event.repeat && !',.'.includes(key)) return
    if (command.can && !command.can()) return event.preventDefault()
    event.preventDefault()
    command.run()
  })
  find('more').append(icon('more'))
  find('file').addEventListener('change', event => { if (event.target.files[0]) importFile(page, event.target.files[0]); event.target.value = '' })
  addEventListener('dragover', event => event.preventDefault())
  addEventListener('drop', event => { event.preventDefault(); if (event.dataTransfer.files[0]) importFile(page, event.dataTransfer.files[0]) })
  for (const group of new Set(all.map(c => c.group))) {
    const table = document.createElement('section')
    table.append(Object.assign(document.createElement('h3'), {textContent: group}))
    for (const {key, also, label} of all.filter(c => c.group === group)) {
      const row = document.createElement('div')
      row.append(Object.assign(document.createElement('span'), {textContent: label}), Object.assign(document.createElement('kbd'), {textContent: also ? `${key}, ${also}` : key}))
      table.append(row)
    }
    find('key-list').append(table)
  }
}
