/**
 * Sliding to confirm: what a finger does by mistake must not be enough, and what
 * a hand that cannot drag does must be.
 */

/** Share of the way that counts as all of it. */
const FAR_ENOUGH = 0.95
/** A jump further than this was a tap on the track, not a slide. */
const LONGEST_JUMP = 0.34

type Slid = 'sliding' | 'confirmed' | 'jumped'

export class Slide {
  private at = 0

  /** The handle is at this share of the way now. */
  to(share: number): Slid {
    const jump = share - this.at
    if (jump > LONGEST_JUMP) {
      this.at = 0
      return 'jumped'
    }
    this.at = share
    if (share < FAR_ENOUGH) return 'sliding'
    this.at = 0
    return 'confirmed'
  }

  /** Let go before the end: back to the beginning. */
  release(): void {
    this.at = 0
  }
}
