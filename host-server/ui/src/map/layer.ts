/**
 * What the selected robot knows of its surroundings, and its plan: asked for again and again while the layer is
 * shown, and painted under goals.
 */

import type { Ref, ShallowRef } from 'vue'
import { ref, shallowRef, watch } from 'vue'
import { trouble } from '../account/trouble'
import type { MapBody } from '../api-types'
import type { Stage } from '../arena/stage'
import type { Room } from '../control/room'
import { ApiError } from '../http'
import { words } from '../strings-map'
import type { MapApi } from './api'
import { paint } from './paint'

/** From one answer to the next question: the server asks the robot no more often. */
export const ASK_EVERY_MS = 1_000
/** What is then no longer so: the robot has gone, has no map, or never had one. */
const GONE = new Set(['no_map', 'tells_no_map', 'unknown_robot', 'robot_offline'])

export class MapLayer {
  /** Null while there is none. */
  readonly map: ShallowRef<MapBody | null> = shallowRef(null)
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
    private readonly api: MapApi,
  ) {}

  start(): void {
    this.lift = this.stage.lay((context, ink, camera, size) => {
      const map = this.map.value
      return map !== null && paint(context, ink, { camera, size, map })
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
    if (this.inView) {
      try {
        const map = await this.api.map(robot)
        if (mine !== this.latest) return
        this.show(map, words.map(robot, map))
      } catch (error) {
        if (mine !== this.latest) return
        const code = error instanceof ApiError ? error.code : null
        const gone = code !== null && GONE.has(code)
        const why = code === 'no_map' ? words.none(robot) : words.failed(robot, trouble(error))
        // What was shown stays where only an answer is missing.
        this.show(gone ? null : this.map.value, why)
      }
    }
    this.timer = setTimeout(() => void this.ask(), ASK_EVERY_MS)
  }

  private get inView(): boolean {
    const { room, stage } = this
    return !document.hidden && stage.size.width > 0 && room.status.value.state === 'live'
  }

  private show(map: MapBody | null, said: string): void {
    this.said.value = said
    if (map === null && this.map.value === null) return
    this.map.value = map
    this.stage.drawOver()
  }
}
