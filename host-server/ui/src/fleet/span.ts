/** Which stretch of time the charts show, how it stands in the address, and how finely it is asked for. */

import type { Query } from '../view'

export const RANGES = {
  '1m': 60_000,
  '5m': 300_000,
  '15m': 900_000,
  '1h': 3_600_000,
  '6h': 21_600_000,
  '1d': 86_400_000,
  '7d': 604_800_000,
} as const
export type Range = keyof typeof RANGES
const USUAL: Range = '5m'

/** Points of a chart: more than there are pixels is no use. */
const POINTS = 480
const LEAST_STEP_MS = 200
const LEAST_SPAN_MS = 1_000

/** The last so long, moving on; or from then to then. */
export type Stretch = { live: Range } | { live: null; from: number; to: number }

export function stretchOf(query: Query): Stretch {
  const [from, to] = [Number(query['from'] ?? ''), Number(query['to'] ?? '')]
  if (
    Number.isSafeInteger(from) &&
    Number.isSafeInteger(to) &&
    from > 0 &&
    to - from >= LEAST_SPAN_MS
  ) {
    return { live: null, from, to }
  }
  const range = query['range'] ?? ''
  return { live: range in RANGES ? (range as Range) : USUAL }
}

export function queryOf(stretch: Stretch): Query {
  return stretch.live === null
    ? { range: '', from: String(stretch.from), to: String(stretch.to) }
    : { range: stretch.live === USUAL ? '' : stretch.live, from: '', to: '' }
}

export function bounds(stretch: Stretch, now: number): { from: number; to: number } {
  return stretch.live === null ? stretch : { from: now - RANGES[stretch.live], to: now }
}

export function stepFor(from: number, to: number): number {
  return Math.max(LEAST_STEP_MS, Math.ceil((to - from) / POINTS))
}

/** How often a live stretch is asked for anew: when there is something new to draw. */
export function refreshMs(range: Range): number {
  return Math.min(60_000, Math.max(1_000, RANGES[range] / 300))
}

/** Half its length earlier or later, not beyond now; live again when it reaches now. */
export function shifted(stretch: Stretch, by: -1 | 1, now: number): Stretch {
  const { from, to } = bounds(stretch, now)
  const length = to - from
  const end = Math.round(to + (by * length) / 2)
  if (end >= now) {
    const same = (Object.keys(RANGES) as Range[]).find((range) => RANGES[range] >= length)
    return { live: same ?? '7d' }
  }
  return { live: null, from: Math.round(end - length), to: end }
}
