/**
 * One command to many robots, followed robot by robot. To all of them it is one
 * command; to a group it is one for each, sent no faster than the server takes them.
 */

import type { ShallowRef } from 'vue'
import { shallowRef } from 'vue'
import type { Command } from '../api'
import type { CommandRecord, OutcomeStatus } from '../api-types'
import { ApiError } from '../http'

export interface Step {
  robot: string
  /** `unsent`: not taken by the server, with its reason in words. */
  status: OutcomeStatus | 'waiting' | 'unsent'
  reason: string | null
}

export interface Progress {
  steps: readonly Step[]
  done: number
  failed: number
  open: number
  /** What went wrong with the whole of it. */
  error: string | null
}

/** What sending and following needs of the server; a seam for tests. */
export interface Outlet {
  toSwarm(command: Command): Promise<CommandRecord>
  toRobot(robot: string, command: Command): Promise<CommandRecord>
  command(id: string): Promise<CommandRecord>
  commands(robot: null, limit: number): Promise<readonly CommandRecord[]>
}

export type Target = { all: true } | { all: false; robots: readonly string[] }

/** The server takes 50 requests a second of one user, and steering needs some of them. */
const AT_ONCE = 6
const PACE_MS = 30
const ASK_EVERY_MS = 400
/** What one look at the newest commands gives. */
const MOST_LISTED = 500
const MOST_TRIES = 5

export const isOpen = (status: Step['status']): boolean =>
  status === 'waiting' || status === 'pending' || status === 'accepted'

/** How much there is to say about it: failures first, then what is under way. */
const WEIGHT: Readonly<Record<string, number>> = {
  waiting: 1,
  pending: 1,
  accepted: 2,
  completed: 3,
}

export function summarise(steps: readonly Step[], error: string | null = null): Progress {
  const done = steps.filter(({ status }) => status === 'completed').length
  const open = steps.filter(({ status }) => isOpen(status)).length
  const sorted = [...steps].sort(
    (a, b) => (WEIGHT[a.status] ?? 0) - (WEIGHT[b.status] ?? 0) || a.robot.localeCompare(b.robot),
  )
  return { steps: sorted, done, open, failed: steps.length - done - open, error }
}

/** Of several commands to one robot: a failure says more than what is under way, that more than success. */
function combined(robot: string, parts: readonly Step[]): Step {
  const ranked = [...parts].sort((a, b) => (WEIGHT[a.status] ?? 0) - (WEIGHT[b.status] ?? 0))
  return ranked[0] ?? { robot, status: 'waiting', reason: null }
}

export class Dispatch {
  readonly progress: ShallowRef<Progress> = shallowRef(summarise([]))
  readonly started = Date.now()
  /** What became of each command, by robot. */
  private readonly parts = new Map<string, Step[]>()
  private readonly ids = new Map<string, { robot: string; part: number }>()
  private ended = false

  /** Several commands only to a group: a robot takes so many parameters at a time. */
  constructor(
    readonly commands: readonly [Command, ...Command[]],
    readonly target: Target,
    private readonly outlet: Outlet,
    private readonly pause: (ms: number) => Promise<void> = (ms) =>
      new Promise((resolve) => setTimeout(resolve, ms)),
  ) {}

  /** Sends it, and follows it until every robot has come to an end. */
  async run(): Promise<void> {
    try {
      if (this.target.all) await this.runAll()
      else await this.runEach(this.target.robots)
    } catch (error) {
      this.show(words(error))
    }
  }

  /** Asks no more; what was sent is sent. */
  abandon(): void {
    this.ended = true
  }

  /** Robots that it did not come to a good end with. */
  get failures(): readonly string[] {
    return this.progress.value.steps
      .filter(({ status }) => !isOpen(status) && status !== 'completed')
      .map(({ robot }) => robot)
  }

  private async runAll(): Promise<void> {
    let record = await this.outlet.toSwarm(this.commands[0])
    const { id } = record
    for (;;) {
      // Losing sight of it for a moment changes nothing about it.
      record = await this.outlet.command(id).catch(() => record)
      for (const { robot, status, reason } of record.outcomes) {
        this.parts.set(robot, [{ robot, status, reason: reason ?? null }])
      }
      this.show()
      if (this.ended || !isOpen(record.status)) return
      // Outcomes of a large fleet are a large answer.
      await this.pause(ASK_EVERY_MS * Math.max(1, record.outcomes.length / 1_000))
    }
  }

  private async runEach(robots: readonly string[]): Promise<void> {
    for (const robot of robots) {
      this.parts.set(
        robot,
        this.commands.map(() => ({ robot, status: 'waiting', reason: null })),
      )
    }
    this.show()
    const queue = [...this.parts.keys()]
    const following = this.follow()
    await Promise.all(
      Array.from({ length: AT_ONCE }, async () => {
        for (;;) {
          const robot = queue.shift()
          if (robot === undefined || this.ended) return
          for (const [part, command] of this.commands.entries()) {
            await this.sendTo(robot, part, command)
            await this.pause(PACE_MS * AT_ONCE)
          }
        }
      }),
    )
    await following
  }

  private async sendTo(robot: string, part: number, command: Command): Promise<void> {
    for (let tries = 1; ; tries++) {
      try {
        const record = await this.outlet.toRobot(robot, command)
        this.ids.set(record.id, { robot, part })
        this.note(record.id, record)
        return
      } catch (error) {
        const wait = error instanceof ApiError && error.status === 429 ? (error.retryAfter ?? 1) : 0
        if (wait > 0 && tries < MOST_TRIES && !this.ended) {
          await this.pause(wait * 1_000)
          continue
        }
        const steps = this.parts.get(robot)
        if (steps !== undefined) steps[part] = { robot, status: 'unsent', reason: words(error) }
        return
      }
    }
  }

  private note(id: string, { status, reason }: Pick<CommandRecord, 'status' | 'reason'>): void {
    const of = this.ids.get(id)
    const steps = of === undefined ? undefined : this.parts.get(of.robot)
    if (of === undefined || steps === undefined) return
    steps[of.part] = { robot: of.robot, status, reason: reason ?? null }
  }

  private async follow(): Promise<void> {
    for (;;) {
      this.show()
      if (this.ended || this.progress.value.open === 0) return
      await this.pause(ASK_EVERY_MS)
      const records = await this.outlet.commands(null, MOST_LISTED).catch(() => [])
      for (const record of records) this.note(record.id, record)
      await this.lookUp(new Set(records.map(({ id }) => id)))
    }
  }

  /** Those of a large group that newer commands have pushed off the list. */
  private async lookUp(listed: ReadonlySet<string>): Promise<void> {
    const missing = [...this.ids].filter(([id, { robot, part }]) => {
      return !listed.has(id) && isOpen(this.parts.get(robot)?.[part]?.status ?? 'completed')
    })
    for (const [id] of missing.slice(0, AT_ONCE)) {
      const record = await this.outlet.command(id).catch(() => null)
      if (record !== null) this.note(id, record)
    }
  }

  private show(error: string | null = null): void {
    const steps = [...this.parts].map(([robot, parts]) => combined(robot, parts))
    this.progress.value = summarise(steps, error)
  }
}

function words(error: unknown): string {
  return error instanceof Error ? error.message : String(error)
}
