/** Choosing robots by a line drawn around them: plain geometry on screen points. */

export type Point = readonly [number, number]

/** Points closer together than this add nothing to a line, pixels. */
const GRAIN = 4
/** A line of more points than this is no longer drawn on, only closed. */
const MOST_POINTS = 2_000

/** A line being drawn; closes itself. */
export class Lasso {
  readonly points: Point[] = []

  constructor(start: Point) {
    this.points.push(start)
  }

  /** False when the point is too near to the last one to matter. */
  extend([x, y]: Point): boolean {
    const last = this.points.at(-1) as Point
    if (Math.hypot(x - last[0], y - last[1]) < GRAIN) return false
    if (this.points.length >= MOST_POINTS) return false
    this.points.push([x, y])
    return true
  }

  /** Whether it encloses anything at all. */
  get closed(): boolean {
    return this.points.length >= 3
  }

  holds(x: number, y: number): boolean {
    return this.closed && inPolygon(this.points, x, y)
  }
}

/** By the number of sides that a ray to the right crosses: also for lines that cross themselves. */
export function inPolygon(polygon: readonly Point[], x: number, y: number): boolean {
  let inside = false
  let [ax, ay] = polygon.at(-1) ?? [0, 0]
  for (const [bx, by] of polygon) {
    if (ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax)) inside = !inside
    ;[ax, ay] = [bx, by]
  }
  return inside
}
