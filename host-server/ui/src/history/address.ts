/** What of the record is looked at, as it stands in the address. */

import type { Level } from '../feed/decode'
import type { Query } from '../view'

export const SPEEDS = [1, 2, 5, 10, 60] as const
export type Speed = (typeof SPEEDS)[number]
export const LEVELS = ['info', 'warn', 'error'] as const satisfies readonly Level[]

/** A closer look than this shows nothing. */
export const LEAST_WINDOW_MS = 10_000
/** As long as anything is kept. */
const MOST_WINDOW_MS = 400 * 86_400_000
/** What is shown to whoever asks for nothing in particular. */
export const USUAL_WINDOW_MS = 300_000

/** Unix milliseconds. */
export interface Window {
  from: number
  to: number
}

export interface Wish {
  /** `null`: the last minutes that are recorded. */
  window: Window | null
  /** `null`: the end of the window. */
  at: number | null
  robot: string | null
  speed: Speed
  /** Events of at least this level. */
  level: Level
  /** Events of the chosen robot alone. */
  only: boolean
}

/** Never throws: a link may be cut off anywhere. */
export function wishOf(query: Query): Wish {
  const [from, to, at] = [time(query['from']), time(query['to']), time(query['at'])]
  const fits = from !== null && to !== null && to - from >= LEAST_WINDOW_MS
  const window = fits && to - from <= MOST_WINDOW_MS ? { from, to } : null
  const robot = query['robot'] ?? ''
  const speed = Number(query['speed'])
  return {
    window,
    at: at === null || window === null ? at : clamped(at, window),
    robot: robot === '' ? null : robot,
    speed: SPEEDS.find((known) => known === speed) ?? 1,
    level: LEVELS.find((known) => known === query['level']) ?? 'info',
    only: query['only'] === '1',
  }
}

/** The part of an address that is to change; what is as usual is left out of it. */
export function queryOfWish(wish: Partial<Wish>): Query {
  const query: Record<string, string> = {}
  if (wish.window !== undefined) {
    query['from'] = wish.window === null ? '' : String(Math.round(wish.window.from))
    query['to'] = wish.window === null ? '' : String(Math.round(wish.window.to))
  }
  if (wish.at !== undefined) query['at'] = wish.at === null ? '' : String(Math.round(wish.at))
  if (wish.robot !== undefined) query['robot'] = wish.robot ?? ''
  if (wish.speed !== undefined) query['speed'] = wish.speed === 1 ? '' : String(wish.speed)
  if (wish.level !== undefined) query['level'] = wish.level === 'info' ? '' : wish.level
  if (wish.only !== undefined) query['only'] = wish.only ? '1' : ''
  return query
}

export function clamped(at: number, { from, to }: Window): number {
  return Math.min(to, Math.max(from, at))
}

/** The same moment in the middle or at its edge, with more or less around it. */
export function zoomed(window: Window, at: number, factor: number): Window {
  const length = Math.round(
    Math.min(MOST_WINDOW_MS, Math.max(LEAST_WINDOW_MS, (window.to - window.from) * factor)),
  )
  const share = (clamped(at, window) - window.from) / (window.to - window.from)
  const from = Math.round(at - share * length)
  return { from: Math.max(1, from), to: Math.max(1, from) + length }
}

/** What was chosen in a chart, widened where it is less than can be shown. */
export function widened({ from, to }: Window): Window {
  const more = Math.max(0, LEAST_WINDOW_MS - (to - from)) / 2
  return { from: Math.floor(from - more), to: Math.ceil(to + more) }
}

/** Half its length earlier or later. */
export function moved(window: Window, by: -1 | 1): Window {
  const half = Math.round((window.to - window.from) / 2)
  const from = Math.max(1, window.from + by * half)
  return { from, to: from + window.to - window.from }
}

/** The window itself where it holds the moment, else one as long around it. */
export function around(window: Window, at: number): Window {
  if (at >= window.from && at <= window.to) return window
  const half = Math.round((window.to - window.from) / 2)
  const from = Math.max(1, Math.round(at) - half)
  return { from, to: from + 2 * half }
}

function time(text: string | undefined): number | null {
  const value = Number(text ?? '')
  return Number.isSafeInteger(value) && value > 0 ? value : null
}
