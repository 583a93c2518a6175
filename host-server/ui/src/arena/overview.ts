/** The small picture of everything: where robots are, and what part of it is seen. */

import type { Robot } from '../fleet/fleet'
import type { Bounds, Camera, Size } from './camera'
import { mixOf } from './cluster'

/** How the world lies on the small picture. */
export interface Frame {
  /** CSS pixels per metre. */
  scale: number
  /** World point at the upper left corner. */
  left: number
  top: number
  width: number
  height: number
}

interface Rectangle {
  x: number
  y: number
  width: number
  height: number
}

/** The whole of `world` within so many pixels. */
export function frameOf(world: Bounds, longest: Size): Frame {
  const [w, h] = [Math.max(0.5, world.maxX - world.minX), Math.max(0.5, world.maxY - world.minY)]
  const scale = Math.min(longest.width / w, longest.height / h)
  return {
    scale,
    left: world.minX,
    top: world.maxY,
    width: Math.max(1, Math.round(w * scale)),
    height: Math.max(1, Math.round(h * scale)),
  }
}

/** What is seen, on the small picture and within it. */
export function seen(frame: Frame, camera: Camera, size: Size): Rectangle {
  const [w, h] = [size.width / camera.scale, size.height / camera.scale]
  const cut = (value: number, most: number): number => Math.min(most, Math.max(0, value))
  const left = cut((camera.x - w / 2 - frame.left) * frame.scale, frame.width)
  const right = cut((camera.x + w / 2 - frame.left) * frame.scale, frame.width)
  const top = cut((frame.top - camera.y - h / 2) * frame.scale, frame.height)
  const bottom = cut((frame.top - camera.y + h / 2) * frame.scale, frame.height)
  return { x: left, y: top, width: right - left, height: bottom - top }
}

/** Whether a small picture helps: not while everything is seen anyway. */
export function helps(world: Bounds, camera: Camera, size: Size): boolean {
  const [w, h] = [size.width / camera.scale / 2, size.height / camera.scale / 2]
  return (
    camera.x - w > world.minX + 0.01 ||
    camera.x + w < world.maxX - 0.01 ||
    camera.y - h > world.minY + 0.01 ||
    camera.y + h < world.maxY - 0.01
  )
}

/** World point under a point of the small picture. */
export function worldAt(frame: Frame, x: number, y: number): [number, number] {
  return [frame.left + x / frame.scale, frame.top - y / frame.scale]
}

/**
 * One pixel or more for each robot; those in trouble are drawn last and larger, so that they are
 * found. `tones` are as {@link mixOf} numbers them.
 */
export function drawOverview(
  context: CanvasRenderingContext2D,
  ratio: number,
  frame: Frame,
  robots: () => Iterable<Robot>,
  tones: readonly string[],
): void {
  context.setTransform(ratio, 0, 0, ratio, 0, 0)
  context.clearRect(0, 0, frame.width, frame.height)
  const dot = (kind: number, size: number): void => {
    context.fillStyle = tones[kind] ?? '#888'
    for (const robot of robots()) {
      if (!robot.placed || mixOf(robot) !== kind) continue
      const x = (robot.x - frame.left) * frame.scale
      const y = (frame.top - robot.y) * frame.scale
      context.fillRect(x - size / 2, y - size / 2, size, size)
    }
  }
  dot(4, 1.2)
  dot(1, 1.5)
  dot(0, 1.5)
  dot(2, 2)
  dot(3, 3.5)
}
