/** What is asked of the past, as a form has it. */

import type { NewCounterfactual } from '../api-types'
import type { Command } from '../api'
import { asRequest } from '../api'

export const SECONDS = [10, 20, 30, 60] as const
export const DRAWS = [10, 20, 50, 200] as const

export interface Question {
  /** The moment, Unix milliseconds. */
  at: number
  seconds: (typeof SECONDS)[number]
  draws: (typeof DRAWS)[number]
  /** `null` for all robots. */
  robot: string | null
}

export function bodyOf(question: Question, command: Command): NewCounterfactual {
  const { at, seconds, draws, robot } = question
  return {
    at: Math.round(at),
    seconds,
    draws,
    robots: robot === null ? null : [robot],
    command: asRequest(command),
  }
}
