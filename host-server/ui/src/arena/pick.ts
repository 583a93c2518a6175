/** Which robot is meant by a point on the screen, and how large robots are drawn. */

import type { Robot } from '../fleet/fleet'
import { poseAt } from '../fleet/fleet'
import type { Bounds, Camera } from './camera'
import { toScreen } from './camera'
import type { View } from './renderer'
import { drawnRadius } from './renderer'

/** The robot nearest to a screen point, at most `reach` pixels outside its outline. */
export function nearest(
  robots: Iterable<Robot>,
  view: View,
  x: number,
  y: number,
  reach: number,
): Robot | null {
  let best: Robot | null = null
  let bestDistance = drawnRadius(view) * view.camera.scale + reach
  for (const robot of robots) {
    if (!robot.placed) continue
    const pose = poseAt(robot, view.time)
    const [screenX, screenY] = toScreen(view.camera, view.size, pose.x, pose.y)
    const distance = Math.hypot(screenX - x, screenY - y)
    if (distance < bestDistance) {
      best = robot
      bestDistance = distance
    }
  }
  return best
}

const SMALLEST = 2.5
const COMFORTABLE = 9

/**
 * Smallest radius in pixels: comfortable to see and hit where there is room,
 * smaller where robots drawn so large would cover each other.
 */
export function smallestRadius(count: number, area: Bounds, camera: Camera): number {
  if (count === 0) return COMFORTABLE
  const square = (area.maxX - area.minX) * (area.maxY - area.minY)
  const spacing = Math.sqrt(square / count) * camera.scale
  return Math.min(COMFORTABLE, Math.max(SMALLEST, spacing * 0.28))
}

/** The rectangle all placed robots are in; null without any. */
export function boundsOf(robots: Iterable<Robot>): Bounds | null {
  const bounds = { minX: Infinity, minY: Infinity, maxX: -Infinity, maxY: -Infinity }
  for (const robot of robots) {
    if (!robot.placed) continue
    bounds.minX = Math.min(bounds.minX, robot.x)
    bounds.minY = Math.min(bounds.minY, robot.y)
    bounds.maxX = Math.max(bounds.maxX, robot.x)
    bounds.maxY = Math.max(bounds.maxY, robot.y)
  }
  return Number.isFinite(bounds.minX) ? bounds : null
}

/** The rectangle around both. */
export function union(a: Bounds, b: Bounds | null): Bounds {
  if (b === null) return a
  return {
    minX: Math.min(a.minX, b.minX),
    minY: Math.min(a.minY, b.minY),
    maxX: Math.max(a.maxX, b.maxX),
    maxY: Math.max(a.maxY, b.maxY),
  }
}
