/** What the server has recorded of a stretch of time, in a form that takes little room. */

import type { HistoryFrames } from '../api-types'
import type { Arena } from '../feed/arena'
import { readArena } from '../feed/arena'
import type { Kind } from '../feed/decode'
import { KINDS, STATES } from '../feed/decode'
import { object } from '../feed/fields'

/** One robot: columns of equal length, oldest first. */
export interface Track {
  robot: string
  kind: Kind
  /** Unix milliseconds. */
  at: Float64Array
  /** Metres. */
  x: Float32Array
  y: Float32Array
  /** Radians. */
  theta: Float32Array
  /** Indices into the states of the live feed. */
  state: Uint8Array
  /** Millimetres; −1 without a reading. */
  range: Int32Array
  /** Percent. */
  battery: Uint8Array
  /** Usual time from one point to the next, milliseconds. */
  spacing: number
}

export interface Recorded {
  from: number
  to: number
  step: number
  tracks: ReadonlyMap<string, Track>
  /** The arena from these times on, oldest first. */
  arenas: readonly { at: number; arena: Arena | null }[]
  /** How much there is of it. */
  points: number
}

/** The answer is not what it should be. */
export class Unreadable extends Error {}

/** Checks what must fit together; the rest the server's own tests hold it to. */
export function readFrames(told: HistoryFrames): Recorded {
  const states = stateCodes(told.states)
  const tracks = new Map<string, Track>()
  let points = 0
  for (const row of told.robots) {
    const track = readTrack(row, states)
    if (track.at.length === 0) continue
    tracks.set(track.robot, track)
    points += track.at.length
  }
  const arenas = [
    { at: Number.NEGATIVE_INFINITY, arena: readGround(told.arena) },
    ...told.arenas.map(({ at, arena }) => ({ at, arena: readGround(arena) })),
  ]
  return { from: told.from, to: told.to, step: told.step, tracks, arenas, points }
}

/** The states of the live feed, by their places in what names them here. */
export function stateCodes(names: readonly string[]): number[] {
  return names.map((name) => {
    const known = STATES.findIndex((state) => state === name)
    // A state of a newer server: nothing is known of it but that it is one.
    return known < 0 ? STATES.indexOf('IDLE') : known
  })
}

/** The arena at a moment; the same object for as long as it is the same. */
export function arenaAt({ arenas }: Recorded, time: number): Arena | null {
  let found: Arena | null = null
  for (const { at, arena } of arenas) if (at <= time) found = arena
  return found
}

/** The last place at or before a time; −1 where there is none. */
export function lastAt(at: Float64Array, time: number): number {
  let [low, high] = [0, at.length]
  while (low < high) {
    const middle = (low + high) >> 1
    if ((at[middle] as number) <= time) low = middle + 1
    else high = middle
  }
  return low - 1
}

function readTrack(row: HistoryFrames['robots'][number], states: readonly number[]): Track {
  const { robot, at, x, y, theta, state, range_mm, battery_percent } = row
  const columns: readonly (readonly unknown[])[] = [x, y, theta, state, range_mm, battery_percent]
  if (columns.some(({ length }) => length !== at.length)) {
    throw new Unreadable(`the record of ${robot} has columns of different lengths`)
  }
  const times = Float64Array.from(at)
  for (let i = 1; i < times.length; i++) {
    if ((times[i] as number) <= (times[i - 1] as number)) {
      throw new Unreadable(`the record of ${robot} is not in order`)
    }
  }
  return {
    robot,
    kind: KINDS.find((kind) => kind === row.kind) ?? 'simulated',
    at: times,
    x: Float32Array.from(x),
    y: Float32Array.from(y),
    theta: Float32Array.from(theta),
    state: Uint8Array.from(state, (index) => states[index] ?? STATES.indexOf('IDLE')),
    range: Int32Array.from(range_mm, (value) => (value === null ? -1 : Math.max(0, value))),
    battery: Uint8Array.from(battery_percent, (value) => Math.min(100, Math.max(0, value))),
    spacing: usualSpacing(times),
  }
}

/** The middle one of all distances: gaps and bursts do not count. */
function usualSpacing(at: Float64Array): number {
  if (at.length < 2) return 0
  const all = new Float64Array(at.length - 1)
  for (let i = 1; i < at.length; i++) all[i - 1] = (at[i] as number) - (at[i - 1] as number)
  all.sort()
  return all[all.length >> 1] as number
}

/** An arena that cannot be read is none: robots are worth showing without it. */
export function readGround(value: unknown): Arena | null {
  if (value === null || value === undefined) return null
  try {
    return readArena(object(value))
  } catch {
    return null
  }
}
