// The moment of the motion that all views show: the slider, its words, playing.

const find = id => document.getElementById(id)

export class Clock {
  /** changed(): told of each new moment. duration() [s]: null while there is no motion. */
  constructor(duration, changed) {
    Object.assign(this, {duration, changed, time: 0, playing: false})
    find('time').addEventListener('input', event => this.set(event.target.value / 1000))
  }

  /** t: share of the motion, from 0 to 1. */
  set(t) {
    this.time = t
    const whole = this.duration()
    find('time').value = Math.round(1000 * t)
    find('time').setAttribute('aria-valuetext', whole ? `${(t * whole).toFixed(1)} of ${whole.toFixed(1)} seconds` : `${Math.round(100 * t)} %`)
    find('clock').textContent = whole ? `${(t * whole).toFixed(1)} s` : ''
    this.changed()
  }

  /** Play from here, or stop. started(): told when it begins and ends. */
  play(started) {
    this.playing = !this.playing && !!this.duration()
    started()
    if (!this.playing) return
    if (this.time >= 1) this.time = 0
    let before = performance.now()
    const step = now => {
      if (!this.playing || !this.duration()) { this.playing = false; return started() }
      this.set(Math.min(1, this.time + (now - before) / 1000 / this.duration()))
      before = now
      if (this.time < 1) return requestAnimationFrame(step)
      this.playing = false
      started()
    }
    requestAnimationFrame(step)
  }
}
