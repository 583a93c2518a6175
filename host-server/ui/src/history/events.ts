/** The events of a window, newest first, as far as they are needed around the moment. */

import type { Ref, ShallowRef } from 'vue'
import { ref, shallowRef } from 'vue'
import { trouble } from '../account/trouble'
import type { EventsBody, RecordedEvent } from '../api-types'
import type { Level } from '../feed/decode'
import type { Window } from './address'
import type { EventsWanted } from './history-api'

export const PAGE = 200
/** More are not kept; those around the moment are fetched instead. */
export const MOST_EVENTS = 1_000

export interface Filter {
  window: Window
  level: Level
  robot: string | null
}

type Fetch = (wanted: EventsWanted, signal: AbortSignal) => Promise<EventsBody>

export class RecordedLog {
  readonly entries: ShallowRef<readonly RecordedEvent[]> = shallowRef([])
  readonly busy = ref(false)
  readonly error: Ref<string | null> = ref(null)
  /** There are older ones in the window than are shown. */
  readonly older = ref(false)
  /** There are newer ones in the window than are shown. */
  readonly newer = ref(false)
  private filter: Filter | null = null
  private next: string | null = null
  /** Events up to here are shown. */
  private until = 0
  private asking: AbortController | null = null
  private moment = 0

  constructor(private readonly fetch: Fetch) {}

  /** Another window or filter. */
  open(filter: Filter, at: number): void {
    this.filter = filter
    this.moment = at
    void this.begin(filter.window.to)
  }

  /** The newest of the window. */
  newest(): void {
    if (this.filter !== null) void this.begin(this.filter.window.to)
  }

  more(): void {
    if (this.next !== null && this.asking === null) void this.page(this.next)
  }

  again(): void {
    if (this.entries.value.length === 0) this.newest()
    else void this.page(this.next)
  }

  /** Sees to it that what happened last at this moment is among what is shown. */
  follow(at: number): void {
    this.moment = at
    if (this.filter === null || this.asking !== null || this.error.value !== null) return
    if (at > this.until) void this.begin(this.filter.window.to)
    else if (this.short()) {
      if (this.entries.value.length < MOST_EVENTS) this.more()
      else void this.begin(at)
    }
  }

  close(): void {
    this.asking?.abort()
    this.asking = null
  }

  /** The moment is before all that is shown, and there is more. */
  private short(): boolean {
    const last = this.entries.value.at(-1)
    return this.next !== null && last !== undefined && this.moment < last.time
  }

  private begin(until: number): Promise<void> {
    this.close()
    this.until = until
    this.next = null
    this.older.value = false
    this.newer.value = this.filter !== null && until < this.filter.window.to
    return this.page(null)
  }

  private async page(before: string | null): Promise<void> {
    const { filter } = this
    if (filter === null) return
    const controller = new AbortController()
    this.asking = controller
    this.busy.value = true
    this.error.value = null
    const { window, level, robot } = filter
    const wanted = { from: window.from, to: this.until, level, robot, limit: PAGE, before }
    try {
      const { events, next } = await this.fetch(wanted, controller.signal)
      if (controller.signal.aborted) return
      this.next = next ?? null
      const shown = before === null ? events : [...this.entries.value, ...events]
      this.entries.value = shown.slice(-MOST_EVENTS)
      if (shown.length > MOST_EVENTS) {
        this.until = this.entries.value[0]?.time ?? this.until
        this.newer.value = true
      }
      this.older.value = this.next !== null
    } catch (problem) {
      if (!controller.signal.aborted) this.error.value = trouble(problem)
    } finally {
      if (this.asking === controller) {
        this.asking = null
        this.busy.value = false
        if (this.error.value === null) this.follow(this.moment)
      }
    }
  }
}

/** Which event is the last at a moment, in a list that is newest first; −1 before all of them. */
export function currentAt(entries: readonly Pick<RecordedEvent, 'time'>[], at: number): number {
  let [low, high] = [0, entries.length]
  while (low < high) {
    const middle = (low + high) >> 1
    if ((entries[middle] as { time: number }).time > at) low = middle + 1
    else high = middle
  }
  return low < entries.length ? low : -1
}
