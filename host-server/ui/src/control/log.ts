/** What happened, newest first. */

import type { ShallowRef } from 'vue'
import { shallowRef } from 'vue'
import type { Level } from '../feed/decode'

export interface LogEntry {
  key: number
  time: number
  level: Level
  robot: string | null
  text: string
}

export const MOST_LOG_ENTRIES = 300

export class Log {
  readonly shown: ShallowRef<readonly LogEntry[]> = shallowRef([])
  private key = 0
  private waiting: LogEntry[] = []

  /** Entries wait for the next `show`: a thousand robots may report at once. */
  append(entry: Omit<LogEntry, 'key'>): void {
    this.key += 1
    this.waiting.push({ ...entry, key: this.key })
    if (this.waiting.length > MOST_LOG_ENTRIES) this.waiting.shift()
  }

  show(): void {
    if (this.waiting.length === 0) return
    this.shown.value = [...this.waiting.reverse(), ...this.shown.value].slice(0, MOST_LOG_ENTRIES)
    this.waiting = []
  }

  clear(): void {
    this.waiting = []
    this.shown.value = []
  }
}
