/**
 * The map of a robot on the canvas over the robots. What is there is filled, what was looked through since is a hollow
 * square, so that both are told apart without colours; a dashed frame says how far the map goes. Dots lead along
 * the planned way, a ring is the point that the robot drives to now, and a ring with a cross its goal.
 */

import type { MapBody } from '../api-types'
import type { Camera, Size } from '../arena/camera'
import { toScreen } from '../arena/camera'
import type { Point } from '../arena/lasso'
import type { Ink } from '../arena/overlay'

const TURN = 2 * Math.PI
/** Cells smaller than this on the screen are filled without a gap, pixels. */
const LEAST_GAP = 5
const DOT = 3
const RING = 6
const GOAL = 10

interface Painting {
  camera: Camera
  size: Size
  map: MapBody
}

/** Always true: there is a frame at least. */
export function paint(context: CanvasRenderingContext2D, ink: Ink, painting: Painting): boolean {
  context.save()
  paintFrame(context, ink, painting)
  paintCells(context, ink, painting, '#')
  paintCells(context, ink, painting, 'o')
  paintPlan(context, ink, painting)
  context.restore()
  return true
}

function paintFrame(
  context: CanvasRenderingContext2D,
  ink: Ink,
  { camera, size, map }: Painting,
): void {
  const { origin, resolution, columns, rows } = map
  const [left, bottom] = toScreen(camera, size, origin[0] ?? 0, origin[1] ?? 0)
  const edge = resolution * camera.scale
  context.strokeStyle = ink.text
  context.globalAlpha = 0.55
  context.lineWidth = 1
  context.setLineDash([2, 5])
  context.strokeRect(left, bottom - rows.length * edge, columns * edge, rows.length * edge)
  context.setLineDash([])
  context.globalAlpha = 1
}

/** Cells of one kind, in one path: there may be thousands. */
function paintCells(
  context: CanvasRenderingContext2D,
  ink: Ink,
  { camera, size, map }: Painting,
  kind: '#' | 'o',
): void {
  const [left, bottom] = toScreen(camera, size, map.origin[0] ?? 0, map.origin[1] ?? 0)
  const edge = map.resolution * camera.scale
  const gap = edge < LEAST_GAP ? 0 : 1
  const inset = kind === '#' ? gap / 2 : Math.max(gap, edge * 0.3)
  context.beginPath()
  map.rows.forEach((row, at) => {
    const y = bottom - (at + 1) * edge
    if (y > size.height || y + edge < 0) return
    for (let column = row.indexOf(kind); column >= 0; column = row.indexOf(kind, column + 1)) {
      const x = left + column * edge
      if (x > size.width || x + edge < 0) continue
      context.rect(x + inset, y + inset, edge - 2 * inset, edge - 2 * inset)
    }
  })
  if (kind === '#') {
    context.fillStyle = ink.danger
    context.globalAlpha = 0.6
    context.fill()
  } else {
    context.strokeStyle = ink.text
    context.globalAlpha = 0.6
    context.lineWidth = 1
    context.stroke()
  }
  context.globalAlpha = 1
}

function paintPlan(
  context: CanvasRenderingContext2D,
  ink: Ink,
  { camera, size, map }: Painting,
): void {
  const seen = (place: readonly number[]): Point =>
    toScreen(camera, size, place[0] ?? 0, place[1] ?? 0)
  context.lineJoin = 'round'
  const way = map.way.map(seen)
  const next = map.next == null ? null : seen(map.next)
  const goal = map.goal == null ? null : seen(map.goal)
  // Light under dark, so that it is seen on everything.
  for (const [tone, more] of [
    [ink.panel, 3],
    [ink.accent, 0],
  ] as const) {
    context.strokeStyle = tone
    context.fillStyle = tone
    context.lineWidth = 2 + more
    context.beginPath()
    way.forEach(([x, y], at) => (at === 0 ? context.moveTo(x, y) : context.lineTo(x, y)))
    context.stroke()
    context.beginPath()
    for (const [x, y] of way) {
      context.moveTo(x + DOT, y)
      context.arc(x, y, DOT + more / 2, 0, TURN)
    }
    context.fill()
    context.beginPath()
    if (next !== null) ring(context, next, RING)
    if (goal !== null) {
      ring(context, goal, GOAL)
      cross(context, goal, GOAL / 2)
    }
    context.stroke()
  }
}

function ring(context: CanvasRenderingContext2D, [x, y]: Point, radius: number): void {
  context.moveTo(x + radius, y)
  context.arc(x, y, radius, 0, TURN)
}

function cross(context: CanvasRenderingContext2D, [x, y]: Point, arm: number): void {
  context.moveTo(x - arm, y)
  context.lineTo(x + arm, y)
  context.moveTo(x, y - arm)
  context.lineTo(x, y + arm)
}
