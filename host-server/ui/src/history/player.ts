/** The clock of what is played: it stands still while what comes next has not come yet. */

import type { Ref } from 'vue'
import { ref } from 'vue'
import type { Speed, Window } from './address'
import { clamped } from './address'

/** What is written about the moment changes this often; pictures are made from `now`. */
const TELL_MS = 66
/** A tab that slept does not jump. */
const LONGEST_FRAME_MS = 500

interface PlayerOptions {
  window: () => Window
  /** Whether the record of a moment is here. */
  ready: (time: number) => boolean
  onMove: () => void
}

export class Player {
  /** The moment, Unix milliseconds. */
  now = 0
  /** The same for what is written, told less often while it plays. */
  readonly at: Ref<number> = ref(0)
  readonly playing = ref(false)
  /** It plays, but waits for the record. */
  readonly waits = ref(false)
  readonly speed: Ref<Speed> = ref(1)
  private toldAt = Number.NEGATIVE_INFINITY

  constructor(private readonly options: PlayerOptions) {}

  /** Plays; from the beginning where there is nothing left to play. */
  play(): void {
    const { from, to } = this.options.window()
    if (this.now >= to) this.seek(from)
    this.playing.value = true
  }

  pause(): void {
    this.playing.value = false
    this.waits.value = false
    this.at.value = this.now
  }

  toggle(): void {
    if (this.playing.value) this.pause()
    else this.play()
  }

  seek(time: number): void {
    const next = clamped(time, this.options.window())
    if (next === this.now && this.at.value === next) return
    this.now = next
    this.at.value = next
    this.options.onMove()
  }

  /** Stands, and goes so much back or forth. */
  step(by: number): void {
    this.pause()
    this.seek(this.now + by)
  }

  /** Lets so much time pass on the wall; `wall` is a monotonic clock. */
  advance(elapsed: number, wall: number): void {
    if (!this.playing.value) return
    const { to } = this.options.window()
    const next = Math.min(
      to,
      this.now + Math.min(LONGEST_FRAME_MS, Math.max(0, elapsed)) * this.speed.value,
    )
    this.waits.value = !this.options.ready(next)
    if (this.waits.value) return
    this.now = next
    if (next >= to) this.pause()
    else if (wall - this.toldAt >= TELL_MS) {
      this.toldAt = wall
      this.at.value = next
    }
    this.options.onMove()
  }
}
