/** Thousands of robots in view: neighbours are counted together, by what they are doing. */

import type { Robot } from '../fleet/fleet'
import type { Bounds, Camera, Size } from './camera'
import { toWorld } from './camera'

export interface Cluster {
  /** Middle of its robots, metres. */
  x: number
  y: number
  count: number
  /** Robots that move, wait, want attention, stand with an error, and are gone: as its ring is drawn. */
  mix: readonly number[]
}

/** Robots are counted together when they would be closer than this on average, pixels. */
const CROWDED = 11
/** Fewer robots than this in view are always drawn one by one. */
const FEWEST = 400
/** Fewer robots than this in one place are drawn one by one. */
const SMALLEST = 4
/** Cells are at least this wide, pixels; at most twice as wide. */
const CELL_PIXELS = 52

export function mixOf(robot: Robot): number {
  if (robot.presence !== 'online') return 4
  switch (robot.state) {
    case 'MOVING':
      return 0
    case 'CAUTION':
    case 'AVOIDING':
      return 2
    case 'ERROR':
      return 3
    default:
      return 1
  }
}

/** The part of the world that is seen, and a little more. */
export function inView(camera: Camera, size: Size, margin = 0): Bounds {
  const [minX, maxY] = toWorld(camera, size, -margin, -margin)
  const [maxX, minY] = toWorld(camera, size, size.width + margin, size.height + margin)
  return { minX, minY, maxX, maxY }
}

/**
 * Width of the cells that robots are counted in, metres: a power of two, so that cells stay where
 * they are while the view moves and change at once when it is zoomed.
 */
export function cellSize(scale: number): number {
  return 2 ** Math.ceil(Math.log2(CELL_PIXELS / scale))
}

/** Clusters of what is in view; empty while there is room to draw every robot. */
export function clusters(robots: Iterable<Robot>, camera: Camera, size: Size): Cluster[] {
  const view = inView(camera, size, CELL_PIXELS)
  const cell = cellSize(camera.scale)
  const across = Math.ceil((view.maxX - view.minX) / cell) + 2
  const [left, low] = [Math.floor(view.minX / cell), Math.floor(view.minY / cell)]
  const cells = new Map<number, { x: number; y: number; count: number; mix: number[] }>()
  let count = 0
  for (const robot of robots) {
    const { x, y } = robot
    if (!robot.placed || x < view.minX || x > view.maxX || y < view.minY || y > view.maxY) continue
    count += 1
    const key = Math.floor(x / cell) - left + (Math.floor(y / cell) - low) * across
    let found = cells.get(key)
    if (found === undefined) {
      found = { x: 0, y: 0, count: 0, mix: [0, 0, 0, 0, 0] }
      cells.set(key, found)
    }
    found.x += x
    found.y += y
    found.count += 1
    const kind = mixOf(robot)
    found.mix[kind] = (found.mix[kind] ?? 0) + 1
  }
  if (count < FEWEST || cells.size === 0) return []
  // Over the cells that have robots in them, so that empty floor does not count as room.
  const spacing = cell * camera.scale * Math.sqrt(cells.size / count)
  if (spacing > CROWDED) return []
  return [...cells.values()]
    .filter((found) => found.count >= SMALLEST)
    .map((found) => ({
      x: found.x / found.count,
      y: found.y / found.count,
      count: found.count,
      mix: found.mix,
    }))
}

/** Radius of the badge of a cluster, pixels. */
export function badgeRadius(count: number): number {
  return Math.min(24, 11 + 3 * Math.log10(count) ** 1.3)
}

/** `1,240` takes more room than a badge has: three characters at most, or `1.2k`. */
export function badgeCount(count: number): string {
  if (count < 1_000) return String(count)
  const thousands = count / 1_000
  return `${thousands < 9.95 ? thousands.toFixed(1) : String(Math.round(thousands))}k`
}

/** The cluster whose badge is under a screen point. */
export function clusterAt(
  list: readonly Cluster[],
  camera: Camera,
  size: Size,
  x: number,
  y: number,
): Cluster | null {
  const [worldX, worldY] = toWorld(camera, size, x, y)
  let found: Cluster | null = null
  // The last one is drawn on top.
  for (const cluster of list) {
    const pixels = Math.hypot(cluster.x - worldX, cluster.y - worldY) * camera.scale
    if (pixels <= badgeRadius(cluster.count)) found = cluster
  }
  return found
}
