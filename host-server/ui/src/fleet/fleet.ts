/**
 * What is known of every robot, kept outside Vue's reactivity: at ten frames a
 * second and thousands of robots only the few visible rows may cost anything.
 */

import type { Kind, PosesFrame, Presence, RobotState, RosterFrame } from '../feed/decode'
import { PRESENCES, STATES, expandTime } from '../feed/decode'

export interface Robot {
  readonly index: number
  id: string
  kind: Kind
  firmware: string
  board: string
  presence: Presence
  /** The fence that it is on the wrong side of. */
  fence: string | null
  state: RobotState
  /** False until the first pose has arrived. */
  placed: boolean
  /** Pose as shown when the newest one came, and when that was. */
  fromX: number
  fromY: number
  fromHeading: number
  fromTime: number
  /** Newest pose, and when it is to be reached on the screen. */
  x: number
  y: number
  heading: number
  time: number
  /** Server time of the newest pose, Unix milliseconds. */
  sampledAt: number
  /** Millimetres; null without a reading. */
  range: number | null
  lowBattery: boolean
  /** Server time at which the robot was last seen to move or turn. */
  movedAt: number
}

interface Pose {
  x: number
  y: number
  heading: number
}

/**
 * A new pose is reached over the time since the one before, so that motion is
 * even at whatever rate robots report; within these bounds, so that a robot
 * that starts after a rest does not creep.
 */
const SHORTEST_BLEND_MS = 80
const LONGEST_BLEND_MS = 250
/** Displacement that counts as motion: above the grain of the feed. */
const MOVED_METRES = 0.003
const MOVED_RADIANS = 0.01
/** A robot counts as moving this long after it was last seen to. */
export const MOVING_FOR_MS = 700

const TURN = 2 * Math.PI
const NAMES = new Intl.Collator('en', { numeric: true })

export class Fleet {
  private readonly byIndex = new Map<number, Robot>()
  /** The same by place in a list, which is found faster. */
  private readonly slots: (Robot | undefined)[] = []
  private readonly byId = new Map<string, Robot>()
  private expectFullRoster = true
  private sorted: readonly Robot[] | null = null
  /** Server time of the newest frame, Unix milliseconds. */
  newest = 0
  /** When the last robot reaches its newest pose on the screen. */
  settledAt = 0
  /** Poses for robots that the roster does not name. */
  strangers = 0

  get size(): number {
    return this.byIndex.size
  }

  all(): IterableIterator<Robot> {
    return this.byIndex.values()
  }

  /** All robots by name, `sim-2` before `sim-10`; sorted anew only when the roster changes. */
  byName(): readonly Robot[] {
    this.sorted ??= [...this.byIndex.values()].sort((a, b) => NAMES.compare(a.id, b.id))
    return this.sorted
  }

  get(id: string): Robot | undefined {
    return this.byId.get(id)
  }

  /** A new connection: the next roster replaces everything. */
  begin(serverTime: number): void {
    this.expectFullRoster = true
    this.newest = serverTime
  }

  applyRoster(frame: RosterFrame): void {
    this.sorted = null
    if (this.expectFullRoster) {
      const named = new Map(frame.robots.map((entry) => [entry.index, entry.id]))
      for (const robot of [...this.byIndex.values()]) {
        if (named.get(robot.index) !== robot.id) this.remove(robot.index)
      }
      this.expectFullRoster = false
    }
    for (const index of frame.removed) this.remove(index)
    for (const entry of frame.robots) {
      const known = this.byIndex.get(entry.index)
      if (known !== undefined && known.id === entry.id) {
        Object.assign(known, {
          kind: entry.kind,
          firmware: entry.firmware,
          board: entry.board,
          presence: entry.presence,
          fence: entry.fence ?? null,
        })
        continue
      }
      this.remove(entry.index)
      const elsewhere = this.byId.get(entry.id)
      if (elsewhere !== undefined) this.remove(elsewhere.index)
      const robot = newRobot(entry)
      this.byIndex.set(robot.index, robot)
      this.slots[robot.index] = robot
      this.byId.set(robot.id, robot)
    }
  }

  /** Server time of a frame, Unix milliseconds. */
  timeOf(frame: PosesFrame): number {
    return expandTime(frame.ms, this.newest)
  }

