/** What is written into the form of a new rollout, checked before it is sent. */

import type { NewRollout, Release, RolloutPhase } from '../api-types'
import { isReason } from './releases'

export const SELECTS = ['share', 'group', 'board', 'kind'] as const
export type Select = (typeof SELECTS)[number]
export const ROBOT_KINDS = ['simulated', 'emulated', 'physical'] as const

export interface PhaseDraft {
  /** For lists on the page: phases are put in and taken out. */
  key: number
  by: Select
  /** Percent, names of robots, a board or a kind. */
  of: string
  soak: string
  success: string
  stop: string
  /** Robots that must have come to an end before it passes, or stops the rollout. */
  least: string
}

/** Fields of a phase, in the order of the form. */
export const PHASE_FIELDS = ['of', 'soak', 'success', 'stop', 'least'] as const
type OfPhase = (typeof PHASE_FIELDS)[number]

export interface Draft {
  /** Ids of the releases. */
  releases: string[]
  phases: PhaseDraft[]
  parallel: string
  /** KiB per second; empty for no limit. */
  rate: string
  /** How long robots that are away are waited for; empty for good. */
  wait: string
  /** Times of day, both empty for any time. */
  from: string
  to: string
  /** Why releases without a gate that has passed go out; empty where they are not to. */
  gate: string
}

/** Fields of the whole form; those of phases are `phase-KEY-FIELD`. */
export type Field =
  'releases' | 'phases' | 'parallel' | 'rate' | 'wait' | 'from' | 'to' | 'gate' | PhaseField
export type PhaseField = `phase-${number}-${OfPhase}`

/** What is wrong with a field; words for it are elsewhere. */
export type Wrong =
  | {
      why:
        | 'none'
        | 'duration'
        | 'time'
        | 'half'
        | 'never'
        | 'robots'
        | 'board'
        | 'kind'
        | 'many'
        | 'long'
    }
  | { why: 'whole'; least: number; most: number }
  | { why: 'overlap'; board: string }
  | { why: 'share'; above: number }
export type Wrongs = Partial<Record<Field, Wrong>>

/** As `crawler_updates::rollout::check` has them. */
export const MOST_PHASES = 32
const MOST_RELEASES = 32
const MOST_ROBOTS = 20_000
const LEAST_KIB = 16
const MOST_KIB = 4_194_303
const MOST_SECONDS = 90 * 24 * 3_600
const ROBOT = /^[a-z0-9-]{1,32}$/
const TIME = /^([01]\d|2[0-3]):[0-5]\d$/

const USUAL_SOAK = '10 min'
/** A program that has run here before is watched for less. */
const BACK_SOAK_S = 60

export function newPhase(key: number, of: string, by: Select = 'share'): PhaseDraft {
  return { key, by, of, soak: USUAL_SOAK, success: '95', stop: '5', least: '1' }
}

/** A tenth of the robots first, and then all. */
export function usual(releases: readonly string[] = []): Draft {
  return {
    releases: [...releases],
    phases: [newPhase(1, '10'), newPhase(2, '100')],
    parallel: '50',
    rate: '',
    wait: '',
    from: '',
    to: '',
    gate: '',
  }
}

const UNITS: Readonly<Record<string, number>> = { s: 1, min: 60, h: 3_600, d: 86_400 }

/** Seconds in `90 s`, `10 min`, `2 h`, `1 d`; `null` for anything else. */
export function seconds(text: string): number | null {
  const [, number = '', unit = ''] = /^(\d{1,8})\s*(s|min|h|d)$/.exec(text.trim()) ?? []
  const value = Number(number) * (UNITS[unit] ?? Number.NaN)
  return number !== '' && value <= MOST_SECONDS ? value : null
}

/** Names in a text, whatever stands between them. */
export function names(text: string): string[] {
  return text.split(/[\s,;]+/).filter((name) => name !== '')
}

type Offered = Pick<Release, 'id' | 'board'>

