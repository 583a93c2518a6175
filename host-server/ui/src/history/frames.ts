/** Lets the clock of what is played go on with the pictures of the browser. */

import type { Player } from './player'

export class Frames {
  private request = 0
  private frameAt = 0

  constructor(private readonly player: Pick<Player, 'playing' | 'advance'>) {}

  start(): void {
    this.stop()
    this.frameAt = performance.now()
    this.request = requestAnimationFrame((wall) => this.picture(wall))
  }

  stop(): void {
    cancelAnimationFrame(this.request)
  }

  private picture(wall: number): void {
    if (!this.player.playing.value) return
    this.player.advance(wall - this.frameAt, wall)
    this.frameAt = wall
    this.request = requestAnimationFrame((next) => this.picture(next))
  }
}
