/** How far bodies and robots are apart, as rows of a table: the worst first. */

import type { FleetGapBody } from '../api-types'

type Measures = FleetGapBody['fleet']
type Robot = FleetGapBody['robots'][number]

/** A figure with its floor: what a perfect copy would show. */
export interface Figure {
  own: number
  nominal: number
  floor: number
}

export interface GapRow {
  /** `null` for all robots together. */
  robot: string | null
  /** Id of the certificate; `null` for the nominal body. */
  certificate: string | null
  since: number | null
  /** Median errors of predictions, metres, the nearest first; `null` where there are too few. */
  errors: readonly (Figure | null)[]
  /** Of the furthest: share of the nominal body's, and within the region of 95 %. */
  ratio: number | null
  within: number | null
  /** Energy distance of displacements, metres. */
  displacements: Figure | null
  /** How many predictions each error rests on. */
  counts: readonly number[]
}

function row(measures: Measures, of: Robot | null): GapRow {
  const last = measures.errors.at(-1)
  const { own, nominal, floor } = measures.displacements
  return {
    robot: of?.robot ?? null,
    certificate: of?.certificate ?? null,
    since: of?.since ?? null,
    errors: measures.errors.map((errors) =>
      errors.own == null || errors.nominal == null || errors.floor == null
        ? null
        : {
            own: errors.own.median,
            nominal: errors.nominal.median,
            floor: errors.floor.median,
          },
    ),
    ratio: last?.ratio ?? null,
    within: last?.coverage?.within_95 ?? null,
    displacements: own == null || nominal == null || floor == null ? null : { own, nominal, floor },
    counts: measures.errors.map(({ count }) => count),
  }
}

/** Smaller floors are as good as this one, metres. */
const LEAST_FLOOR = 1e-4

/** How many times the floor the furthest error is that there is. */
function above({ errors }: GapRow): number {
  const known = [...errors].reverse().find((figure) => figure !== null)
  return known == null ? -1 : known.own / Math.max(known.floor, LEAST_FLOOR)
}

/** All robots together, and then each: the worst first, and last those that have driven too little. */
export function gapRows({ fleet, robots }: FleetGapBody): readonly [GapRow, ...GapRow[]] {
  const each = robots.map((robot) => row(robot.measures, robot))
  return [row(fleet, null), ...each.sort((a, b) => above(b) - above(a))]
}
