/** What lies over the robots of a world: how sure it is, and in the world as it was what was recorded. */

import type { Seen } from '../history/moment'
import { newSeen, seenAt } from '../history/moment'
import { lastAt } from '../history/record'
import type { WhatIfAnswer, World } from './answer'

/** Discs of more robots than this hide more than they show: then only those of whom it is about have one. */
const MOST_DISCS = 150

export interface Disc {
  x: number
  y: number
  /** Metres. */
  radius: number
  chosen: boolean
}

/** Where a robot was in fact. */
export interface Ghost {
  x: number
  y: number
  theta: number
  /** Where the simulation has it. */
  drawn: readonly [number, number]
  outside: boolean
  chosen: boolean
}

export interface Overlay {
  discs: readonly Disc[]
  ghosts: readonly Ghost[]
  /** The recorded way of the chosen robot so far. */
  way: readonly (readonly [number, number])[]
}

/** `about`: the robots that were told something else. */
export function overlayAt(
  answer: WhatIfAnswer,
  world: World,
  time: number,
  chosen: string | null,
  about: ReadonlySet<string>,
): Overlay {
  const { tracks, step } = answer.worlds[world]
  const few = tracks.size <= MOST_DISCS
  const [drawn, was] = [newSeen(), newSeen()]
  const discs: Disc[] = []
  const ghosts: Ghost[] = []
  for (const [robot, track] of tracks) {
    if (!seenAt(track, time, step, drawn)) continue
    const isChosen = robot === chosen
    if (few || isChosen || about.has(robot)) {
      const radius = radiusAt(answer, world, robot, time)
      discs.push({ x: drawn.x, y: drawn.y, radius, chosen: isChosen })
    }
    if (world === 'was' && wasAt(answer, robot, time, was)) {
      ghosts.push({
        x: was.x,
        y: was.y,
        theta: was.heading,
        drawn: [drawn.x, drawn.y],
        outside: answer.outside.has(robot),
        chosen: isChosen,
      })
    }
  }
  return { discs, ghosts, way: world === 'was' ? wayOf(answer, chosen, time) : [] }
}

/** Metres, between the points around a moment. */
export function radiusAt(answer: WhatIfAnswer, world: World, robot: string, time: number): number {
  const { window, worlds, within } = answer
  const column = within[world].get(robot)
  if (column === undefined || column.length === 0) return 0
  const place = Math.max(0, (time - window.from) / worlds[world].step)
  const low = Math.min(column.length - 1, Math.floor(place))
  const high = Math.min(column.length - 1, low + 1)
  const [a, b] = [column[low] as number, column[high] as number]
  return a + (b - a) * Math.min(1, place - low)
}

/** False where nothing was recorded of a robot around this time. */
function wasAt(answer: WhatIfAnswer, robot: string, time: number, into: Seen): boolean {
  const track = answer.recorded.get(robot)
  if (track === undefined) return false
  return seenAt(track, time, answer.worlds.was.step, into) && into.gap === 0
}

function wayOf(answer: WhatIfAnswer, robot: string | null, time: number): Overlay['way'] {
  const track = robot === null ? undefined : answer.recorded.get(robot)
  if (track === undefined) return []
  const last = lastAt(track.at, time)
  return Array.from(track.at.subarray(0, last + 1), (_, place) => [
    track.x[place] as number,
    track.y[place] as number,
  ])
}
