/**
 * Driving one robot by hand, with a dead man's handle: the robot moves only
 * while something is held. Every release, whatever its cause, sends a `stop`;
 * behind it stands the robot's own failsafe of 500 ms.
 */

import type { Command } from '../api'

export type Direction = 'forward' | 'backward' | 'left' | 'right'

export const DIRECTIONS: readonly Direction[] = ['forward', 'backward', 'left', 'right']

/** Time between two `drive` commands while something is held. */
export const REPEAT_MS = 150
/** Speeds at full slider. */
export const FULL_SPEED_M_PER_S = 0.5
export const FULL_TURN_RAD_PER_S = 2.5

interface Twist {
  v: number
  w: number
}

/** How far something is pushed, −1 to 1: ahead, and to the left. */
export interface Push {
  ahead: number
  left: number
}

const PUSHES: Readonly<Record<Direction, Push>> = {
  forward: { ahead: 1, left: 0 },
  backward: { ahead: -1, left: 0 },
  left: { ahead: 0, left: 1 },
  right: { ahead: 0, left: -1 },
}
/** A stick that moved less than this since it was last told can wait for the next turn. */
const STICK_GRAIN = 0.08
/** `drive` commands on their way at a time, at most. */
const MOST_IN_FLIGHT = 2

interface DriverOptions {
  /** Sends a command to a robot; rejects when the server does not take it. */
  send(robot: string, command: Command): Promise<unknown>
  /** A command was not taken. */
  onFailure(robot: string, command: Command, error: unknown): void
  /** The set of held directions, or the target, has changed. */
  onChange(): void
}

export class Driver {
  private robot: string | null = null
  private blockedBy: string | null = 'no-robot'
  private speed = 0.5
  /** What holds which direction: a key or a finger, by name. */
  private readonly held = new Map<string, Direction>()
  /** Sticks that are pushed, by name. */
  private readonly sticks = new Map<string, Push>()
  private told: Push = { ahead: 0, left: 0 }
  private timer: ReturnType<typeof setInterval> | null = null
  private drivesInFlight = 0
  /** Something was to be told while the last command was still on its way. */
  private overdue = false
  /** Rises with every release, so that a late `drive` can be told from a current one. */
  private turn = 0

  constructor(private readonly options: DriverOptions) {}

  get target(): string | null {
    return this.robot
  }

  get driving(): boolean {
    return this.timer !== null
  }

  /** Rises with every stop, so that whoever held on can tell. */
  get stops(): number {
    return this.turn
  }

  /** Directions now held, each once. */
  get directions(): ReadonlySet<Direction> {
    return new Set(this.held.values())
  }

  /** Chooses the robot to drive; the one driven until now is stopped. */
  setTarget(robot: string | null): void {
    if (robot === this.robot) return
    this.releaseAll()
    this.robot = robot
    this.options.onChange()
  }

  /** A reason why nothing may be driven now, or null; a reason stops the robot. */
  setBlocked(reason: string | null): void {
    this.blockedBy = reason
    if (reason !== null) this.releaseAll()
  }

  /** Share of full speed, 0 to 1. */
  setSpeed(share: number): void {
    this.speed = Math.min(1, Math.max(0, share))
  }

  /**
   * Something now holds a direction. False when driving is not possible.
   * Whatever was held before a release must be pressed anew.
   */
  hold(source: string, direction: Direction): boolean {
    if (this.robot === null || this.blockedBy !== null) return false
    if (this.held.get(source) === direction) return true
    this.held.set(source, direction)
    this.timer ??= setInterval(() => this.tick(), REPEAT_MS)
    this.options.onChange()
    this.tick(true)
    return true
  }

  /** A stick is pushed so far. False when driving is not possible. */
  push(source: string, push: Push): boolean {
    if (this.robot === null || this.blockedBy !== null) return false
    const first = !this.sticks.has(source)
    this.sticks.set(source, push)
    this.timer ??= setInterval(() => this.tick(), REPEAT_MS)
    if (first) this.options.onChange()
    const far = Math.abs(push.ahead - this.told.ahead) + Math.abs(push.left - this.told.left)
    if (first || far > STICK_GRAIN) this.tick(true)
    return true
  }

  release(source: string): void {
    if (!this.held.delete(source) && !this.sticks.delete(source)) return
    if (this.held.size + this.sticks.size === 0) this.halt()
    else this.tick(true)
    this.options.onChange()
  }

  /** Dead man: nothing is held any more. */
  releaseAll(): void {
    if (this.held.size + this.sticks.size === 0) return
    this.held.clear()
    this.sticks.clear()
    this.halt()
    this.options.onChange()
  }

  /** What is held and pushed asks for. Left is a positive turn. */
  twist(): Twist {
    const { ahead, left } = this.pushed()
    return {
      v: round(ahead * this.speed * FULL_SPEED_M_PER_S),
      w: round(left * this.speed * FULL_TURN_RAD_PER_S),
    }
  }

  private pushed(): Push {
    let [ahead, left] = [0, 0]
    for (const push of [...[...this.directions].map((d) => PUSHES[d]), ...this.sticks.values()]) {
      ahead += push.ahead
      left += push.left
    }
    const cut = (value: number): number => Math.min(1, Math.max(-1, value))
    return { ahead: cut(ahead), left: cut(left) }
  }

  private tick(fresh = false): void {
    const robot = this.robot
    if (robot === null) return
    // On a slow network commands must not pile up and play out later. What a hand did just now
    // does not wait for the answer to what came before, though.
    if (this.drivesInFlight >= (fresh ? MOST_IN_FLIGHT : 1)) {
      this.overdue = true
      return
    }
    this.overdue = false
    const turn = this.turn
    this.told = this.pushed()
    const command: Command = { command: 'drive', parameters: { ...this.twist() } }
    this.drivesInFlight += 1
    this.options
      .send(robot, command)
      .catch((error: unknown) => this.options.onFailure(robot, command, error))
      .finally(() => {
        this.drivesInFlight -= 1
        // What was asked for meanwhile waits no longer than it must.
        if (this.overdue && this.driving) this.tick()
        // It may have overtaken the stop on the way, so the stop goes out again.
        if (turn !== this.turn && (!this.driving || this.robot !== robot)) this.sendStop(robot)
      })
  }

  private halt(): void {
    if (this.timer !== null) clearInterval(this.timer)
    this.timer = null
    this.turn += 1
    if (this.robot !== null) this.sendStop(this.robot)
  }

  private sendStop(robot: string): void {
    const command: Command = { command: 'stop' }
    this.options
      .send(robot, command)
      .catch((error: unknown) => this.options.onFailure(robot, command, error))
  }
}

function round(value: number): number {
  // Adding zero turns −0 into 0.
  return Math.round(value * 1_000) / 1_000 + 0
}
