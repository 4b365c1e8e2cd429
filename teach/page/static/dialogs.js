// Questions that a person answers before anything goes on.

const find = id => document.getElementById(id)

/** What is typed in; null where it is given up. */
export async function prompt(title, label, value) {
  const dialog = find('prompt')
  dialog.querySelector('h2').textContent = title
  dialog.querySelector('label span').textContent = label
  dialog.querySelector('input').value = value
  dialog.showModal()
  dialog.querySelector('input').select()
  return await agreed(dialog) ? dialog.querySelector('input').value.trim() : null
}

/** Whether it is to be done. */
export async function confirm(title, words, act) {
  const dialog = find('confirm')
  dialog.querySelector('h2').textContent = title
  dialog.querySelector('p').textContent = words
  dialog.querySelector('[value=ok]').textContent = act
  dialog.showModal()
  return agreed(dialog)
}

function agreed(dialog) {
  dialog.querySelector('[value=cancel]').onclick = () => dialog.close('cancel') // no submit button: Enter means OK
  dialog.returnValue = 'cancel'
  return new Promise(done => dialog.addEventListener('close', () => done(dialog.returnValue === 'ok'), {once: true}))
}
