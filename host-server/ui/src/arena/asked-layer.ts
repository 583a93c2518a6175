/**
 * A layer of the arena that shows what the server says of the selected robot: asked for again and again while it is
 * shown, and painted under goals.
 */

import type { Ref, ShallowRef } from 'vue'
import { ref, shallowRef, watch } from 'vue'
import type { Room } from '../control/room'
import type { Camera, Size } from './camera'
import type { Ink } from './overlay'
import type { Stage } from './stage'

/** What a layer makes of a question that failed. */
export interface Failure {
  /** Whether what was shown is no longer so; else it stays, as only an answer is missing. */
  gone: boolean
  said: string
}

export abstract class AskedLayer<Body> {
  /** In words what is shown, or why there is nothing. */
  readonly said: Ref<string> = ref('')
  /** Null while there is none. */
  protected readonly body: ShallowRef<Body | null> = shallowRef(null)
  private timer: ReturnType<typeof setTimeout> | null = null
  /** Counts questions: an answer to an earlier one is late. */
  private latest = 0
  private lift: (() => void) | null = null
  private unwatch: (() => void) | null = null

  constructor(
    protected readonly room: Room,
    private readonly stage: Stage,
    /** From an answer to the next question, and from one that failed, milliseconds. */
    private readonly everyMs: number,
    private readonly againMs: number,
  ) {}

  /** Asks for what there is of a robot. */
  protected abstract ask(robot: string): Promise<Body>
  /** Puts it in words; before there is any, or a robot, `null`. */
  protected abstract describe(robot: string | null, body: Body | null): string
  protected abstract fail(robot: string, error: unknown): Failure
  protected abstract paint(
    context: CanvasRenderingContext2D,
    ink: Ink,
    view: { camera: Camera; size: Size },
    body: Body,
  ): boolean

  start(): void {
    this.lift = this.stage.lay((context, ink, camera, size) => {
      const body = this.body.value
      return body !== null && this.paint(context, ink, { camera, size }, body)
    })
    this.unwatch = watch(this.room.selectedId, () => this.begin(), { immediate: true })
  }

  stop(): void {
    this.latest += 1
    if (this.timer !== null) clearTimeout(this.timer)
    this.timer = null
    this.unwatch?.()
    this.lift?.()
    ;[this.unwatch, this.lift] = [null, null]
    this.show(null, '')
  }

  /** Another robot is selected, or none. */
  private begin(): void {
    this.show(null, this.describe(this.room.selectedId.value, null))
    void this.go()
  }

  private async go(): Promise<void> {
    if (this.timer !== null) clearTimeout(this.timer)
    this.latest += 1
    const mine = this.latest
    const robot = this.room.selectedId.value
    if (robot === null) return
    let wait = this.everyMs
    if (this.inView) {
      try {
        const body = await this.ask(robot)
        if (mine !== this.latest) return
        this.show(body, this.describe(robot, body))
      } catch (error) {
        if (mine !== this.latest) return
        wait = this.againMs
        const { gone, said } = this.fail(robot, error)
        this.show(gone ? null : this.body.value, said)
      }
    }
    this.timer = setTimeout(() => void this.go(), wait)
  }

  private get inView(): boolean {
    const { room, stage } = this
    return !document.hidden && stage.size.width > 0 && room.status.value.state === 'live'
  }

  private show(body: Body | null, said: string): void {
    this.said.value = said
    if (body === null && this.body.value === null) return
    this.body.value = body
    this.stage.drawOver()
  }
}
