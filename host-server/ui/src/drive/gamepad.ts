/**
 * A gamepad: what its sticks and buttons mean. The stick springs back, which makes it a dead man's
 * handle of its own; after any stop it must have been let go once before it drives again.
 */

import type { Driver, Push } from './driver'

/** The part of the browser's `Gamepad` that matters here. */
export interface Pad {
  readonly index: number
  readonly connected: boolean
  readonly axes: readonly number[]
  readonly buttons: readonly { readonly pressed: boolean }[]
}

/** Sticks that are let go are not quite at zero. */
export const DEAD_ZONE = 0.15

/** Buttons of the standard mapping. */
const STOP_ROBOT = 0
const STOP_ALL = 1
const PREVIOUS = 4
const NEXT = 5
const DPAD = { up: 12, down: 13, left: 14, right: 15 } as const

/** Where the left stick or the cross is pushed; null when it is let go. */
export function pushOf(pad: Pick<Pad, 'axes' | 'buttons'>): Push | null {
  const [x, y] = [finite(pad.axes[0]), finite(pad.axes[1])]
  const far = Math.hypot(x, y)
  let push: Push = { ahead: 0, left: 0 }
  if (far > DEAD_ZONE) {
    // From zero at the rim of the dead zone, so that nothing jumps there; a corner is no faster.
    const gain = Math.min(1, (far - DEAD_ZONE) / (1 - DEAD_ZONE)) / far
    push = { ahead: -y * gain, left: -x * gain }
  }
  const down = (button: number): number => Number(pad.buttons[button]?.pressed === true)
  const ahead = push.ahead + down(DPAD.up) - down(DPAD.down)
  const left = push.left + down(DPAD.left) - down(DPAD.right)
  if (ahead === 0 && left === 0) return null
  // Adding zero turns −0 into 0.
  return { ahead: cut(ahead) + 0, left: cut(left) + 0 }
}

function finite(value: number | undefined): number {
  return value !== undefined && Number.isFinite(value) ? value : 0
}

function cut(value: number): number {
  return Math.min(1, Math.max(-1, value))
}

interface PadActions {
  driver: Driver
  /** Brings what blocks driving up to date. */
  prepare(): void
  stopRobot(): void
  stopAll(): void
  neighbour(step: 1 | -1): void
}

/** Follows one gamepad; `look` is called with every picture. */
export class PadDriver {
  /** The stick was pushed when something stopped the robot, and has not been let go since. */
  waits = true
  private readonly source: string
  private readonly pressed = new Set<number>()
  private stops: number
  private pushing = false

  constructor(
    index: number,
    private readonly act: PadActions,
  ) {
    this.source = `gamepad:${String(index)}`
    this.stops = act.driver.stops
  }

  /** Stopping is always possible; driving only where `mayDrive` says so, which is asked when needed. */
  look(pad: Pad, mayDrive: () => boolean = () => true): void {
    if (!pad.connected) {
      this.letGo()
      return
    }
    this.press(pad, STOP_ALL, () => this.act.stopAll())
    this.press(pad, STOP_ROBOT, () => this.act.stopRobot())
    this.press(pad, PREVIOUS, () => this.act.neighbour(-1))
    this.press(pad, NEXT, () => this.act.neighbour(1))
    const push = pushOf(pad)
    const { driver } = this.act
    // Something else stopped the robot: a key let go, a lost window, a button on the page.
    if (this.pushing && driver.stops !== this.stops) {
      this.pushing = false
      this.waits = true
    }
    if (push === null) {
      this.letGo()
      this.waits = false
    } else if (!mayDrive()) {
      this.letGo()
    } else if (!this.waits) {
      this.act.prepare()
      this.stops = driver.stops
      this.pushing = driver.push(this.source, push)
      // What is refused now must not start by itself later.
      if (!this.pushing) this.waits = true
    }
  }

  /** The gamepad is gone, or nobody looks at it any more. */
  letGo(): void {
    if (this.pushing) this.act.driver.release(this.source)
    this.pushing = false
    this.waits = true
  }

  /** Acts once for each press; a button that stops also drops what the stick holds. */
  private press(pad: Pad, button: number, act: () => void): void {
    const down = pad.buttons[button]?.pressed === true
    if (down && !this.pressed.has(button)) {
      this.letGo()
      act()
    }
    if (down) this.pressed.add(button)
    else this.pressed.delete(button)
  }
}
