/** What an answer comes to, as rows of tables. */

import type { CounterfactualAnswer } from '../api-types'

type Measure = CounterfactualAnswer['measures'][number]
type Robot = CounterfactualAnswer['robots'][number]

/** Where fewer robots than this share were where the simulation has them, the answer is worth little. */
export const LEAST_INSIDE = 0.8

export interface NullTest {
  robots: number
  inside: number
  /** `null` where nothing can be compared. */
  holds: boolean | null
}

export function nullTestOf({ null_test: { robots, inside } }: CounterfactualAnswer): NullTest {
  return { robots, inside, holds: robots === 0 ? null : inside / robots >= LEAST_INSIDE }
}

/** Whether the interval of a difference says which way it goes. */
export function isClear({ low, high }: Measure['difference']): boolean {
  return low > 0 || high < 0
}

export interface RobotRow {
  robot: string
  /** Metres, in the end. */
  apart: number
  /** Seconds after the moment. */
  parted: number | null
  contacts: readonly [number, number]
  inside: boolean | null
  /** From what its body is known. */
  body: Robot['body']
  certificate: string | null
  command: string | null
  /** Nobody is known to have told it so. */
  supposed: boolean
}

/** Those first whose worlds are furthest apart; of equal ones in the order of their names. */
export function robotRows(robots: readonly Robot[]): RobotRow[] {
  const order = new Intl.Collator('en', { numeric: true })
  return robots
    .map((told) => ({
      robot: told.robot,
      apart: told.apart,
      parted: told.parted_s ?? null,
      contacts: [told.contacts[0] ?? 0, told.contacts[1] ?? 0] as const,
      inside: told.inside ?? null,
      body: told.body,
      certificate: told.certificate ?? null,
      command: told.command ?? null,
      supposed: told.supposed,
    }))
    .sort((a, b) => b.apart - a.apart || order.compare(a.robot, b.robot))
}
