/** Words about the map of a robot; loaded with its layer. */

import type { MapBody } from './api-types'
import { position } from './strings'

const cells = (count: number): string => `${String(count)} cell${count === 1 ? '' : 's'}`

function count(map: MapBody, kind: string): number {
  return map.rows.reduce((sum, row) => sum + row.split(kind).length - 1, 0)
}

export const words = {
  nobody: 'Map: select a robot to see what it knows.',
  asking: (robot: string) => `Asking ${robot} for its map…`,
  none: (robot: string) =>
    `${robot} has no map: it keeps one on its way to a place, and for half a minute after.`,
  failed: (robot: string, why: string) => `No map of ${robot}: ${why}.`,
  map(robot: string, map: MapBody): string {
    const place = (at: readonly number[]): string => position(at[0] ?? 0, at[1] ?? 0)
    const plan =
      map.goal == null
        ? 'no goal'
        : `goal ${place(map.goal)}${map.next == null ? ', no way yet' : ''}`
    return `Map of ${robot}: ${cells(count(map, '#'))} blocked, ${String(count(map, 'o'))} cleared; ${plan}.`
  },
} as const