  /** Takes poses over; `now` is the time on the screen, by the server's clock. */
  applyPoses(frame: PosesFrame, now: number): void {
    const time = this.timeOf(frame)
    this.newest = Math.max(this.newest, time)
    for (let row = 0; row < frame.count; row++) {
      const robot = this.slots[frame.index[row] as number]
      if (robot === undefined) {
        this.strangers += 1
        continue
      }
      const x = frame.x[row] as number
      const y = frame.y[row] as number
      const range = frame.range[row] as number
      if (!place(robot, x, y, frame.heading[row] as number, time, now)) continue
      if (robot.time > this.settledAt) this.settledAt = robot.time
      robot.state = STATES[frame.state[row] as number] ?? robot.state
      robot.presence = PRESENCES[frame.presence[row] as number] ?? robot.presence
      robot.range = range < 0 ? null : range
      robot.lowBattery = frame.lowBattery[row] === 1
    }
  }

  /** Number of reachable robots seen to move within the last moments. */
  moving(serverNow: number): number {
    let count = 0
    for (const robot of this.byIndex.values()) if (isMoving(robot, serverNow)) count += 1
    return count
  }

  private remove(index: number): void {
    const robot = this.byIndex.get(index)
    if (robot === undefined) return
    this.byIndex.delete(index)
    this.slots[index] = undefined
    if (this.byId.get(robot.id) === robot) this.byId.delete(robot.id)
  }
}

export function isMoving(robot: Robot, serverNow: number): boolean {
  return robot.presence === 'online' && serverNow - robot.movedAt < MOVING_FOR_MS
}

/** Pose on the screen at a server time; the shader does the same. */
export function poseAt(robot: Robot, time: number): Pose {
  const span = robot.time - robot.fromTime
  const share = span > 0 ? Math.min(1, Math.max(0, (time - robot.fromTime) / span)) : 1
  return {
    x: robot.fromX + (robot.x - robot.fromX) * share,
    y: robot.fromY + (robot.y - robot.fromY) * share,
    heading: robot.fromHeading + shortestTurn(robot.fromHeading, robot.heading) * share,
  }
}

/** Signed angle from `from` to `to`, −π ≤ angle < π. */
export function shortestTurn(from: number, to: number): number {
  const turn = to - from + Math.PI
  return turn - Math.floor(turn / TURN) * TURN - Math.PI
}

/**
 * False when the pose is older than what is known: the feed is ordered. Called for every robot
 * of every frame, so it makes no objects.
 */
function place(
  robot: Robot,
  x: number,
  y: number,
  heading: number,
  time: number,
  now: number,
): boolean {
  if (!robot.placed) {
    robot.placed = true
    robot.fromX = x
    robot.fromY = y
    robot.fromHeading = heading
    robot.fromTime = now
    robot.time = now
  } else {
    if (time < robot.sampledAt) return false
    const [dx, dy] = [x - robot.x, y - robot.y]
    const moved =
      dx * dx + dy * dy > MOVED_METRES * MOVED_METRES ||
      Math.abs(shortestTurn(robot.heading, heading)) > MOVED_RADIANS
    if (moved) robot.movedAt = time
    const span = Math.min(LONGEST_BLEND_MS, Math.max(SHORTEST_BLEND_MS, time - robot.sampledAt))
    const blend = robot.time - robot.fromTime
    const share = blend > 0 ? Math.min(1, Math.max(0, (now - robot.fromTime) / blend)) : 1
    robot.fromX += (robot.x - robot.fromX) * share
    robot.fromY += (robot.y - robot.fromY) * share
    robot.fromHeading += shortestTurn(robot.fromHeading, robot.heading) * share
    robot.fromTime = now
    robot.time = now + span
  }
  robot.x = x
  robot.y = y
  robot.heading = heading
  robot.sampledAt = time
  return true
}

/** A robot that nothing is known of but its line in the roster. */
export function newRobot(entry: RosterFrame['robots'][number]): Robot {
  return {
    index: entry.index,
    id: entry.id,
    kind: entry.kind,
    firmware: entry.firmware,
    board: entry.board,
    presence: entry.presence,
    fence: entry.fence ?? null,
    state: 'INITIALIZING',
    placed: false,
    fromX: 0,
    fromY: 0,
    fromHeading: 0,
    fromTime: 0,
    x: 0,
    y: 0,
    heading: 0,
    time: 0,
    sampledAt: 0,
    range: null,
    lowBattery: false,
    movedAt: Number.NEGATIVE_INFINITY,
  }
}
