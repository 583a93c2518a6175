/** How far a rollout is, and what may be done with it, without a page. */

import type {
  Rollout,
  RolloutCounts,
  RolloutPhase,
  RolloutPhaseCounts,
  RolloutRobot,
  UpdateReason,
  UpdateState,
} from '../api-types'

/** From those that wait to those that have come to an end: the order of lists. */
export const UPDATE_STATES = [
  'waiting',
  'deferred',
  'offered',
  'preparing',
  'receiving',
  'verifying',
  'staged',
  'trial',
  'confirmed',
  'rolled_back',
  'failed',
  'skipped',
  'superseded',
  'not_applicable',
] as const satisfies readonly UpdateState[]

/** What a state comes to, for those who look from afar: in the order of bars, from done to open. */
export const GROUPS = ['confirmed', 'failed', 'left', 'trial', 'working', 'waiting'] as const
export type Group = (typeof GROUPS)[number]

const GROUP_OF: Readonly<Record<UpdateState, Group | null>> = {
  waiting: 'waiting',
  deferred: 'waiting',
  offered: 'working',
  preparing: 'working',
  receiving: 'working',
  verifying: 'working',
  staged: 'working',
  trial: 'trial',
  confirmed: 'confirmed',
  rolled_back: 'failed',
  failed: 'failed',
  skipped: 'left',
  superseded: 'left',
  not_applicable: null,
}

/** `null` for robots that it is not for, and for states of a newer server. */
export function groupOf(state: string): Group | null {
  return (GROUP_OF as Readonly<Record<string, Group | null>>)[state] ?? null
}

export type ByState = Readonly<Record<string, number>>

export function byGroup(robots: ByState): Record<Group, number> {
  const sums: Record<Group, number> = {
    waiting: 0,
    working: 0,
    trial: 0,
    confirmed: 0,
    failed: 0,
    left: 0,
  }
  for (const [state, count] of Object.entries(robots)) {
    const group = groupOf(state)
    if (group !== null) sums[group] += count
  }
  return sums
}

/** Robots that it is for, those included that it has lost to another one. */
export function members(robots: ByState): number {
  return Object.values(byGroup(robots)).reduce((sum, count) => sum + count, 0)
}

/** Robots that have come to an end by themselves. */
export function ended(robots: ByState): number {
  const { confirmed, failed } = byGroup(robots)
  return confirmed + failed
}

export type Acts = 'pause' | 'resume' | 'abort'

/** What may be done with a rollout in this state. */
export function acts({ state }: Pick<Rollout, 'state'>): readonly Acts[] {
  if (state === 'running') return ['pause', 'abort']
  return state === 'paused' ? ['resume', 'abort'] : []
}

export function isOver({ state }: Pick<Rollout, 'state'>): boolean {
  return state === 'done' || state === 'aborted'
}

/** Whether something happens without anybody's doing. */
export function isActive({ state }: Pick<Rollout, 'state'>): boolean {
  return state === 'running' || state === 'aborting'
}

export type RobotActs = 'retry' | 'skip'

/** What may be done with a robot of a rollout. */
export function robotActs(
  rollout: Pick<Rollout, 'state'>,
  { state }: Pick<RolloutRobot, 'state'>,
): readonly RobotActs[] {
  if (isOver(rollout)) return []
  if (['failed', 'rolled_back', 'skipped'].includes(state)) {
    return rollout.state === 'aborting' ? [] : ['retry']
  }
  const group = groupOf(state)
  return group === 'waiting' || group === 'working' ? ['skip'] : []
}

export type PhaseName = 'pending' | 'active' | 'soaking' | 'passed'

/** Where a phase stands, without its times. */
export function phaseName({ state }: Pick<RolloutPhaseCounts, 'state'>): PhaseName {
  if (typeof state === 'string') return state
  if ('active' in state) return 'active'
  return 'soaking' in state ? 'soaking' : 'passed'
}

/** Seconds for which a phase is still watched; `null` while it is not. */
export function soakLeft(phase: RolloutPhaseCounts, counts: RolloutCounts): number | null {
  const { state } = phase
  if (typeof state === 'string' || !('soaking' in state)) return null
  return Math.max(0, state.soaking.until_ms / 1_000 - counts.elapsed_s)
}

/** Why nobody can say how long it takes. */
export type Unknown = 'stands' | 'nobody-done' | 'away' | 'no-counts'

export type TimeLeft = { seconds: number } | { unknown: Unknown }

/** The server's defaults (`crawler_updates::rollout::Phase`). */
export const SOAK_S = 600

