/** Both worlds of an answer, in the form in which the record is shown. */

import type { CounterfactualAnswer } from '../api-types'
import type { Window } from '../history/address'
import type { Recorded, Track } from '../history/record'
import { Unreadable, readGround, stateCodes } from '../history/record'
import { KINDS } from '../feed/decode'

export const WORLDS = ['was', 'would'] as const
/** As it was, by the simulation; and with the change. */
export type World = (typeof WORLDS)[number]

type Told = CounterfactualAnswer['robots'][number]

export interface WhatIfAnswer {
  /** The stretch of time that both worlds are of. */
  window: Window
  worlds: Readonly<Record<World, Recorded>>
  /** Radius around each robot that holds 95 % of the draws, metres, for each point. */
  within: Readonly<Record<World, ReadonlyMap<string, Float32Array>>>
  /** Where robots were in fact, as far as it was recorded. */
  recorded: ReadonlyMap<string, Track>
  /** Robots that were not where the simulation has them. */
  outside: ReadonlySet<string>
}

/** `at`: the moment that was asked of. */
export function readAnswer(told: CounterfactualAnswer, at: number): WhatIfAnswer {
  const { step, robots } = told
  const codes = stateCodes(told.states)
  const arenas = [{ at: Number.NEGATIVE_INFINITY, arena: readGround(told.arena) }]
  const points = robots[0]?.was.x.length ?? 1
  const window = { from: at, to: at + Math.max(1, points - 1) * step }
  const world = (name: World): Recorded => ({
    ...window,
    step,
    arenas,
    points: points * robots.length,
    tracks: new Map(
      robots.map((robot) => {
        const state = robot[name].state.map((place) => codes[place] ?? 0)
        check(robot, name, points)
        return [robot.robot, track(robot, robot[name], state, window.from, step)]
      }),
    ),
  })
  const within = (name: World): ReadonlyMap<string, Float32Array> =>
    new Map(robots.map((robot) => [robot.robot, Float32Array.from(robot[name].within)]))
  return {
    window,
    worlds: { was: world('was'), would: world('would') },
    within: { was: within('was'), would: within('would') },
    recorded: new Map(
      robots.map((robot) => [
        robot.robot,
        track(robot, robot.recorded, robot.was.state, window.from, step),
      ]),
    ),
    outside: new Set(robots.filter(({ inside }) => inside === false).map(({ robot }) => robot)),
  }
}

function check(robot: Told, name: World, points: number): void {
  const { x, y, theta, state, within } = robot[name]
  const columns: readonly (readonly unknown[])[] = [x, y, theta, state, within]
  if (columns.some(({ length }) => length !== points)) {
    throw new Unreadable(`the answer about ${robot.robot} has columns of different lengths`)
  }
}

interface Columns {
  x: readonly (number | null)[]
  y: readonly (number | null)[]
  theta: readonly (number | null)[]
}

/** Points of which nothing is known are left out: a track has gaps where it has no points. */
function track(
  { robot, kind }: Told,
  { x, y, theta }: Columns,
  state: readonly number[],
  from: number,
  step: number,
): Track {
  const known = x.flatMap((value, place) => {
    const all = value !== null && y[place] != null && theta[place] != null
    return all ? [place] : []
  })
  const column = (of: readonly (number | null)[]): Float32Array =>
    Float32Array.from(known, (place) => of[place] ?? 0)
  return {
    robot,
    kind: KINDS.find((name) => name === kind) ?? 'simulated',
    at: Float64Array.from(known, (place) => from + place * step),
    x: column(x),
    y: column(y),
    theta: column(theta),
    state: Uint8Array.from(known, (place) => state[place] ?? 0),
    // Nothing is told of what robots would have seen, or of their batteries.
    range: Int32Array.from(known, () => -1),
    battery: Uint8Array.from(known, () => 100),
    spacing: step,
  }
}
