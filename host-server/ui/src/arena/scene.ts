/** Triangles and lines of what does not move: floor, grid, walls, obstacles. */

import type { Arena, Obstacle } from '../feed/decode'
import type { Bounds } from './camera'

/** Indices into the tones of the theme; the order is the one in the shader. */
export const TONE = { floor: 0, grid: 1, wall: 2, obstacle: 3, edge: 4 } as const

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

export function buildScene(arena: Arena): Scene {
  const triangles: number[] = []
  const [w, h] = [arena.width / 2, arena.height / 2]
  quad(triangles, TONE.wall, corners(0, 0, arena.width + 2 * WALL, arena.height + 2 * WALL, 0))
  quad(triangles, TONE.floor, corners(0, 0, arena.width, arena.height, 0))
  const floorVertices = triangles.length / 3
  for (const obstacle of arena.obstacles) addObstacle(triangles, obstacle)
  const lines: number[] = []
  // Metre lines, thinned out in arenas so large that they would cover the floor.
  const step = Math.max(1, Math.ceil((arena.width + arena.height) / MOST_GRID_LINES))
  for (let x = Math.ceil(-w / step) * step; x < w; x += step) {
    lines.push(x, -h, TONE.grid, x, h, TONE.grid)
  }
  for (let y = Math.ceil(-h / step) * step; y < h; y += step) {
    lines.push(-w, y, TONE.grid, w, y, TONE.grid)
  }
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
