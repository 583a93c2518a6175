/** Keeps an eye on fleet, server, broker and database, and says what is wrong. */

import type { ComputedRef, InjectionKey, ShallowRef } from 'vue'
import { computed, inject, shallowRef } from 'vue'
import type { Counts, Finding, Readiness, Verdict } from '../fleet/health'
import { findings, verdict } from '../fleet/health'
import type { Figures, Recent } from '../fleet/openmetrics'
import { figuresOf, recent } from '../fleet/openmetrics'
import type { Room } from './room'

const READINESS_EVERY_MS = 5_000
const FIGURES_EVERY_MS = 10_000
/** "Lately" is this long at most. */
const RECENT_MS = 300_000

export class Watch {
  readonly readiness: ShallowRef<Readiness | null> = shallowRef(null)
  readonly figures: ShallowRef<Figures | null> = shallowRef(null)
  readonly recent: ShallowRef<Recent | null> = shallowRef(null)
  /** Why the figures are not there; `null` while they are. */
  readonly figuresError: ShallowRef<string | null> = shallowRef(null)
  readonly counts: ComputedRef<Counts>
  readonly findings: ComputedRef<readonly Finding[]>
  readonly verdict: ComputedRef<Verdict>

  private past: Figures[] = []
  private readonly timers: ReturnType<typeof setInterval>[] = []

  constructor(private readonly room: Room) {
    this.counts = computed(() => {
      void room.tick.value
      return countsOf(room)
    })
    this.findings = computed(() =>
      findings({
        connection: room.status.value.state,
        age: room.age.value,
        readiness: this.readiness.value,
        stop: room.stopState.value,
        counts: this.counts.value,
        figures: this.figures.value,
        recent: this.recent.value,
      }),
    )
    this.verdict = computed(() => verdict(this.findings.value, room.status.value.state))
  }

  start(): void {
    void this.askReadiness()
    void this.askFigures()
    this.timers.push(
      setInterval(() => void this.askReadiness(), READINESS_EVERY_MS),
      setInterval(() => void this.askFigures(), FIGURES_EVERY_MS),
    )
  }

  close(): void {
    for (const timer of this.timers) clearInterval(timer)
    this.timers.length = 0
  }

  private get idle(): boolean {
    return document.hidden || this.room.status.value.state === 'waiting'
  }

  private async askReadiness(): Promise<void> {
    if (this.idle) return
    // That the server does not answer is told by the connection.
    const found = await this.room.api.readiness().catch(() => null)
    if (found !== null) this.readiness.value = found
  }

  private async askFigures(): Promise<void> {
    if (this.idle) return
    try {
      const now = figuresOf(await this.room.api.metrics(), performance.now())
      this.past = [...this.past.filter(({ at }) => now.at - at < RECENT_MS), now]
      this.figures.value = now
      const first = this.past[0]
      this.recent.value = first === undefined || first === now ? null : recent(now, first)
      this.figuresError.value = null
    } catch (error) {
      this.figuresError.value = error instanceof Error ? error.message : String(error)
    }
  }
}

function countsOf(room: Room): Counts {
  const counts: Counts = { online: 0, stale: 0, offline: 0, error: 0, low: 0, fence: 0 }
  for (const robot of room.fleet.all()) {
    counts[robot.presence] += 1
    if (robot.presence === 'offline') continue
    if (robot.state === 'ERROR') counts.error += 1
    if (robot.lowBattery) counts.low += 1
    if (robot.fence !== null) counts.fence += 1
  }
  return counts
}

export const WATCH: InjectionKey<Watch> = Symbol('watch')

export function useWatch(): Watch {
  const watch = inject(WATCH)
  if (watch === undefined) throw new Error('no watch is provided')
  return watch
}
