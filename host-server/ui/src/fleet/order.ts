/** Which robots are shown, and in which order. */

import type { Kind, Presence, RobotState } from '../feed/decode'
import { KINDS, PRESENCES, STATES } from '../feed/decode'
import type { Robot } from './fleet'

/** What the live feed does not carry, of every robot; asked for every few seconds. */
export interface RobotSummary {
  battery: number | null
  rssi: number | null
  behaviour: string | null
  /** Unix milliseconds. */
  lastSeen: number | null
}
export type Summaries = ReadonlyMap<string, RobotSummary>

export const SHOWS = [
  'all',
  'attention',
  ...PRESENCES,
  'low',
  'fence',
  ...KINDS,
  ...STATES.map((state) => state.toLowerCase() as Lowercase<RobotState>),
] as const
export type Show = (typeof SHOWS)[number]

export const SORTS = [
  'name',
  'state',
  'battery',
  'signal',
  'range',
  'behaviour',
  'firmware',
  'seen',
] as const
export type Sort = (typeof SORTS)[number]

export interface Wanted {
  search: string
  show: Show
  sort: Sort
  descending: boolean
}

export function isShow(value: string): value is Show {
  return (SHOWS as readonly string[]).includes(value)
}

export function isSort(value: string): value is Sort {
  return (SORTS as readonly string[]).includes(value)
}

export function needsAttention(robot: Robot): boolean {
  const well = robot.presence === 'online' && robot.state !== 'ERROR' && !robot.lowBattery
  return !well || robot.fence !== null
}

export function passes(robot: Robot, show: Show): boolean {
  switch (show) {
    case 'all':
      return true
    case 'attention':
      return needsAttention(robot)
    case 'low':
      return robot.lowBattery
    case 'fence':
      return robot.fence !== null
    default:
      if ((PRESENCES as readonly string[]).includes(show)) {
        return robot.presence === (show as Presence)
      }
      if ((KINDS as readonly string[]).includes(show)) return robot.kind === (show as Kind)
      // What an absent robot did last says nothing about now.
      return robot.presence !== 'offline' && robot.state === show.toUpperCase()
  }
}

/** States from what must be looked at to what is as it should be. */
const URGENCY: Record<RobotState, number> = {
  ERROR: 0,
  CAUTION: 1,
  AVOIDING: 2,
  UPDATING: 3,
  INITIALIZING: 4,
  SCANNING: 5,
  MOVING: 6,
  IDLE: 7,
}
const PRESENT: Record<Presence, number> = { offline: 0, stale: 10, online: 20 }

/** What to sort by; `null` where it is not known, which comes last either way. */
function keyOf(robot: Robot, sort: Sort, summaries: Summaries): number | string | null {
  const more = summaries.get(robot.id)
  switch (sort) {
    case 'name':
      return null
    case 'state':
      return PRESENT[robot.presence] + URGENCY[robot.state]
    case 'battery':
      return more?.battery ?? null
    case 'signal':
      return more?.rssi ?? null
    case 'range':
      return robot.range
    case 'behaviour':
      return more?.behaviour ?? null
    case 'firmware':
      return robot.firmware === '' ? null : robot.firmware
    case 'seen':
      return more?.lastSeen ?? null
  }
}

/** Robots as wanted; `byName` holds all of them sorted by name, which breaks ties. */
export function arrange(
  byName: readonly Robot[],
  wanted: Wanted,
  summaries: Summaries,
): readonly Robot[] {
  const search = wanted.search.trim().toLowerCase()
  const found = byName.filter(
    (robot) => (search === '' || robot.id.includes(search)) && passes(robot, wanted.show),
  )
  const sign = wanted.descending ? -1 : 1
  if (wanted.sort === 'name') return wanted.descending ? found.reverse() : found
  // Each key once, and the sort is stable.
  const keyed = found.map((robot) => ({ robot, key: keyOf(robot, wanted.sort, summaries) }))
  keyed.sort((a, b) => {
    if (a.key === null || b.key === null) {
      return a.key === b.key ? 0 : a.key === null ? 1 : -1
    }
    if (a.key === b.key) return 0
    return a.key < b.key ? -sign : sign
  })
  return keyed.map(({ robot }) => robot)
}
