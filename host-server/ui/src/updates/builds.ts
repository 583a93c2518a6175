/** What each robot runs. */

import type { Release, RobotBody } from '../api-types'

/** A robot, and the program that it runs as far as anybody knows. */
export interface Running {
  robot: string
  board: string
  kind: string
  presence: string
  /** As the robot says. */
  firmware: string
  /** `null` from robots before updates. */
  build: string | null
  models: readonly (readonly [string, string])[]
}

/** By name. */
export function runningOf(robots: readonly RobotBody[]): Running[] {
  const sorted = [...robots].sort((a, b) => a.id.localeCompare(b.id, 'en', { numeric: true }))
  return sorted.map((robot) => ({
    robot: robot.id,
    board: robot.board ?? '',
    kind: robot.kind ?? '',
    presence: robot.presence,
    firmware: robot.firmware ?? '',
    build: robot.build ?? null,
    models: Object.entries(robot.models),
  }))
}

type Known = Pick<Release, 'id' | 'kind' | 'board' | 'build' | 'version' | 'sequence'>

/** The newest release of a build for a board, where the server has one. */
export function releaseOf<R extends Known>(
  { board, build }: Pick<Running, 'board' | 'build'>,
  releases: readonly R[],
): R | null {
  if (build === null) return null
  return releases.reduce<R | null>((best, one) => {
    const same = one.kind === 'program' && one.board === board && one.build === build
    return same && (best === null || one.sequence > best.sequence) ? one : best
  }, null)
}

/** How many robots run a build on a board. */
export interface BuildCount {
  key: string
  board: string
  build: string | null
  /** Versions that robots of this build tell, most of them one. */
  firmware: readonly string[]
  robots: number
}

/** Boards by name, and the most frequent build of each first. */
export function countBuilds(running: readonly Running[]): BuildCount[] {
  const found = new Map<string, { count: BuildCount; firmware: Set<string> }>()
  for (const { board, build, firmware } of running) {
    const key = buildKey({ board, build })
    const entry = found.get(key) ?? {
      count: { key, board, build, firmware: [], robots: 0 },
      firmware: new Set<string>(),
    }
    entry.count.robots += 1
    if (firmware !== '') entry.firmware.add(firmware)
    found.set(key, entry)
  }
  const counts = [...found.values()].map(({ count, firmware }) => ({
    ...count,
    firmware: [...firmware].sort(),
  }))
  return counts.sort(
    (a, b) => a.board.localeCompare(b.board) || b.robots - a.robots || a.key.localeCompare(b.key),
  )
}

/** A build of a board, as one word of an address. */
export function buildKey({ board, build }: Pick<Running, 'board' | 'build'>): string {
  return `${board}:${build ?? ''}`
}

/** Those of a build, or all, whose name has these letters. */
export function choose(
  running: readonly Running[],
  { build, search }: { build: string; search: string },
): Running[] {
  const wanted = search.trim().toLowerCase()
  return running.filter(
    (one) =>
      (build === '' || buildKey(one) === build) &&
      (wanted === '' || one.robot.toLowerCase().includes(wanted)),
  )
}
