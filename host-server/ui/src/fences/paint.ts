/**
 * Fences on the canvas over the robots. Hatching lies where robots must not be: all over the ground
 * of a keep-out, and outside along the edge of a keep-in. A whole line stops robots, a dashed one
 * only warns. Colours repeat that.
 */

import type { FenceBody } from '../api-types'
import type { Camera, Size } from '../arena/camera'
import { toScreen } from '../arena/camera'
import type { Point } from '../arena/lasso'
import type { Ink } from '../arena/overlay'
import { labelOf } from '../strings-fences'

/** Distance between lines of hatching, and how far it reaches outside of a keep-in, pixels. */
const HATCH = 9
const BAND = 11
/** Fences smaller than this on the screen have no room for a name. */
const LEAST_NAMED = 28
const CORNER = 5

interface Painting {
  camera: Camera
  size: Size
  fences: readonly FenceBody[]
  /** Corners of the one that is being drawn. */
  corners: readonly Point[]
}

/** True when there was anything to draw. */
export function paint(context: CanvasRenderingContext2D, ink: Ink, painting: Painting): boolean {
  const { camera, size, fences, corners } = painting
  const seen = (corner: readonly number[]): Point =>
    toScreen(camera, size, corner[0] ?? 0, corner[1] ?? 0)
  for (const fence of fences) paintFence(context, ink, size, fence, fence.corners.map(seen))
  if (corners.length > 0) paintCorners(context, ink, corners.map(seen))
  return fences.length > 0 || corners.length > 0
}

function paintFence(
  context: CanvasRenderingContext2D,
  ink: Ink,
  size: Size,
  fence: FenceBody,
  corners: readonly Point[],
): void {
  const box = boxOf(corners, BAND)
  if (box.right < 0 || box.bottom < 0 || box.left > size.width || box.top > size.height) return
  const keepOut = fence.kind === 'keep_out'
  context.save()
  context.strokeStyle = keepOut ? ink.danger : ink.ok
  context.lineJoin = 'round'
  context.setLineDash([])
  context.save()
  context.beginPath()
  trace(context, corners)
  if (!keepOut) context.rect(box.left, box.top, box.right - box.left, box.bottom - box.top)
  context.clip('evenodd')
  context.globalAlpha = keepOut ? 0.45 : 0.8
  if (keepOut) hatch(context, box, size)
  else band(context, corners)
  context.restore()
  context.lineWidth = fence.action === 'stop' ? 3 : 2
  context.setLineDash(fence.action === 'stop' ? [] : [8, 5])
  context.beginPath()
  trace(context, corners)
  context.stroke()
  context.restore()
  const [width, height] = [box.right - box.left - 2 * BAND, box.bottom - box.top - 2 * BAND]
  if (Math.max(width, height) >= LEAST_NAMED) name(context, ink, size, fence, corners)
}

function trace(context: CanvasRenderingContext2D, corners: readonly Point[]): void {
  corners.forEach(([x, y], at) => (at === 0 ? context.moveTo(x, y) : context.lineTo(x, y)))
  context.closePath()
}

interface Box {
  left: number
  right: number
  top: number
  bottom: number
}

function boxOf(corners: readonly Point[], margin: number): Box {
  const [xs, ys] = [corners.map(([x]) => x), corners.map(([, y]) => y)]
  return {
    left: Math.min(...xs) - margin,
    right: Math.max(...xs) + margin,
    top: Math.min(...ys) - margin,
    bottom: Math.max(...ys) + margin,
  }
}

/** Slanted lines over what is seen of a box. */
function hatch(context: CanvasRenderingContext2D, box: Box, size: Size): void {
  const top = Math.max(0, box.top)
  const bottom = Math.min(size.height, box.bottom)
  const left = Math.max(0, box.left)
  const right = Math.min(size.width, box.right)
  const tall = bottom - top
  context.lineWidth = 1.4
  context.beginPath()
  // Each begins at a place that moves with the fence, or the hatching would swim.
  const first = left - tall + ((((box.left + box.bottom - left - bottom) % HATCH) + HATCH) % HATCH)
  for (let x = first; x < right; x += HATCH) {
    context.moveTo(x, bottom)
    context.lineTo(x + tall, top)
  }
  context.stroke()
}

/** Short lines across the edge; what is within is clipped away. */
function band(context: CanvasRenderingContext2D, corners: readonly Point[]): void {
  context.lineWidth = 1.6
  context.beginPath()
  corners.forEach(([ax, ay], at) => {
    const [bx, by] = corners[(at + 1) % corners.length] as Point
    const length = Math.hypot(bx - ax, by - ay)
    const count = Math.min(400, Math.floor(length / HATCH))
    // Slanted against the edge, whichever way that runs.
    const reach = (BAND * Math.SQRT1_2) / Math.max(1, length)
    const [dx, dy] = [(bx - ax - (by - ay)) * reach, (by - ay + (bx - ax)) * reach]
    for (let step = 0; step < count; step++) {
      const share = (step + 0.5) / count
      const [x, y] = [ax + (bx - ax) * share, ay + (by - ay) * share]
      context.moveTo(x - dx, y - dy)
      context.lineTo(x + dx, y + dy)
    }
  })
  context.stroke()
}

/** Beside the highest corner, inside of the picture. */
function name(
  context: CanvasRenderingContext2D,
  ink: Ink,
  size: Size,
  fence: FenceBody,
  corners: readonly Point[],
): void {
  const highest = corners.reduce((best, at) => (at[1] < best[1] ? at : best))
  const words = labelOf(fence)
  context.font = '600 12px system-ui, sans-serif'
  const wide = context.measureText(words).width + 12
  const x = Math.min(Math.max(highest[0] - wide / 2, 2), size.width - wide - 2)
  const y = Math.min(Math.max(highest[1] - 22, 2), size.height - 20)
  if (highest[1] < -200 || highest[1] > size.height + 200) return
  context.setLineDash([])
  context.fillStyle = ink.panel
  context.globalAlpha = 0.9
  context.fillRect(x, y, wide, 18)
  context.globalAlpha = 1
  context.strokeStyle = fence.kind === 'keep_out' ? ink.danger : ink.ok
  context.lineWidth = 1
  context.strokeRect(x + 0.5, y + 0.5, wide - 1, 17)
  context.fillStyle = ink.text
  context.textAlign = 'left'
  context.textBaseline = 'middle'
  context.fillText(words, x + 6, y + 9.5)
}

/** The line so far, and dashed how it would close. */
function paintCorners(
  context: CanvasRenderingContext2D,
  ink: Ink,
  corners: readonly Point[],
): void {
  const [first, last] = [corners[0] as Point, corners.at(-1) as Point]
  context.save()
  context.strokeStyle = ink.accent
  context.lineWidth = 2.5
  context.setLineDash([])
  context.beginPath()
  corners.forEach(([x, y], at) => (at === 0 ? context.moveTo(x, y) : context.lineTo(x, y)))
  context.stroke()
  if (corners.length > 2) {
    context.setLineDash([5, 5])
    context.beginPath()
    context.moveTo(...last)
    context.lineTo(...first)
    context.stroke()
    context.setLineDash([])
  }
  corners.forEach(([x, y], at) => {
    context.fillStyle = at === 0 ? ink.accent : ink.panel
    context.beginPath()
    context.arc(x, y, at === 0 ? CORNER + 2 : CORNER, 0, 2 * Math.PI)
    context.fill()
    context.stroke()
  })
  context.restore()
}
