/** A moment of the record, in the form in which the arena draws the live room. */

import type { ShallowRef } from 'vue'
import { shallowRef } from 'vue'
import type { Shown } from '../arena/stage'
import type { Arena } from '../feed/decode'
import { STATES } from '../feed/decode'
import type { Robot } from '../fleet/fleet'
import { newRobot } from '../fleet/fleet'
import { Selection } from '../fleet/selection'
import type { Seen } from './moment'
import { GONE_MS, newSeen, seenAt } from './moment'
import type { Recorded, Track } from './record'
import { arenaAt } from './record'

const LOW_BATTERY = 20
/** Of more robots than this only the chosen one has a trail. */
const MOST_TRAILS = 500
/** Displacement that counts as motion, metres. */
const MOVED = 0.003
const MOVED_WITHIN_MS = 700

export class Replay implements Shown {
  readonly arena: ShallowRef<Arena | null> = shallowRef(null)
  /** Nobody is chosen for a command here. */
  readonly selection = new Selection()
  /** The moment that is shown, Unix milliseconds. */
  time = 0
  selectedId: string | null = null
  /** Of each robot shown: how old its point is where that is too old, milliseconds. */
  readonly gaps = new Map<string, number>()
  /** Percent, by robot. */
  readonly batteries = new Map<string, number>()
  moving = 0
  readonly fleet: Shown['fleet']
  private readonly robots = new Map<string, Robot>()
  private placed = 0
  private recorded: Recorded | null = null
  private readonly seen: Seen = newSeen()
  private readonly before: Seen = newSeen()
  private ground = 'null'
  /** What the arena was compared with last. */
  private compared: Arena | null = null

  constructor() {
    const count = (): number => this.placed
    this.fleet = {
      all: () => this.robots.values(),
      get: (id) => {
        const robot = this.robots.get(id)
        return robot?.placed === true ? robot : undefined
      },
      get size() {
        return count()
      },
      // Poses are those of the moment: nothing is ever on its way.
      settledAt: Number.NEGATIVE_INFINITY,
    }
  }

  get selected(): Robot | undefined {
    return this.selectedId === null ? undefined : this.fleet.get(this.selectedId)
  }

  serverNow(): number {
    return this.time
  }

  /** The moment, by the record of it, and by the piece before for those who said nothing since. */
  show(time: number, recorded: Recorded, older: Recorded | null): void {
    this.time = time
    this.recorded = recorded
    this.placed = 0
    this.moving = 0
    this.gaps.clear()
    this.setArena(arenaAt(recorded, time))
    for (const robot of this.robots.values()) robot.placed = false
    for (const track of recorded.tracks.values()) this.place(track, recorded.step)
    if (older === null) return
    for (const track of older.tracks.values()) {
      if (this.robots.get(track.robot)?.placed !== true) this.place(track, older.step)
    }
  }

  /** Nothing is known of the moment. */
  clear(): void {
    this.recorded = null
    this.placed = 0
    this.moving = 0
    this.gaps.clear()
    for (const robot of this.robots.values()) robot.placed = false
  }

  readonly past = (robot: Robot, ago: number): readonly [number, number] | null => {
    if (this.recorded === null) return null
    if (this.placed > MOST_TRAILS && robot.id !== this.selectedId) return null
    const track = this.recorded.tracks.get(robot.id)
    if (track === undefined) return null
    const { before } = this
    const known = seenAt(track, this.time - ago, this.recorded.step, before)
    // A trail does not lead across a gap.
    return known && before.gap === 0 ? [before.x, before.y] : null
  }

  private place(track: Track, step: number): void {
    const { seen, before, time } = this
    if (!seenAt(track, time, step, seen)) return
    const robot = this.robotOf(track)
    robot.placed = true
    this.placed += 1
    robot.x = robot.fromX = seen.x
    robot.y = robot.fromY = seen.y
    robot.heading = robot.fromHeading = seen.heading
    robot.time = robot.fromTime = time
    robot.sampledAt = seen.told
    robot.state = STATES[seen.state] ?? 'IDLE'
    robot.range = seen.range
    robot.lowBattery = seen.battery < LOW_BATTERY
    this.batteries.set(robot.id, seen.battery)
    robot.presence = seen.gap === 0 ? 'online' : seen.gap < GONE_MS ? 'stale' : 'offline'
    if (seen.gap > 0) {
      this.gaps.set(robot.id, seen.gap)
    } else if (seenAt(track, time - MOVED_WITHIN_MS, step, before)) {
      if (Math.hypot(before.x - seen.x, before.y - seen.y) > MOVED) this.moving += 1
    }
  }

  private robotOf(track: Track): Robot {
    const known = this.robots.get(track.robot)
    if (known !== undefined) {
      known.kind = track.kind
      return known
    }
    const line = { id: track.robot, kind: track.kind, firmware: '', board: '' }
    const robot = newRobot({ ...line, index: this.robots.size, presence: 'online' })
    robot.state = 'IDLE'
    this.robots.set(robot.id, robot)
    return robot
  }

  /** Each piece of the record brings its own copy; the picture is built anew only for another one. */
  private setArena(arena: Arena | null): void {
    if (arena === this.compared) return
    this.compared = arena
    const ground = JSON.stringify(arena)
    if (ground === this.ground) return
    this.ground = ground
    this.arena.value = arena
  }
}
