/** Several robots to calibrate: each as soon as it is clear of those that drive. */

import type { ShallowRef } from 'vue'
import { shallowRef } from 'vue'
import { trouble } from '../account/trouble'
import type { CalibrationBody } from '../api-types'
import { ApiError } from '../http'
import type { TwinApi } from './api'

export interface Turn {
  readonly robot: string
  /** What was asked for; `null` while it waits for its turn. */
  readonly calibration: CalibrationBody | null
  /** Why it has no turn. */
  readonly error: string | null
}

type Api = Pick<TwinApi, 'calibrations' | 'calibrate' | 'stopCalibration'>

/** How often it is looked, milliseconds. */
export const LOOK_MS = 1_000
/** What is over when those that drive are done. */
const PASSING = ['busy', 'near_calibration', 'too_many', 'near_robot']

function waits(problem: unknown): boolean {
  if (!(problem instanceof ApiError) || problem.code !== 'not_permitted') return false
  return PASSING.some((name) => problem.detail?.startsWith(`${name}: `) === true)
}

const isOpen = ({ calibration, error }: Turn): boolean =>
  error === null && calibration?.ended == null

export class Queue {
  readonly turns: ShallowRef<readonly Turn[]>
  #timer: ReturnType<typeof setTimeout> | null = null
  #stopped = false

  constructor(
    robots: readonly string[],
    private readonly api: Api,
    private readonly floor: string,
  ) {
    this.turns = shallowRef(robots.map((robot) => ({ robot, calibration: null, error: null })))
  }

  get isOver(): boolean {
    return !this.turns.value.some(isOpen)
  }

  /** Begins what may begin, looks at what goes on, and again in a while. */
  async look(): Promise<void> {
    for (const turn of this.turns.value) {
      if (this.#stopped) return
      if (isOpen(turn)) this.#put(await this.#bring(turn))
    }
    if (!this.#stopped && !this.isOver) this.#timer = setTimeout(() => void this.look(), LOOK_MS)
  }

  /** Nobody looks any more. What drives goes on. */
  leave(): void {
    this.#stopped = true
    if (this.#timer !== null) clearTimeout(this.#timer)
  }

  /** Whoever waits has no turn any more, and whoever drives is stopped. */
  async stop(why: string): Promise<void> {
    this.leave()
    const open = this.turns.value.filter(isOpen)
    const waiting = open.filter(({ calibration }) => calibration === null)
    for (const turn of waiting) this.#put({ ...turn, error: why })
    await Promise.allSettled(
      open.map(async ({ robot, calibration }) => {
        if (calibration !== null) await this.api.stopCalibration(robot, calibration.number)
      }),
    )
    for (const turn of open) {
      if (turn.calibration !== null) this.#put(await this.#bring(turn))
    }
  }

  async #bring(turn: Turn): Promise<Turn> {
    const { robot } = turn
    try {
      if (turn.calibration === null) {
        const asked = { confirmed: true as const, floor: this.floor }
        return { ...turn, calibration: await this.api.calibrate(robot, asked) }
      }
      const { number } = turn.calibration
      const { calibrations } = await this.api.calibrations(robot)
      const now = calibrations.find((one) => one.number === number)
      return { ...turn, calibration: now ?? turn.calibration }
    } catch (problem) {
      // Of what was begun another look may say more.
      if (turn.calibration !== null || waits(problem)) return turn
      return { ...turn, error: trouble(problem) }
    }
  }

  #put(turn: Turn): void {
    this.turns.value = this.turns.value.map((one) => (one.robot === turn.robot ? turn : one))
  }
}
