/**
 * The trials of one experiment as they come in, kept as sums: the mean up to any trial, or of any
 * stretch, is one subtraction, with a hundred thousand of them as with ten.
 */

import type { ExperimentMetric, ExperimentMetrics, ExperimentTrial } from '../api-types'
import { downsample } from './downsample'
import { wilson } from './statistics'

/** What every experiment has, whatever its server measures. */
export const SUCCESS = 'success'
/** Failed trials that are kept with their reasons. */
export const MOST_FAILURES = 1_000
const FIRST_ROOM = 256

export type Failure = Pick<ExperimentTrial, 'number' | 'seed' | 'reason' | 'command'>

/** One line of a chart: after how many trials, and what. */
export interface Curve {
  x: number[]
  y: (number | null)[]
}

interface Column {
  /** After so many trials: sum of the values there were, and how many that were. */
  sums: Float64Array
  counts: Uint32Array
}

const column = (room: number): Column => ({
  sums: new Float64Array(room + 1),
  counts: new Uint32Array(room + 1),
})

export class Trials {
  /** All that can be drawn: success first, then what the server lists. */
  metrics: readonly ExperimentMetric[] = [{ name: SUCCESS, unit: '', better: 'more' }]
  count = 0
  failed = 0
  /** The first of them. */
  readonly failures: Failure[] = []
  /** Number of the last trial, as the server counts. */
  last = -1
  private room = FIRST_ROOM
  private readonly columns = new Map<string, Column>([[SUCCESS, column(FIRST_ROOM)]])

  /** Takes in a page, and leaves out what is known already. Gives how many were new. */
  append(page: ExperimentMetrics): number {
    this.name(page.metrics)
    const places = new Map(page.metrics.map(({ name }, at) => [name, at]))
    const before = this.count
    for (const trial of page.trials) {
      if (trial.number <= this.last) continue
      this.last = trial.number
      this.add(trial, places)
    }
    return this.count - before
  }

  /** The mean of the last `window` trials at each, or of all before it; drawn by `most` points. */
  curve(metric: string, window: number | null, most: number): Curve {
    const kept = this.columns.get(metric)
    if (kept === undefined) return { x: [], y: [] }
    const { sums, counts } = kept
    const mean = (at: number): number | null => {
      const [to, from] = [at + 1, window === null ? 0 : Math.max(0, at + 1 - window)]
      const count = (counts[to] ?? 0) - (counts[from] ?? 0)
      return count === 0 ? null : ((sums[to] ?? 0) - (sums[from] ?? 0)) / count
    }
    const shown = downsample(this.count, mean, most)
    return { x: shown.map((at) => at + 1), y: shown.map(mean) }
  }

  /** Ends of the interval of the share of successes, after so many trials each. */
  band(after: readonly number[]): { low: number[]; high: number[] } {
    const { sums } = this.columns.get(SUCCESS) ?? column(0)
    const ends = after.map((count) => wilson(sums[count] ?? 0, count))
    return { low: ends.map(({ low }) => low), high: ends.map(({ high }) => high) }
  }

  private name(listed: readonly ExperimentMetric[]): void {
    const own = listed.filter(({ name }) => name !== SUCCESS)
    if (own.every(({ name }) => this.columns.has(name)) && own.length < this.metrics.length) return
    const success = listed.find(({ name }) => name === SUCCESS) ?? this.metrics[0]
    this.metrics = [...(success === undefined ? [] : [success]), ...own]
    for (const { name } of own) {
      // What was not measured before has no values before.
      if (!this.columns.has(name)) this.columns.set(name, column(this.room))
    }
  }

  private add(trial: ExperimentTrial, places: ReadonlyMap<string, number>): void {
    if (this.count === this.room) this.grow()
    const at = this.count
    for (const [name, { sums, counts }] of this.columns) {
      const value = name === SUCCESS ? Number(trial.success) : trial.values[places.get(name) ?? -1]
      const is = typeof value === 'number' && Number.isFinite(value)
      sums[at + 1] = (sums[at] ?? 0) + (is ? value : 0)
      counts[at + 1] = (counts[at] ?? 0) + Number(is)
    }
    this.count += 1
    if (trial.success) return
    this.failed += 1
    if (this.failures.length >= MOST_FAILURES) return
    const { number, seed, reason = null, command = null } = trial
    this.failures.push({ number, seed, reason, command })
  }

  private grow(): void {
    this.room *= 2
    for (const [name, old] of this.columns) {
      const larger = column(this.room)
      larger.sums.set(old.sums)
      larger.counts.set(old.counts)
      this.columns.set(name, larger)
    }
  }
}
