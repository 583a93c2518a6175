/** What the charts draw, and the same in numbers for those who do not see them. */

import type { CommandRecord, TelemetryPoint } from '../api-types'

export const CHARTS = ['range', 'battery', 'signal', 'wheels', 'latency'] as const
export type Chart = (typeof CHARTS)[number]

/** Seconds on the x axis, then one list of values for each line; `null` is a gap. */
export type Columns = readonly [readonly number[], ...(readonly (number | null)[])[]]

/** A gap as long as this many steps is one: the line must not bridge it. */
const GAP_STEPS = 3

export function columns(chart: Chart, points: readonly TelemetryPoint[], step: number): Columns {
  const take: Record<Exclude<Chart, 'latency'>, ((point: TelemetryPoint) => number | null)[]> = {
    range: [({ range_mm }) => (range_mm == null ? null : range_mm / 1_000)],
    battery: [({ battery_percent }) => battery_percent],
    signal: [({ rssi_dbm }) => rssi_dbm ?? null],
    wheels: [({ left }) => left * 100, ({ right }) => right * 100],
  }
  if (chart === 'latency') return [[], []]
  const x: number[] = []
  const lines: (number | null)[][] = take[chart].map(() => [])
  let last: number | null = null
  for (const point of points) {
    if (last !== null && point.at - last > GAP_STEPS * step) {
      x.push((last + step) / 1_000)
      for (const line of lines) line.push(null)
    }
    last = point.at
    x.push(point.at / 1_000)
    take[chart].forEach((value, at) => lines[at]?.push(value(point)))
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

/** `null` without a single value. */
export function gist(line: readonly (number | null)[]): Gist | null {
  const values = line.filter((value): value is number => value !== null)
  const now = values.at(-1)
  if (now === undefined) return null
  let [least, most, sum] = [now, now, 0]
  for (const value of values) {
    if (value < least) least = value
    if (value > most) most = value
    sum += value
  }
  return { now, least, most, mean: sum / values.length }
}
