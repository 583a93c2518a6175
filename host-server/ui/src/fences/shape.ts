/** What corners make a fence, as the server checks it too; metres. */

import type { Point } from '../arena/lasso'

const FEWEST_CORNERS = 3
export const MOST_CORNERS = 32
/** Square metres. */
const LEAST_AREA = 0.01
const FARTHEST = 10_000

/** Why corners make no fence; corners are counted from 1. */
export type Flaw =
  | { flaw: 'few' }
  | { flaw: 'many' }
  | { flaw: 'far'; corner: number }
  | { flaw: 'twice'; corner: number }
  | { flaw: 'crossing'; one: number; other: number }
  | { flaw: 'small' }

export function flawOf(corners: readonly Point[]): Flaw | null {
  if (corners.length < FEWEST_CORNERS) return { flaw: 'few' }
  if (corners.length > MOST_CORNERS) return { flaw: 'many' }
  const near = (value: number): boolean => Math.abs(value) <= FARTHEST
  const far = corners.findIndex(([x, y]) => !near(x) || !near(y))
  if (far >= 0) return { flaw: 'far', corner: far + 1 }
  const edges = corners.map((from, at) => [from, corners[(at + 1) % corners.length] as Point])
  const same = edges.findIndex(([a, b]) => a?.[0] === b?.[0] && a?.[1] === b?.[1])
  if (same >= 0) return { flaw: 'twice', corner: ((same + 1) % corners.length) + 1 }
  const last = corners.length - 1
  for (let one = 0; one < corners.length; one++) {
    for (let other = one + 1; other < corners.length; other++) {
      const [a, b] = edges[one] as [Point, Point]
      const [c, d] = edges[other] as [Point, Point]
      const meet =
        other === one + 1
          ? foldsBack(a, b, d)
          : one === 0 && other === last
            ? foldsBack(c, d, b)
            : meets(a, b, c, d)
      if (meet) return { flaw: 'crossing', one: one + 1, other: other + 1 }
    }
  }
  return areaOf(corners) <= LEAST_AREA ? { flaw: 'small' } : null
}

/** Whether a line through these corners, not closed yet, runs into itself. */
export function isTangled(corners: readonly Point[]): boolean {
  for (let one = 0; one + 1 < corners.length; one++) {
    for (let other = one + 1; other + 1 < corners.length; other++) {
      const [a, b] = [corners[one] as Point, corners[one + 1] as Point]
      const [c, d] = [corners[other] as Point, corners[other + 1] as Point]
      if (other === one + 1 ? foldsBack(a, b, d) : meets(a, b, c, d)) return true
    }
  }
  return false
}

function areaOf(corners: readonly Point[]): number {
  const first = corners[0] as Point
  const twice = corners.reduce((sum, at, index) => {
    return sum + turn(first, at, corners[(index + 1) % corners.length] as Point)
  }, 0)
  return Math.abs(twice) / 2
}

/** Twice the area of the triangle; positive when it goes anticlockwise. */
function turn(a: Point, b: Point, c: Point): number {
  return (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

/** Whether the edge from `b` to `c` lies on the one from `a` to `b`. */
function foldsBack(a: Point, b: Point, c: Point): boolean {
  const ahead = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1])
  return turn(a, b, c) === 0 && ahead < 0
}

function meets(a: Point, b: Point, c: Point, d: Point): boolean {
  const [s, t, u, v] = [turn(c, d, a), turn(c, d, b), turn(a, b, c), turn(a, b, d)]
  if (s * t < 0 && u * v < 0) return true
  const within = (from: Point, to: Point, at: Point, axis: 0 | 1): boolean =>
    at[axis] >= Math.min(from[axis], to[axis]) && at[axis] <= Math.max(from[axis], to[axis])
  const on = (side: number, from: Point, to: Point, at: Point): boolean =>
    side === 0 && within(from, to, at, 0) && within(from, to, at, 1)
  return on(s, c, d, a) || on(t, c, d, b) || on(u, a, b, c) || on(v, a, b, d)
}

/** To the centimetre, which is as sure as robots are of their places. */
export function rounded([x, y]: Point): Point {
  const cm = (value: number): number => Math.round(value * 100) / 100 + 0
  return [cm(x), cm(y)]
}

/** One corner to a line, as people write it. */
export function written(corners: readonly (readonly number[])[]): string {
  return corners.map((corner) => corner.join(', ')).join('\n')
}

/** Corners from lines, or the number of the line that is none. */
export function readCorners(lines: string): { corners: Point[] } | { line: number } {
  const corners: Point[] = []
  for (const [index, line] of lines.split('\n').entries()) {
    if (line.trim() === '') continue
    const parts = line
      .trim()
      .replaceAll('−', '-')
      .split(/\s*[,;]\s*|\s+/)
    const [x, y] = parts.map((part) => (part === '' ? Number.NaN : Number(part)))
    if (parts.length !== 2 || x === undefined || y === undefined) return { line: index + 1 }
    if (!Number.isFinite(x) || !Number.isFinite(y)) return { line: index + 1 }
    corners.push([x, y])
  }
  return { corners }
}