/** `offered` are the releases that the form shows. */
export function check(draft: Draft, offered: readonly Offered[]): Wrongs {
  const wrongs: Wrongs = {}
  const put = (field: Field, wrong: Wrong | null): void => {
    if (wrong !== null) wrongs[field] ??= wrong
  }
  put('releases', releases(draft.releases, offered))
  if (draft.phases.length === 0) put('phases', { why: 'none' })
  let above = 0
  for (const phase of draft.phases) {
    const at = (name: OfPhase): PhaseField => `phase-${phase.key}-${name}`
    put(at('of'), selected(phase, above))
    if (phase.by === 'share') above = Math.max(above, Number(phase.of) || 0)
    put(at('soak'), seconds(phase.soak) === null ? { why: 'duration' } : null)
    put(at('success'), whole(phase.success, 1, 100))
    put(at('stop'), whole(phase.stop, 1, 100))
    put(at('least'), whole(phase.least, 1, MOST_ROBOTS))
  }
  put('parallel', whole(draft.parallel, 1, MOST_ROBOTS))
  put('rate', draft.rate.trim() === '' ? null : whole(draft.rate, LEAST_KIB, MOST_KIB))
  const waits = draft.wait.trim() === '' || seconds(draft.wait) !== null
  put('wait', waits ? null : { why: 'duration' })
  const [from, to] = [draft.from.trim(), draft.to.trim()]
  if (from !== '' || to !== '') {
    put('from', TIME.test(from) ? null : { why: from === '' ? 'half' : 'time' })
    put('to', TIME.test(to) ? null : { why: to === '' ? 'half' : 'time' })
    put('to', from === to ? { why: 'never' } : null)
  }
  put('gate', draft.gate.trim() === '' || isReason(draft.gate) ? null : { why: 'long' })
  return wrongs
}

function releases(ids: readonly string[], offered: readonly Offered[]): Wrong | null {
  if (ids.length === 0) return { why: 'none' }
  if (ids.length > MOST_RELEASES) return { why: 'many' }
  const boards = new Set<string>()
  for (const { board } of offered.filter(({ id }) => ids.includes(id))) {
    if (boards.has(board)) return { why: 'overlap', board }
    boards.add(board)
  }
  return null
}

function selected({ by, of }: PhaseDraft, above: number): Wrong | null {
  switch (by) {
    case 'share':
      return whole(of, 1, 100) ?? (Number(of) > above ? null : { why: 'share', above })
    case 'group': {
      const listed = names(of)
      const good = listed.every((name) => ROBOT.test(name))
      return listed.length > 0 && good && listed.length <= MOST_ROBOTS ? null : { why: 'robots' }
    }
    case 'board':
      return of.trim() === '' ? { why: 'board' } : null
    case 'kind':
      return (ROBOT_KINDS as readonly string[]).includes(of) ? null : { why: 'kind' }
  }
}

function whole(text: string, least: number, most: number): Wrong | null {
  const value = /^\d{1,9}$/.test(text.trim()) ? Number(text) : Number.NaN
  return value >= least && value <= most ? null : { why: 'whole', least, most }
}

/** The first field with something wrong, in the order of the form. */
export function firstWrong(draft: Draft, wrongs: Partial<Record<Field, unknown>>): Field | null {
  const phases = draft.phases.flatMap(({ key }) =>
    PHASE_FIELDS.map((name): Field => `phase-${key}-${name}`),
  )
  const all: readonly Field[] = [
    'releases',
    'phases',
    ...phases,
    'parallel',
    'rate',
    'wait',
    'from',
    'to',
    'gate',
  ]
  return all.find((field) => wrongs[field] !== undefined) ?? null
}

function select({ by, of }: PhaseDraft): RolloutPhase['select'] {
  switch (by) {
    case 'share':
      return { share: Number(of) }
    case 'group':
      return { group: [...new Set(names(of))] }
    case 'board':
      return { board: of.trim() }
    case 'kind':
      return { kind: of }
  }
}

/** What is sent; only of a draft with nothing wrong. `offset` is that of the clock on the wall, in minutes. */
export function bodyOf(draft: Draft, offset: number): NewRollout {
  const [rate, wait] = [draft.rate.trim(), seconds(draft.wait)]
  const [from, to] = [draft.from.trim(), draft.to.trim()]
  return {
    releases: draft.releases.map((release) => ({ release })),
    phases: draft.phases.map((phase) => ({
      select: select(phase),
      soak_s: seconds(phase.soak) ?? 0,
      success_percent: Number(phase.success),
      min_count: Number(phase.least),
      stop_percent: Number(phase.stop),
      stop_min_count: Number(phase.least),
    })),
    limits: {
      parallel: Number(draft.parallel),
      bytes_per_second: rate === '' ? null : Number(rate) * 1_024,
      wait_s: wait,
    },
    ...(from === '' || to === '' ? {} : { window: { from, to, offset_minutes: offset } }),
    ...(draft.gate.trim() === '' ? {} : { override_gate: draft.gate.trim() }),
  }
}

/** How far the clock on the wall is ahead of UTC, in minutes. */
export function offsetMinutes(now = new Date()): number {
  return 0 - now.getTimezoneOffset()
}

/** A tenth of the robots first, then all, to a program that has run here before. */
export function backPlan(release: string): NewRollout {
  return {
    releases: [{ release }],
    phases: [10, 100].map((share) => ({ select: { share }, soak_s: BACK_SOAK_S })),
  }
}
