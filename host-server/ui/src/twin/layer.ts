/**
 * The twin of the selected robot: where it is by what its motors did, and where it will be in a second. Asked for again
 * and again while the layer is shown, and painted under goals.
 */

import type { Ref, ShallowRef } from 'vue'
import { ref, shallowRef, watch } from 'vue'
import { trouble } from '../account/trouble'
import type { TwinForecastsBody } from '../api-types'
import type { Stage } from '../arena/stage'
import type { Room } from '../control/room'
import { ApiError } from '../http'
import { words } from '../strings-twin'
import type { TwinApi } from './api'
import { paint } from './paint'

/** From one answer to the next question: twins are stepped as telemetry comes, five times a second. */
export const ASK_EVERY_MS = 400
/** Where there is none, there will not be one so soon. */
export const AGAIN_MS = 2_000
/** What is then no longer so. */
const GONE = new Set(['no_twin', 'unknown_robot'])

export class TwinLayer {
  /** Null while there is none. */
  readonly twin: ShallowRef<TwinForecastsBody | null> = shallowRef(null)
  /** The same in words, or why there is none. */
  readonly said: Ref<string> = ref('')
  private timer: ReturnType<typeof setTimeout> | null = null
  /** Counts questions: an answer to an earlier one is late. */
  private latest = 0
  private lift: (() => void) | null = null
  private unwatch: (() => void) | null = null

  constructor(
    private readonly room: Room,
    private readonly stage: Stage,
    private readonly api: Pick<TwinApi, 'forecast'>,
  ) {}

  start(): void {
    this.lift = this.stage.lay((context, ink, camera, size) => {
      const twin = this.twin.value
      return twin !== null && paint(context, ink, { camera, size, twin })
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
    const robot = this.room.selectedId.value
    this.show(null, robot === null ? words.nobody : words.asking(robot))
    void this.ask()
  }

  private async ask(): Promise<void> {
    if (this.timer !== null) clearTimeout(this.timer)
    this.latest += 1
    const mine = this.latest
    const robot = this.room.selectedId.value
    if (robot === null) return
    let wait = ASK_EVERY_MS
    if (this.inView) {
      try {
        const twin = await this.api.forecast(robot)
        if (mine !== this.latest) return
        this.show(twin, words.twin(robot, twin, this.room.serverNow()))
      } catch (error) {
        if (mine !== this.latest) return
        wait = AGAIN_MS
        const gone = error instanceof ApiError && GONE.has(error.code ?? '')
        // What was shown stays where only an answer is missing.
        this.show(gone ? null : this.twin.value, words.failed(robot, trouble(error)))
      }
    }
    this.timer = setTimeout(() => void this.ask(), wait)
  }

  private get inView(): boolean {
    const { room, stage } = this
    return !document.hidden && stage.size.width > 0 && room.status.value.state === 'live'
  }

  private show(twin: TwinForecastsBody | null, said: string): void {
    this.said.value = said
    if (twin === null && this.twin.value === null) return
    this.twin.value = twin
    this.stage.drawOver()
  }
}
