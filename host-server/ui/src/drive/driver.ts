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

export interface Twist {
  v: number
  w: number
}

export interface DriverOptions {
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
  private timer: ReturnType<typeof setInterval> | null = null
  private driveInFlight = false
  /** Rises with every release, so that a late `drive` can be told from a current one. */
  private turn = 0

  constructor(private readonly options: DriverOptions) {}

  get target(): string | null {
    return this.robot
  }

  get driving(): boolean {
    return this.timer !== null
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
    this.tick()
    return true
  }

  release(source: string): void {
    if (!this.held.delete(source)) return
    if (this.held.size === 0) this.halt()
    else this.tick()
    this.options.onChange()
  }

  /** Dead man: nothing is held any more. */
  releaseAll(): void {
    if (this.held.size === 0) return
    this.held.clear()
    this.halt()
    this.options.onChange()
  }

  /** What the held directions ask for. Left is a positive turn. */
  twist(): Twist {
    const directions = this.directions
    const ahead = Number(directions.has('forward')) - Number(directions.has('backward'))
    const aside = Number(directions.has('left')) - Number(directions.has('right'))
    return {
      v: round(ahead * this.speed * FULL_SPEED_M_PER_S),
      w: round(aside * this.speed * FULL_TURN_RAD_PER_S),
    }
  }

  private tick(): void {
    const robot = this.robot
    // One at a time: on a slow network commands must not pile up and play out later.
    if (robot === null || this.driveInFlight) return
    const turn = this.turn
    const command: Command = { command: 'drive', parameters: { ...this.twist() } }
    this.driveInFlight = true
    this.options
      .send(robot, command)
      .catch((error: unknown) => this.options.onFailure(robot, command, error))
      .finally(() => {
        this.driveInFlight = false
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
