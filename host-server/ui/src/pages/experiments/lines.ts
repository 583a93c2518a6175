/** How lines of a chart are told apart: by colour, by pattern, and by a letter at the end. */

import type { Curve } from '../../experiments/trials'

export interface Line extends Curve {
  label: string
  letter: string | null
  /** Which of the colours and patterns. */
  style: number
  /** Not a curve itself, but how sure it is. */
  thin: boolean
}

/** Custom properties of the theme. */
export const TONES = ['--accent', '--state-avoiding', '--state-scanning', '--state-moving'] as const
export const DASHES = [[], [9, 4], [2, 3], [12, 3, 2, 3]] as const

/** Place of the last value that is one; −1 without any. */
export function lastOf(y: readonly (number | null)[]): number {
  let at = y.length - 1
  while (at >= 0 && y[at] === null) at -= 1
  return at
}
