/** What the shaders know of robots: three texels for each slot of the fleet. */

import { KINDS, PRESENCES, STATES } from '../feed/decode'
import type { Robot } from '../fleet/fleet'

export const TEXELS = 3
/** Robots per texture row. */
export const ROW = 256
/** Numbers for each robot. */
const STRIDE = 4 * TEXELS

const codes = <T extends string>(names: readonly T[]): Record<T, number> =>
  Object.fromEntries(names.map((name, code) => [name, code])) as Record<T, number>
const STATE_CODES = codes(STATES)
const PRESENCE_CODES = codes(PRESENCES)
const KIND_CODES = codes(KINDS)

/** Added to the kind of the robot that is driven, and of those that are chosen with it. */
export const SELECTED = 4
export const IN_GROUP = 8

export class Texels {
  /** Grown in steps, so that uploads reuse the texture. */
  data = new Float32Array(0)
  /** Slots up to the last one that is taken. */
  slots = 0

  /** Slots there is room for: whole rows. */
  get capacity(): number {
    return this.data.length / STRIDE
  }

  /** Writes all of them; gives the slots of those selected, the one that is driven last. */
  write(
    robots: Iterable<Robot>,
    selected: string | null,
    group: ReadonlySet<string>,
    base: number,
  ): number[] {
    // An empty slot is all zeros.
    this.data.fill(0)
    this.slots = 0
    const chosen: number[] = []
    let driven: number | null = null
    for (const robot of robots) {
      if (!robot.placed) continue
      const slot = robot.index
      if (slot >= this.slots) this.reserve(slot + 1)
      let marks = KIND_CODES[robot.kind]
      if (group.size > 0 && group.has(robot.id)) {
        marks += IN_GROUP
        if (robot.id !== selected) chosen.push(slot)
      }
      if (robot.id === selected) {
        marks += SELECTED
        driven = slot
      }
      const { data } = this
      const at = slot * STRIDE
      data[at] = robot.fromX
      data[at + 1] = robot.fromY
      data[at + 2] = robot.fromHeading
      data[at + 3] = robot.fromTime - base
      data[at + 4] = robot.x
      data[at + 5] = robot.y
      data[at + 6] = robot.heading
      data[at + 7] = robot.time - base
      data[at + 8] = STATE_CODES[robot.state]
      data[at + 9] = PRESENCE_CODES[robot.presence] + 1
      data[at + 10] = marks
      data[at + 11] = robot.range === null ? -1 : robot.range / 1_000
    }
    if (driven !== null) chosen.push(driven)
    return chosen
  }

  private reserve(slots: number): void {
    this.slots = slots
    const needed = Math.ceil(slots / ROW) * ROW * STRIDE
    if (this.data.length >= needed) return
    const grown = new Float32Array(needed)
    grown.set(this.data)
    this.data = grown
  }
}
