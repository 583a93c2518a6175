/** What the charts draw, and the same in numbers for those who do not see them. */

import type { CommandRecord, TelemetryPoint } from '../api-types'

export const CHARTS = ['range', 'battery', 'signal', 'wheels', 'latency'] as const
export type Chart = (typeof CHARTS)[number]

/** Values over time; `null` is a gap. */
export type Line = readonly (number | null)[]
/** Seconds on the x axis, then one list of values for each line. */
export type Columns = readonly [readonly number[], ...Line[]]

/** A gap as long as this many steps is one: the line must not bridge it. */
const GAP_STEPS = 3

/** What a point has for a line, in the unit that is written. */
type Take = (point: TelemetryPoint) => number | null
/** What is known as its lowest and highest too. */
type Spread = 'range' | 'battery' | 'signal'
type Extreme = TelemetryPoint['least']

const metres = (mm: number | null | undefined): number | null => (mm == null ? null : mm / 1_000)
const SPREAD: Record<Spread, (of: Extreme) => number | null> = {
  range: ({ range_mm }) => metres(range_mm),
  battery: ({ battery_percent }) => battery_percent,
  signal: ({ rssi_dbm }) => rssi_dbm ?? null,
}
const WHEELS: readonly Take[] = [({ left }) => left * 100, ({ right }) => right * 100]

const isSpread = (chart: Chart): chart is Spread => chart in SPREAD

export function columns(chart: Chart, points: readonly TelemetryPoint[], step: number): Columns {
  if (chart === 'latency') return [[], []]
  return drawn(points, step, isSpread(chart) ? [SPREAD[chart]] : WHEELS)
}

/** The lowest and the highest of each step of a line, gap for gap; `null` for a chart that has none. */
export function extremes(
  chart: Chart,
  points: readonly TelemetryPoint[],
  step: number,
): readonly [Line, Line] | null {
  if (!isSpread(chart)) return null
  const take = SPREAD[chart]
  const [, least = [], most = []] = drawn(points, step, [
    ({ least }) => take(least),
    ({ most }) => take(most),
  ])
  return [least, most]
}

function drawn(points: readonly TelemetryPoint[], step: number, takes: readonly Take[]): Columns {
  const x: number[] = []
  const lines: (number | null)[][] = takes.map(() => [])
  let last: number | null = null
  for (const point of points) {
    if (last !== null && point.at - last > GAP_STEPS * step) {
      x.push((last + step) / 1_000)
      for (const line of lines) line.push(null)
    }
    last = point.at
    x.push(point.at / 1_000)
    takes.forEach((take, at) => lines[at]?.push(take(point)))
  }
  return [x, ...lines]
}

/** How long a robot took to answer for good, by the clocks of server and robot, in seconds. */
export function latencies(
  records: readonly CommandRecord[],
  robot: string,
  from: number,
  to: number,
): Columns {
  const found = records
    .filter(({ timestamp }) => timestamp >= from && timestamp <= to)
    .flatMap(({ timestamp, outcomes }) => {
      const outcome = outcomes.find((one) => one.robot === robot)
      const at = outcome?.timestamp ?? null
      if (outcome?.status !== 'completed' || at === null) return []
      // Clocks differ by a little: less than nothing is nothing.
      return [[timestamp / 1_000, Math.max(0, at - timestamp) / 1_000] as const]
    })
    .sort(([a], [b]) => a - b)
  return [found.map(([x]) => x), found.map(([, y]) => y)]
}

interface Gist {
  now: number
  least: number
  most: number
  mean: number
}

/** What a line says in numbers; `around` has the lowest and highest of each of its values. `null` without a single one. */
export function gist(line: Line, around: readonly [Line, Line] | null = null): Gist | null {
  const values = line.filter((value): value is number => value !== null)
  const now = values.at(-1)
  if (now === undefined) return null
  const [least, most] = around ?? [line, line]
  return {
    now,
    least: bound(least, Math.min) ?? now,
    most: bound(most, Math.max) ?? now,
    mean: values.reduce((sum, value) => sum + value, 0) / values.length,
  }
}

function bound(line: Line, further: (a: number, b: number) => number): number | null {
  return line.reduce((found, value) => {
    if (found === null || value === null) return found ?? value
    return further(found, value)
  }, null)
}
