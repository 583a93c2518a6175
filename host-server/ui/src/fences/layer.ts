/** The fences of the arena: asked for while it is in view, painted over it, drawn by hand. */

import type { Ref, ShallowRef } from 'vue'
import { ref, shallowRef } from 'vue'
import { trouble } from '../account/trouble'
import type { FenceBody, NewFence } from '../api-types'
import { toScreen, toWorld } from '../arena/camera'
import type { Point } from '../arena/lasso'
import type { Stage } from '../arena/stage'
import type { ArenaTools } from '../arena/tools'
import type { Room } from '../control/room'
import { words } from '../strings-fences'
import type { FencesApi } from './api'
import { paint } from './paint'
import { Pen } from './pen'
import { flawOf, isTangled } from './shape'

/** Others put up fences too. */
const ASK_EVERY_MS = 5_000

export class FenceLayer {
  readonly list: ShallowRef<readonly FenceBody[]> = shallowRef([])
  /** Why the list could not be read, the last time. */
  readonly error: Ref<string | null> = ref(null)
  /** Corners so far, while one is being drawn. */
  readonly corners: ShallowRef<readonly Point[] | null> = shallowRef(null)
  /** What is in the way of closing it. */
  readonly refused = ref('')
  private pen: Pen | null = null
  private done: (corners: readonly Point[] | null) => void = () => undefined
  private timer: ReturnType<typeof setInterval> | null = null
  private latest = 0
  private lift: (() => void) | null = null

  constructor(
    private readonly room: Room,
    private readonly stage: Stage,
    private readonly tools: ArenaTools,
    private readonly api: FencesApi,
  ) {}

  start(): void {
    this.lift = this.stage.lay((context, ink, camera, size) =>
      paint(context, ink, {
        camera,
        size,
        fences: this.list.value,
        corners: this.corners.value ?? [],
      }),
    )
    this.tools.pen = {
      press: (x, y) => this.press(x, y),
      close: () => this.finish(),
      cancel: () => this.end(null),
    }
    window.addEventListener('keydown', this.onKey)
    void this.load()
    this.timer = setInterval(() => {
      if (this.inView) void this.load()
    }, ASK_EVERY_MS)
  }

  stop(): void {
    if (this.timer !== null) clearInterval(this.timer)
    window.removeEventListener('keydown', this.onKey)
    this.lift?.()
    this.lift = null
    this.tools.pen = null
  }

  async load(): Promise<void> {
    this.latest += 1
    const mine = this.latest
    try {
      const list = await this.api.list()
      if (mine !== this.latest) return
      this.error.value = null
      if (JSON.stringify(list) === JSON.stringify(this.list.value)) return
      this.list.value = list
      this.stage.drawOver()
    } catch (error) {
      if (mine === this.latest) this.error.value = trouble(error)
    }
  }

  async save(id: string | null, fence: NewFence): Promise<void> {
    await (id === null ? this.api.add(fence) : this.api.change(id, fence))
    this.room.announcement.value = (id === null ? words.added : words.changed)(fence.name)
    await this.load()
  }

  async remove({ id, name }: FenceBody): Promise<void> {
    await this.api.remove(id)
    this.room.announcement.value = words.removed(name)
    await this.load()
  }

  /** Has corners drawn; `null` when that was given up. */
  draw(): Promise<readonly Point[] | null> {
    this.end(null)
    this.tools.leave()
    this.pen = new Pen()
    this.tools.tool.value = 'fence'
    this.show()
    // Enter must close the fence rather than press the button that began it.
    document.querySelector<HTMLElement>('[data-keys="arena"]')?.focus({ preventScroll: true })
    return new Promise((resolve) => (this.done = resolve))
  }

  finish(): void {
    if (this.pen === null) return
    const flaw = flawOf(this.pen.corners)
    if (flaw === null) this.end(this.pen.corners)
    else this.say(words.flaw(flaw))
  }

  takeBack(): void {
    this.pen?.takeBack()
    this.show()
  }

  cancel(): void {
    this.tools.leave()
  }

  private get inView(): boolean {
    const { room, stage } = this
    return !document.hidden && stage.size.width > 0 && room.status.value.state === 'live'
  }

  private press(x: number, y: number): void {
    const { pen, stage } = this
    if (pen === null) return
    const camera = stage.camera.value
    const stroke = pen.press(
      [x, y],
      toWorld(camera, stage.size, x, y),
      (corner) => toScreen(camera, stage.size, corner[0], corner[1]),
      performance.now(),
    )
    this.show()
    if (stroke === 'close') this.finish()
    if (stroke === 'full') this.say(words.full)
  }

  /** Ends drawing, if there is any. */
  private end(corners: readonly Point[] | null): void {
    if (this.pen === null) return
    this.pen = null
    if (this.tools.tool.value === 'fence') this.tools.tool.value = 'none'
    this.show()
    this.room.announcement.value = corners === null ? words.cancelled : words.drawn(corners.length)
    this.done(corners)
  }

  private say(what: string): void {
    this.refused.value = what
    this.room.announcement.value = what
  }

  private show(): void {
    const { pen } = this
    this.refused.value = pen !== null && isTangled(pen.corners) ? words.tangled : ''
    this.corners.value = pen === null ? null : [...pen.corners]
    this.stage.drawOver()
  }

  private readonly onKey = (event: KeyboardEvent): void => {
    const field = (event.target as Element | null)?.closest?.('input, textarea, select') ?? null
    if (this.pen === null || field !== null || event.key !== 'Backspace') return
    event.preventDefault()
    this.takeBack()
  }
}