/** Seconds until a phase that is served has passed. */
function phaseLeft(phase: RolloutPhaseCounts, counts: RolloutCounts, soak: number): TimeLeft {
  const watched = soakLeft(phase, counts)
  if (watched !== null) return { seconds: watched }
  if (phase.left_s != null) return { seconds: phase.left_s + soak }
  const { waiting, working, trial } = byGroup(phase.robots)
  if (working + trial > 0) return { unknown: 'nobody-done' }
  if (waiting > 0) return { unknown: ended(phase.robots) > 0 ? 'away' : 'nobody-done' }
  return { seconds: soak }
}

/**
 * Seconds until the last phase has passed, as it went so far: the robots of later phases at the pace of this one, and
 * every soak. Robots that are away are not counted, so it is the least that it takes.
 */
export function timeLeft(rollout: Pick<Rollout, 'state' | 'phase' | 'plan' | 'counts'>): TimeLeft {
  if (rollout.state !== 'running') return { unknown: 'stands' }
  const counts = rollout.counts ?? null
  const at = rollout.phase - 1
  const phase = counts?.phases[at]
  if (counts === null || phase === undefined) return { unknown: 'no-counts' }
  const soak = (index: number): number => rollout.plan.phases[index]?.soak_s ?? SOAK_S
  const now = phaseLeft(phase, counts, soak(at))
  if ('unknown' in now) return now
  // That of the phase that is served, or of those before it.
  const begun = counts.phases.slice(0, at + 1).reverse()
  const pace = begun.find((one) => one.ended_per_hour > 0)?.ended_per_hour ?? 0
  let { seconds } = now
  for (const [index, later] of counts.phases.entries()) {
    if (index <= at) continue
    const { waiting } = byGroup(later.robots)
    if (waiting > 0 && pace === 0) return { unknown: 'nobody-done' }
    seconds += (waiting > 0 ? (waiting * 3_600) / pace : 0) + soak(index)
  }
  return { seconds }
}

/** What a rollout has moved by some moment. */
export interface Sample {
  /** Milliseconds. */
  at: number
  bytes: number
}

/** Younger than this, it says how fast it is now. */
const WINDOW_MS = 20_000
/** Two answers closer together say nothing. */
const LEAST_MS = 1_500

/** How fast images are on their way, as this page has seen it. */
export class Meter {
  private last: Sample | null = null
  /** What came with each answer but the first. */
  private moved: Sample[] = []

  add(sample: Sample): void {
    if (this.last !== null && sample.at <= this.last.at) return
    // A robot that begins anew has fewer bytes than before, which is no speed.
    const bytes = this.last === null ? 0 : Math.max(0, sample.bytes - this.last.bytes)
    this.last = sample
    const young = this.moved.filter(({ at }) => at >= sample.at - WINDOW_MS)
    this.moved = [...young, { at: sample.at, bytes }]
  }

  /** Bytes per second; `null` before there is enough to say so. */
  rate(): number | null {
    const [first, last] = [this.moved[0], this.moved.at(-1)]
    if (first === undefined || last === undefined || last.at - first.at < LEAST_MS) return null
    const bytes = this.moved.slice(1).reduce((sum, one) => sum + one.bytes, 0)
    return (bytes * 1_000) / (last.at - first.at)
  }

  /** Nothing that was seen counts any more. */
  clear(): void {
    this.last = null
    this.moved = []
  }
}

/** A reason in its parts: a word, and what the robot or the server has said with it. */
export function reasonOf(reason: UpdateReason | null | undefined): {
  word: string
  told: string | null
} | null {
  if (reason == null) return null
  if (typeof reason === 'string') return { word: reason, told: null }
  const [entry] = Object.entries(reason)
  if (entry === undefined) return null
  return { word: entry[0], told: typeof entry[1] === 'string' ? entry[1] : null }
}

/** Why robots have failed, the most frequent first. */
export function failuresBy(
  robots: readonly Pick<RolloutRobot, 'state' | 'reason'>[],
): { key: string; state: UpdateState; reason: UpdateReason | null; count: number }[] {
  const found = new Map<
    string,
    { key: string; state: UpdateState; reason: UpdateReason | null; count: number }
  >()
  for (const { state, reason } of robots) {
    const key = `${state} ${JSON.stringify(reason ?? null)}`
    const entry = found.get(key) ?? { key, state, reason: reason ?? null, count: 0 }
    entry.count += 1
    found.set(key, entry)
  }
  return [...found.values()].sort((a, b) => b.count - a.count || a.key.localeCompare(b.key))
}

/** What a phase selects: how, and what. */
export function selection(
  phase: Pick<RolloutPhase, 'select'>,
):
  | { by: 'share'; percent: number }
  | { by: 'group'; robots: readonly string[] }
  | { by: 'board' | 'kind'; name: string } {
  const { select } = phase
  if ('share' in select) return { by: 'share', percent: select.share }
  if ('group' in select) return { by: 'group', robots: select.group }
  if ('board' in select) return { by: 'board', name: select.board }
  return { by: 'kind', name: select.kind }
}
