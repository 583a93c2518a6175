/** Drawing a fence corner by corner: what a click or a tap means. */

import type { Point } from '../arena/lasso'
import { MOST_CORNERS, rounded } from './shape'

/** A second click so soon and so near closes. */
const TWICE_MS = 450
const TWICE_PIXELS = 12
/** As does one so near to the first corner. */
const FIRST_PIXELS = 14

type Stroke = 'corner' | 'close' | 'full'

export class Pen {
  /** Metres. */
  readonly corners: Point[] = []
  private last: { at: Point; time: number } | null = null

  /** A press at `at`, which is `place` on the ground; `onScreen` says where a corner is seen. */
  press(at: Point, place: Point, onScreen: (corner: Point) => Point, time: number): Stroke {
    const { last } = this
    this.last = { at, time }
    const [first] = this.corners
    if (last !== null && time - last.time < TWICE_MS && apart(last.at, at) < TWICE_PIXELS) {
      return 'close'
    }
    const enough = this.corners.length >= 3
    if (enough && first !== undefined && apart(onScreen(first), at) < FIRST_PIXELS) return 'close'
    if (this.corners.length >= MOST_CORNERS) return 'full'
    this.corners.push(rounded(place))
    return 'corner'
  }

  /** False when there was none left. */
  takeBack(): boolean {
    this.last = null
    return this.corners.pop() !== undefined
  }
}

function apart(a: Point, b: Point): number {
  return Math.hypot(a[0] - b[0], a[1] - b[1])
}
