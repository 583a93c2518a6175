/** Places around a point, so that robots sent there together do not fight for one spot. */

import type { Point } from './lasso'

/** Distance between two robots that are sent to one point, metres. */
export const SPACING = 0.45

/** So many places around the origin in rings of hexagons, the nearest first. */
export function hexagons(count: number, spacing = SPACING): Point[] {
  const places: Point[] = []
  for (let ring = 0; places.length < count; ring++) {
    // Six sides of `ring` places each; the middle is a ring of its own.
    for (let side = 0; side < (ring === 0 ? 1 : 6); side++) {
      for (let step = 0; step < Math.max(1, ring) && places.length < count; step++) {
        const [from, to] = [corner(side), corner(side + 1)]
        const share = ring === 0 ? 0 : step / ring
        places.push([
          spacing * ring * (from[0] + (to[0] - from[0]) * share),
          spacing * ring * (from[1] + (to[1] - from[1]) * share),
        ])
      }
    }
  }
  return places
}

function corner(number: number): Point {
  return [Math.cos((number * Math.PI) / 3), Math.sin((number * Math.PI) / 3)]
}

export interface Placed {
  id: string
  x: number
  y: number
}

/**
 * A place near (x, y) for each robot. Whoever is nearest to the point takes the place nearest to
 * itself first, which keeps ways short and mostly apart. Where there are walls, places are kept
 * within.
 */
export function assign(
  robots: readonly Placed[],
  x: number,
  y: number,
  walls: { width: number; height: number } | null,
): Placed[] {
  const free = hexagons(robots.length).map(([dx, dy]) => within(x + dx, y + dy, walls))
  const distance = (robot: Placed): number => (robot.x - x) ** 2 + (robot.y - y) ** 2
  return [...robots]
    .sort((a, b) => distance(a) - distance(b))
    .map((robot) => {
      let best = 0
      let least = Infinity
      free.forEach(([fx, fy], at) => {
        const far = (fx - robot.x) ** 2 + (fy - robot.y) ** 2
        if (far < least) [best, least] = [at, far]
      })
      const [[gx, gy]] = free.splice(best, 1) as [Point]
      return { id: robot.id, x: round(gx), y: round(gy) }
    })
}

/** Robots must not be sent into a wall, metres. */
const WALL_MARGIN = 0.2

function within(x: number, y: number, walls: { width: number; height: number } | null): Point {
  if (walls === null) return [x, y]
  const w = Math.max(0, walls.width / 2 - WALL_MARGIN)
  const h = Math.max(0, walls.height / 2 - WALL_MARGIN)
  return [Math.min(w, Math.max(-w, x)), Math.min(h, Math.max(-h, y))]
}

/** To the millimetre; adding zero turns −0 into 0. */
function round(value: number): number {
  return Math.round(value * 1_000) / 1_000 + 0
}
