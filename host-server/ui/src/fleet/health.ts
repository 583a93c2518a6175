/** Whether anything is wrong, in words. */

import type { ConnectionState } from '../feed/connection'
import type { StopState } from '../control/stop'
import { health as words } from '../strings-health'
import { linkTo } from '../view'
import type { Figures, Recent } from './openmetrics'

/** What `/readyz` answers. */
export interface Readiness {
  broker: boolean
  /** `null` where no world is simulated. */
  simulation: boolean | null
  /** `false` while commands cannot be written down, and only halts and motion are taken. */
  journal: boolean
  /** `false` while the audit log cannot be written. */
  audit: boolean
}

export type Gravity = 'good' | 'watch' | 'bad'

export interface Finding {
  gravity: 'watch' | 'bad'
  /** Stable, for tests and for keys. */
  code: string
  words: string
  /** Where to look. */
  link: string | null
}

export interface Counts {
  online: number
  stale: number
  offline: number
  error: number
  low: number
  /** On the wrong side of a fence. */
  fence: number
}

export interface Signs {
  connection: ConnectionState
  /** Seconds since the server was last heard. */
  age: number
  /** `null` until it is known. */
  readiness: Readiness | null
  stop: StopState
  counts: Counts
  figures: Figures | null
  recent: Recent | null
}

/** Free space below which the records are in danger, bytes. */
const LITTLE_SPACE = 1e9
const NO_SPACE = 1e8
/** Fewer commands than that say nothing about success. */
const FEW_COMMANDS = 5
const GOOD_SHARE = 0.9
const MANY_QUEUED = 100_000

/** What is wrong, the worst first. */
export function findings(signs: Signs): Finding[] {
  const found: Finding[] = []
  const add = (
    gravity: Finding['gravity'],
    code: string,
    text: string,
    link: string | null = null,
  ) => found.push({ gravity, code, words: text, link })
  const robots = (show: string): string => linkTo('robots', { show })

  if (signs.connection === 'waiting') add('bad', 'link', words.noLink(signs.age))
  if (signs.connection === 'silent') add('bad', 'silent', words.silent(signs.age))
  if (signs.readiness?.broker === false) add('bad', 'broker', words.noBroker)
  if (signs.readiness?.simulation === false) {
    add('bad', 'simulation', words.noSimulation, linkTo('simulation'))
  }
  if (signs.readiness?.journal === false) add('bad', 'journal', words.noJournal)
  if (signs.readiness?.audit === false) add('bad', 'audit', words.noAudit)
  const { counts, figures } = signs
  const all = counts.online + counts.stale + counts.offline
  const stopped = signs.stop !== 'armed'
  if (stopped) add('watch', 'stop', words.stopped)
  // A stop shows as every robot reporting an error; that is said already.
  if (counts.error > 0 && !stopped) add('bad', 'error', words.error(counts.error), robots('error'))
  if (all === 0) add('watch', 'empty', words.empty)
  else if (counts.online === 0) add('bad', 'none', words.noneOnline, robots('offline'))
  if (counts.stale > 0) add('watch', 'stale', words.stale(counts.stale), robots('stale'))
  if (counts.offline > 0 && counts.online > 0) {
    add('watch', 'offline', words.offline(counts.offline), robots('offline'))
  }
  if (counts.fence > 0) add('watch', 'fence', words.fence(counts.fence), robots('fence'))
  if (counts.low > 0) add('watch', 'low', words.low(counts.low), robots('low'))
  if (figures !== null) {
    const { duplicates, database } = figures
    if (duplicates > 0) add('bad', 'twins', words.twins(duplicates))
    if (database.free !== null && database.free < LITTLE_SPACE) {
      add(database.free < NO_SPACE ? 'bad' : 'watch', 'space', words.space(database.free))
    }
    if (database.dropped > 0) add('watch', 'dropped', words.dropped(database.dropped))
    if (database.damaged > 0) add('watch', 'damaged', words.damaged(database.damaged))
    if (database.queued > MANY_QUEUED) add('watch', 'queued', words.queued(database.queued))
  }
  const { recent } = signs
  if (recent !== null && recent.answered >= FEW_COMMANDS) {
    const share = recent.completed / recent.answered
    if (share < GOOD_SHARE) add('watch', 'commands', words.commands(share), linkTo('command'))
  }
  return found.sort((a, b) => Number(a.gravity === 'watch') - Number(b.gravity === 'watch'))
}

export interface Verdict {
  gravity: Gravity
  /** A few words for the badge. */
  words: string
}

export function verdict(found: readonly Finding[], connection: ConnectionState): Verdict {
  if (connection === 'connecting') return { gravity: 'watch', words: words.asking }
  const [worst] = found
  if (worst === undefined) return { gravity: 'good', words: words.good }
  if (found.length === 1)
    return { gravity: worst.gravity, words: words.single[worst.code] ?? worst.words }
  return { gravity: worst.gravity, words: words.several(found.length) }
}

export type Mode = 'none' | 'simulation' | 'physical' | 'hybrid'

/** What kind of fleet it is: emulated robots have no body either. */
export function modeOf(kinds: { simulated: number; emulated: number; physical: number }): Mode {
  const virtual = kinds.simulated + kinds.emulated
  if (virtual === 0 && kinds.physical === 0) return 'none'
  if (kinds.physical === 0) return 'simulation'
  return virtual === 0 ? 'physical' : 'hybrid'
}
