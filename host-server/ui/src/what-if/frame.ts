/** What both worlds take of the floor, so that both pictures show the same of it, at any time. */

import type { Bounds } from '../arena/camera'
import { union } from '../arena/pick'
import { arenaBounds } from '../arena/scene'
import type { WhatIfAnswer } from './answer'
import { WORLDS } from './answer'

/** `null` where there is neither an arena nor a robot. */
export function frameOf({ worlds }: WhatIfAnswer): Bounds | null {
  const arena = worlds.was.arenas[0]?.arena ?? null
  let all = arena === null ? null : arenaBounds(arena)
  for (const world of WORLDS) {
    for (const { x, y } of worlds[world].tracks.values()) {
      x.forEach((minX, place) => {
        const minY = y[place] as number
        const point = { minX, minY, maxX: minX, maxY: minY }
        all = all === null ? point : union(all, point)
      })
    }
  }
  return all
}
