/** Where robots have been in the last seconds: a ring of places for each slot of the fleet. */

import type { Robot } from '../fleet/fleet'

/** Places remembered of each robot. */
export const TRAIL = 20
/** Time between two of them. */
export const TRAIL_EVERY_MS = 500
/** Whoever is this far from where it was last has been set down elsewhere, metres. */
const JUMP = 2

/** Where a robot was so many milliseconds before now; `null` where that is not known. */
export type Past = (robot: Robot, ago: number) => readonly [number, number] | null

export class Trails {
  /** One layer for each place in the ring: x, y of each slot. */
  readonly layers: Float32Array[] = []
  /** The layer written last. */
  head = 0
  /** Layers that changed since they were last taken over. */
  readonly dirty = new Set<number>()
  private readonly owners: (string | undefined)[] = []
  private recordedAt = Number.NEGATIVE_INFINITY

  /** Room for so many slots; what is known is forgotten when more are needed. */
  reserve(slots: number): void {
    if ((this.layers[0]?.length ?? 0) >= 2 * slots && this.layers.length > 0) return
    this.layers.length = 0
    for (let i = 0; i < TRAIL; i++) this.layers.push(new Float32Array(2 * slots))
    this.owners.length = 0
    this.recordedAt = Number.NEGATIVE_INFINITY
  }

  /** Remembers where robots are; false while it is too early for that. `now` is monotonic. */
  record(robots: Iterable<Robot>, now: number): boolean {
    if (now - this.recordedAt < TRAIL_EVERY_MS) return false
    this.recordedAt = now
    const before = this.layers[this.head]
    this.head = (this.head + 1) % TRAIL
    const layer = this.layers[this.head]
    if (layer === undefined || before === undefined) return false
    this.dirty.add(this.head)
    for (const robot of robots) {
      const at = 2 * robot.index
      if (!robot.placed || at >= layer.length) continue
      const [dx, dy] = [robot.x - (before[at] as number), robot.y - (before[at + 1] as number)]
      if (this.owners[robot.index] !== robot.id || dx * dx + dy * dy > JUMP * JUMP) {
        this.begin(robot)
      }
      layer[at] = robot.x
      layer[at + 1] = robot.y
    }
    return true
  }

  /** Takes the whole past from elsewhere. A trail ends where nothing more is known. */
  replay(robots: Iterable<Robot>, past: Past): void {
    for (const robot of robots) {
      if (!robot.placed || 2 * robot.index >= (this.layers[0]?.length ?? 0)) continue
      let at: readonly [number, number] = [robot.x, robot.y]
      let known = true
      for (let age = 0; age < TRAIL; age++) {
        const layer = this.layers[(this.head - age + TRAIL) % TRAIL] as Float32Array
        const before: ReturnType<Past> = known ? past(robot, age * TRAIL_EVERY_MS) : null
        known = before !== null
        at = before ?? at
        layer[2 * robot.index] = at[0]
        layer[2 * robot.index + 1] = at[1]
      }
    }
    this.layers.forEach((_, number) => this.dirty.add(number))
  }

  /** All of a robot's past is where it is now. */
  private begin(robot: Robot): void {
    this.owners[robot.index] = robot.id
    this.layers.forEach((layer, number) => {
      layer[2 * robot.index] = robot.x
      layer[2 * robot.index + 1] = robot.y
      this.dirty.add(number)
    })
  }
}
