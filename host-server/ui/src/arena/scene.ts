/** Triangles and lines of what does not move: floor, grid, walls, obstacles. */

import type { Arena, Mover, Obstacle, Patch, Thing } from '../feed/arena'
import { COLOURS } from '../feed/arena'
import type { Bounds } from './camera'

/** Indices into the tones of the theme; the order is the one of {@link TONES}. */
const TONE = {
  floor: 0,
  grid: 1,
  wall: 2,
  obstacle: 3,
  edge: 4,
  cell: 5,
  patch: 6,
} as const
/** Colours of things come after the tones of the theme. */
const FIRST_COLOUR = 7
/** How many tones the shader knows. */
export const TONES = FIRST_COLOUR + COLOURS.length

/** Vertices of three numbers: x, y, tone. */
export interface Scene {
  triangles: Float32Array
  lines: Float32Array
  floorVertices: number
}

/** Drawn thickness of walls, outside the arena, metres. */
const WALL = 0.08
const EDGE = 0.03
const CIRCLE_STEPS = 40
const MOST_GRID_LINES = 400
/** Robots that need neighbours listen to those in their cell and around it, metres. */
const CELL = 2
/** Dashes of the way of a mover, metres. */
const DASH = 0.12
const MOST_DASHES = 2_000
/** Distance between the strokes that mark a patch of floor, metres. */
const HATCH = 0.25

export function buildScene(arena: Arena): Scene {
  const triangles: number[] = []
  const [w, h] = [arena.width / 2, arena.height / 2]
  quad(triangles, TONE.wall, corners(0, 0, arena.width + 2 * WALL, arena.height + 2 * WALL, 0))
  quad(triangles, TONE.floor, corners(0, 0, arena.width, arena.height, 0))
  const floorVertices = triangles.length / 3
  for (const obstacle of arena.obstacles) addObstacle(triangles, obstacle)
  for (const mover of arena.movers) addObstacle(triangles, mover.body)
  for (const thing of arena.objects) addThing(triangles, thing)
  const lines: number[] = []
  // Metre lines, thinned out in arenas so large that they would cover the floor.
  const step = Math.max(1, Math.ceil((arena.width + arena.height) / MOST_GRID_LINES))
  const tone = (at: number): number => (at % CELL === 0 ? TONE.cell : TONE.grid)
  for (let x = Math.ceil(-w / step) * step; x < w; x += step) {
    lines.push(x, -h, tone(x), x, h, tone(x))
  }
  for (let y = Math.ceil(-h / step) * step; y < h; y += step) {
    lines.push(-w, y, tone(y), w, y, tone(y))
  }
  for (const patch of arena.patches) addPatch(lines, patch)
  for (const mover of arena.movers) addWay(lines, mover)
  return {
    triangles: new Float32Array(triangles),
    lines: new Float32Array(lines),
    floorVertices,
  }
}

export function arenaBounds(arena: Arena): Bounds {
  const [w, h] = [arena.width / 2 + WALL, arena.height / 2 + WALL]
  return { minX: -w, minY: -h, maxX: w, maxY: h }
}

function addObstacle(out: number[], o: Obstacle): void {
  if (o.shape === 'circle') {
    disc(out, TONE.edge, o.x, o.y, o.r)
    disc(out, TONE.obstacle, o.x, o.y, Math.max(0, o.r - EDGE))
    return
  }
  quad(out, TONE.edge, corners(o.x, o.y, o.w, o.h, o.theta))
  const inner = [Math.max(0, o.w - 2 * EDGE), Math.max(0, o.h - 2 * EDGE)] as const
  quad(out, TONE.obstacle, corners(o.x, o.y, inner[0], inner[1], o.theta))
}

/** What it is stands in its shape too: from above, as it would look. */
function addThing(out: number[], { shape, colour, x, y, size }: Thing): void {
  const tone = FIRST_COLOUR + COLOURS.indexOf(colour)
  const r = size / 2
  if (shape === 'box') {
    quad(out, TONE.edge, corners(x, y, size + EDGE, size + EDGE, 0))
    quad(out, tone, corners(x, y, size, size, 0))
    return
  }
  disc(out, TONE.edge, x, y, r + EDGE / 2)
  disc(out, tone, x, y, r)
  // A ball has a light spot, a cone its tip, a cylinder neither.
  if (shape === 'ball') disc(out, TONE.floor, x - r / 3, y + r / 3, r / 4)
  if (shape === 'cone') {
    disc(out, TONE.edge, x, y, r / 2)
    disc(out, tone, x, y, Math.max(0, r / 2 - EDGE / 2))
  }
}

/** Strokes across floor that grips differently: the closer, the less it holds. */
function addPatch(out: number[], { x, y, w, h, theta, grip }: Patch): void {
  const around = corners(x, y, w, h, theta)
  around.forEach((from, i) => {
    const to = around[(i + 1) % 4] as Point
    out.push(...from, TONE.patch, ...to, TONE.patch)
  })
  const [c, s] = [Math.cos(theta), Math.sin(theta)]
  const step = Math.max(HATCH * Math.min(1, grip) + 0.05, (w + h) / MOST_GRID_LINES)
  const at = (u: number, v: number): Point => [x + u * c - v * s, y + u * s + v * c]
  // Diagonals u + v = d of the box, cut at its sides.
  for (let d = step - (w + h) / 2; d < (w + h) / 2; d += step) {
    const [low, high] = [Math.max(-w / 2, d - h / 2), Math.min(w / 2, d + h / 2)]
    if (low >= high) continue
    out.push(...at(low, d - low), TONE.patch, ...at(high, d - high), TONE.patch)
  }
}

/** The way of a mover, dashed, from its own place around and back. */
function addWay(out: number[], { body, path }: Mover): void {
  const stops: Point[] = [[body.x, body.y], ...path, [body.x, body.y]]
  let dashes = 0
  stops.slice(1).forEach((to, i) => {
    const from = stops[i] as Point
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]]
    const length = Math.hypot(dx, dy)
    for (let at = 0; at < length && dashes < MOST_DASHES; at += 2 * DASH) {
      const [a, b] = [at / length, Math.min(1, (at + DASH) / length)]
      out.push(from[0] + dx * a, from[1] + dy * a, TONE.edge)
      out.push(from[0] + dx * b, from[1] + dy * b, TONE.edge)
      dashes += 1
    }
  })
}

type Point = readonly [number, number]

function corners(
  x: number,
  y: number,
  w: number,
  h: number,
  theta: number,
): readonly [Point, Point, Point, Point] {
  const [c, s] = [Math.cos(theta), Math.sin(theta)]
  const at = (dx: number, dy: number): Point => [x + dx * c - dy * s, y + dx * s + dy * c]
  return [at(-w / 2, -h / 2), at(w / 2, -h / 2), at(w / 2, h / 2), at(-w / 2, h / 2)]
}

function quad(
  out: number[],
  tone: number,
  [a, b, c, d]: readonly [Point, Point, Point, Point],
): void {
  for (const p of [a, b, c, a, c, d]) out.push(p[0], p[1], tone)
}

function disc(out: number[], tone: number, x: number, y: number, r: number): void {
  for (let i = 0; i < CIRCLE_STEPS; i++) {
    const a = (i / CIRCLE_STEPS) * 2 * Math.PI
    const b = ((i + 1) / CIRCLE_STEPS) * 2 * Math.PI
    out.push(x, y, tone)
    out.push(x + r * Math.cos(a), y + r * Math.sin(a), tone)
    out.push(x + r * Math.cos(b), y + r * Math.sin(b), tone)
  }
}
