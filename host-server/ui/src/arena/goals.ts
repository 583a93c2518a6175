/** Sending robots to a point, and what became of it. */

import type { ShallowRef } from 'vue'
import { shallowRef } from 'vue'
import type { Api } from '../api'
import type { Placed } from './spread'

type GoalState =
  /** On its way to the server. */
  | 'sending'
  /** The server has it; the robot is told or on its way. */
  | 'going'
  | 'reached'
  | 'failed'

export interface Goal {
  readonly robot: string
  readonly x: number
  readonly y: number
  readonly state: GoalState
  /** Why it failed, in words. */
  readonly why: string | null
}

interface GoalsOptions {
  api: Pick<Api, 'commandRobot' | 'outcome'>
  /** Words for a goal that was not reached. */
  words(status: string, reason: string | null): string
  onEnd(goal: Goal): void
  now?: () => number
}

interface Followed {
  goal: Goal
  command: string | null
  since: number
  /** When its end is no longer shown. */
  until: number
}

/** Time between two looks at what became of goals. */
export const ASK_EVERY_MS = 500
/** Goals asked about at a time, in turns: many goals must not become many requests. */
const MOST_ASKED = 12
/** Goals given at a time. */
const MOST_SENT = 8
/** How long an end is shown. */
const SHOW_REACHED_MS = 2_500
const SHOW_FAILED_MS = 8_000
/** A goal that nobody knows the end of is forgotten after so long. */
const FORGET_MS = 15 * 60_000

export class Goals {
  /** What is on its way, and for a moment what ended; another list after every change. */
  readonly list: ShallowRef<readonly Goal[]> = shallowRef([])
  private readonly followed = new Map<string, Followed>()
  private readonly now: () => number
  private next = 0
  private asking = false

  constructor(private readonly options: GoalsOptions) {
    this.now = options.now ?? (() => performance.now())
  }

  /** Sends each robot to its place; resolves when the server has taken or refused all. */
  async send(places: readonly Placed[]): Promise<void> {
    const entries = places.map(({ id, x, y }) => {
      const entry: Followed = {
        goal: { robot: id, x, y, state: 'sending', why: null },
        command: null,
        since: this.now(),
        until: Infinity,
      }
      this.followed.set(id, entry)
      return entry
    })
    this.show()
    const queue = [...entries]
    const work = async (): Promise<void> => {
      for (let entry = queue.shift(); entry !== undefined; entry = queue.shift()) {
        await this.give(entry)
      }
    }
    await Promise.all(Array.from({ length: Math.min(MOST_SENT, queue.length) }, work))
  }

  /** Looks at what became of some of them; call every {@link ASK_EVERY_MS}. */
  async ask(): Promise<void> {
    this.forget()
    if (this.asking) return
    const open = [...this.followed.values()].filter(({ goal }) => goal.state === 'going')
    if (open.length === 0) return
    this.asking = true
    const count = Math.min(MOST_ASKED, open.length)
    const turn = Array.from({ length: count }, (_, i) => open[(this.next + i) % open.length])
    this.next += count
    await Promise.all(turn.map((entry) => (entry === undefined ? null : this.look(entry))))
    this.asking = false
  }

  /** Takes the marker of a robot away; the robot is not told anything. */
  drop(robot: string): void {
    if (this.followed.delete(robot)) this.show()
  }

  private async give(entry: Followed): Promise<void> {
    const { robot, x, y } = entry.goal
    try {
      entry.command = await this.options.api.commandRobot(robot, {
        command: 'goto',
        parameters: { x, y },
      })
      this.change(entry, 'going', null)
    } catch (error) {
      this.change(entry, 'failed', error instanceof Error ? error.message : String(error))
    }
  }

  private async look(entry: Followed): Promise<void> {
    if (entry.command === null) return
    const outcome = await this.options.api.outcome(entry.command).catch(() => null)
    // An answer that is lost is asked for again.
    if (outcome === null || outcome.status === null) return
    if (outcome.status === 'pending' || outcome.status === 'accepted') return
    if (outcome.status === 'completed') this.change(entry, 'reached', null)
    else this.change(entry, 'failed', this.options.words(outcome.status, outcome.reason))
  }

  private change(entry: Followed, state: GoalState, why: string | null): void {
    entry.goal = { ...entry.goal, state, why }
    if (state === 'reached') entry.until = this.now() + SHOW_REACHED_MS
    if (state === 'failed') entry.until = this.now() + SHOW_FAILED_MS
    // A newer goal of the same robot has taken its place; then nobody waits for this one.
    if (this.followed.get(entry.goal.robot) !== entry) return
    if (state === 'reached' || state === 'failed') this.options.onEnd(entry.goal)
    this.show()
  }

  private forget(): void {
    let changed = false
    for (const [robot, entry] of this.followed) {
      if (this.now() < entry.until && this.now() - entry.since < FORGET_MS) continue
      this.followed.delete(robot)
      changed = true
    }
    if (changed) this.show()
  }

  private show(): void {
    this.list.value = [...this.followed.values()].map(({ goal }) => goal)
  }
}
