/** Where a robot was at a moment, by what is recorded before and after it. */

import { shortestTurn } from '../fleet/fleet'
import type { Track } from './record'
import { lastAt } from './record'

/** Motion between points is blended when they are no further apart than this, or than so many steps. */
const BLEND_MS = 2_000
const BLEND_STEPS = 2.5
/** A point says how things are for this long, or for so many times what robots leave between points. */
const FRESH_MS = 2_000
const FRESH_SPACINGS = 2.5
/** Whoever was not heard of for this long is gone rather than late. */
export const GONE_MS = 30_000

export interface Seen {
  x: number
  y: number
  heading: number
  /** Index into the states. */
  state: number
  range: number | null
  battery: number
  /** When the point is from, Unix milliseconds. */
  told: number
  /** How old it is where that is too old; 0 while it says how things are. */
  gap: number
}

export function newSeen(): Seen {
  return { x: 0, y: 0, heading: 0, state: 0, range: null, battery: 0, told: 0, gap: 0 }
}

/**
 * Writes what is known at `time`; false when nothing is known yet. Between two points that are close
 * the motion is blended, turning the short way round. Across a gap nothing is made up: the robot
 * stays where it was told last.
 */
export function seenAt(track: Track, time: number, step: number, into: Seen): boolean {
  const i = lastAt(track.at, time)
  if (i < 0) return false
  const told = track.at[i] as number
  const next = track.at[i + 1]
  const reach = Math.max(BLEND_MS, BLEND_STEPS * step)
  const share =
    next !== undefined && next - told <= reach ? (time - told) / Math.max(1, next - told) : 0
  const [x, y, heading] = [track.x[i] as number, track.y[i] as number, track.theta[i] as number]
  into.x = x
  into.y = y
  into.heading = heading
  if (share > 0) {
    into.x += ((track.x[i + 1] as number) - x) * share
    into.y += ((track.y[i + 1] as number) - y) * share
    into.heading += shortestTurn(heading, track.theta[i + 1] as number) * share
  }
  const range = track.range[i] as number
  into.state = track.state[i] as number
  into.range = range < 0 ? null : range
  into.battery = track.battery[i] as number
  into.told = told
  into.gap = share > 0 || time - told <= fresh(track, step) ? 0 : time - told
  return true
}

/** How long a point of this robot says how things are. */
export function fresh(track: Pick<Track, 'spacing'>, step: number): number {
  return Math.max(FRESH_MS, FRESH_SPACINGS * Math.max(step, track.spacing))
}
