/**
 * The picture: renderer, overlay and view, and when to draw. A new picture is made only when
 * something changed or is still on its way to its newest pose.
 */

import type { Ref, ShallowRef } from 'vue'
import { ref, shallowRef } from 'vue'
import type { Arena } from '../feed/decode'
import type { Fleet, Robot } from '../fleet/fleet'
import { poseAt } from '../fleet/fleet'
import type { Selection } from '../fleet/selection'
import { readPalette } from '../theme'
import type { Bounds, Camera, Size } from './camera'
import { fit, panBy, toScreen, zoomAt } from './camera'
import type { Cluster } from './cluster'
import { clusters } from './cluster'
import type { Goal } from './goals'
import type { Point } from './lasso'
import type { Ink, Under } from './overlay'
import { drawOver, readInk } from './overlay'
import { boundsOf, smallestRadius, union } from './pick'
import type { Extent, View } from './renderer'
import { Renderer, drawnRadius } from './renderer'
import { arenaBounds } from './scene'
import type { Past } from './trails'

/** Room for the tools above, and for scale and legend below where there is any. */
const MARGINS = { top: 56, sides: 16, bottom: 48 }
const LOW_MARGINS = { top: 52, sides: 12, bottom: 14 }
const LOW = 380
/** Height of the name of the selected robot, pixels. */
const LABEL_HEIGHT = 24
/** Without a graphics card, pictures come no faster than this. */
const SLOW_PICTURE_MS = 80
/** Robots are counted anew no faster than this while the view rests. */
const COUNT_EVERY_MS = 250
/** An arrow moves the view by this share of it. */
const STEP_SHARE = 0.15
/** Clicking a cluster zooms in by this much. */
const INTO_CLUSTER = 2.2
/** Robots of another world are told of a little later than its walls. */
export const NEW_WORLD_MS = 5_000

/** What is shown: the live room, or a moment of the record. */
export interface Shown {
  readonly arena: Readonly<Ref<Arena | null>>
  readonly fleet: Pick<Fleet, 'all' | 'get' | 'size' | 'settledAt'>
  readonly selection: Selection
  readonly selected: Robot | undefined
  /** The time to draw, Unix milliseconds. */
  serverNow(): number
  /** Where robots were before, where that is known; else trails are what was shown before. */
  readonly past?: Past
}

interface Surfaces {
  box: HTMLElement
  canvas: HTMLCanvasElement
  over: HTMLCanvasElement
  label: HTMLElement
}

export class Stage {
  readonly camera: ShallowRef<Camera> = shallowRef({ x: 0, y: 0, scale: 60 })
  readonly problem: Ref<'none' | 'no-webgl' | 'lost'> = ref('none')
  readonly clusters: ShallowRef<readonly Cluster[]> = shallowRef([])
  /** False once the operator has moved the view; until then it fits itself. */
  readonly fitted = ref(true)
  size: Size = { width: 0, height: 0 }
  readonly follow = ref(false)
  cones: Extent = 'all'
  trails: Extent = 'selected'
  lasso: readonly Point[] = []
  cross = false
  goals: readonly Goal[] = []
  /** Pictures drawn so far. */
  pictures = 0
  /** What there is to see, where that is not what the robots of the moment are in. */
  frame: Bounds | null = null
  /** Called with each of them. */
  onPicture: (view: View) => void = () => undefined

  private readonly unders = new Set<Under>()
  private surfaces: Surfaces | null = null
  private renderer: Renderer | null = null
  private ink: Ink | null = null
  private request = 0
  private timer: ReturnType<typeof setTimeout> | null = null
  private drawnAt = 0
  private countedAt = Number.NEGATIVE_INFINITY
  private stalePoses = true
  private staleOver = true
  private hadRobots = false
  /** Sides of the arena that is shown; null before the first. */
  private ground: string | null = null
  /** By then robots have been told of in another world; until then the view fits itself anew. */
  private settledAt = 0
  /** The view that everything fits in, found when poses came; robots may be beyond the walls. */
  private whole: Bounds = { minX: -3, minY: -3, maxX: 3, maxY: 3 }
  private readonly calm = matchMedia('(prefers-reduced-motion: reduce)')

  constructor(readonly room: Shown) {}

  start(surfaces: Surfaces): void {
    this.surfaces = surfaces
    this.renderer = Renderer.create(surfaces.canvas)
    if (this.renderer === null) this.problem.value = 'no-webgl'
    this.setArena()
    this.recolour()
    this.resize()
  }

  stop(): void {
    cancelAnimationFrame(this.request)
    if (this.timer !== null) clearTimeout(this.timer)
    this.surfaces = null
    this.renderer = null
  }

  /** Something changed: a picture is due. */
  draw(): void {
    if (this.request !== 0) return
    const wait =
      this.renderer?.slow === true ? this.drawnAt + SLOW_PICTURE_MS - performance.now() : 0
    if (wait <= 0) this.request = requestAnimationFrame(() => this.picture())
    else this.timer ??= setTimeout(() => this.drawLater(), wait)
  }

  /** Poses, selection or group changed. */
  drawPoses(): void {
    this.stalePoses = true
    this.draw()
  }

  /** Goals, lasso or cross changed. */
  drawOver(): void {
    this.staleOver = true
    this.draw()
  }

  /** Lays something under goals and lasso, over what was laid there before; the result takes it away. */
  lay(under: Under): () => void {
    this.unders.add(under)
    this.drawOver()
    return () => {
      this.unders.delete(under)
      this.drawOver()
    }
  }

  setArena(): void {
    const arena = this.room.arena.value
    this.renderer?.setArena(arena)
    // Another world, not only another thing in it: what was looked at is no more.
    const ground = arena === null ? '' : `${String(arena.width)} ${String(arena.height)}`
    const other = this.ground !== null && this.ground !== ground
    this.ground = ground
    if (other) {
      this.follow.value = false
      this.settledAt = performance.now() + NEW_WORLD_MS
    }
    if (this.fitted.value || other) this.showEverything()
    this.draw()
  }

  setCamera(next: Camera): void {
    this.fitted.value = false
    this.moveTo(next)
  }

  /** Moves the view by hand: nobody is followed any more. */
  look(next: Camera): void {
    this.follow.value = false
    this.setCamera(next)
  }

  /** Moves the view by a step of so many to the right and up, as arrow keys do. */
  step(right: number, up: number): void {
    const pixels = STEP_SHARE * Math.min(this.size.width, this.size.height)
    this.look(panBy(this.camera.value, -right * pixels, up * pixels))
  }

  /** Comes so near to a cluster that its robots part. */
  comeNear({ x, y }: Cluster): void {
    const at = toScreen(this.camera.value, this.size, x, y)
    this.look(zoomAt(this.camera.value, this.size, at[0], at[1], INTO_CLUSTER))
  }

  showEverything(): void {
    this.fitted.value = true
    this.moveTo(this.fitting())
  }

  /** What there is to see. */
  everything(): Bounds {
    if (this.frame !== null) return this.frame
    const robots = boundsOf(this.room.fleet.all())
    const arena = this.room.arena.value
    if (arena === null) return robots ?? { minX: -3, minY: -3, maxX: 3, maxY: 3 }
    // Robots report where they believe to be, which may be beyond the walls.
    return union(arenaBounds(arena), robots)
  }

  view(): View {
    const { room, size } = this
    return {
      camera: this.camera.value,
      size,
      time: this.calm.matches ? Number.MAX_SAFE_INTEGER : room.serverNow(),
      smallest: smallestRadius(room.fleet.size, this.whole, this.camera.value),
      cones: this.cones,
      trails: this.trails,
      points: this.clusters.value.length > 0,
    }
  }

  resize(): void {
    const { surfaces } = this
    if (surfaces === null) return
    this.size = { width: surfaces.box.clientWidth, height: surfaces.box.clientHeight }
    const ratio = this.renderer?.slow === true ? 1 : devicePixelRatio
    for (const [surface, share] of [
      [surfaces.canvas, ratio],
      [surfaces.over, devicePixelRatio],
    ] as const) {
      surface.width = Math.max(1, Math.round(this.size.width * share))
      surface.height = Math.max(1, Math.round(this.size.height * share))
    }
    if (this.fitted.value) this.moveTo(this.fitting())
    this.drawOver()
  }

  recolour(): void {
    if (this.surfaces === null) return
    this.ink = readInk(this.surfaces.canvas)
    this.renderer?.setPalette(readPalette(this.surfaces.canvas))
    this.drawOver()
  }

  lose(): void {
    this.renderer?.lose()
    this.problem.value = 'lost'
  }

  restore(): void {
    this.renderer?.restore()
    this.problem.value = 'none'
    this.drawPoses()
  }

  private fitting(): Camera {
    this.whole = this.everything()
    return fit(this.whole, this.size, this.size.height < LOW ? LOW_MARGINS : MARGINS)
  }

  private moveTo(camera: Camera): void {
    this.camera.value = camera
    this.countedAt = Number.NEGATIVE_INFINITY
    this.drawOver()
  }

  private drawLater(): void {
    this.timer = null
    this.draw()
  }

  private picture(): void {
    this.request = 0
    const { renderer, room, surfaces } = this
    if (surfaces === null || this.size.width === 0 || document.hidden) return
    const selected = room.selected
    if (this.stalePoses) this.takePoses(selected?.id ?? null)
    let pose = selected?.placed === true ? poseAt(selected, this.view().time) : null
    if (this.follow.value && pose !== null) {
      const { x, y, scale } = this.camera.value
      const moved = (x - pose.x) ** 2 + (y - pose.y) ** 2 > (0.25 / scale) ** 2
      if (moved) this.setCamera({ x: pose.x, y: pose.y, scale })
    }
    this.drawnAt = performance.now()
    this.count()
    const view = this.view()
    pose = selected?.placed === true ? poseAt(selected, view.time) : null
    renderer?.draw(view)
    this.pictures += 1
    this.placeLabel(
      surfaces.label,
      view,
      pose === null ? null : toScreen(view.camera, this.size, pose.x, pose.y),
    )
    this.placeOver(surfaces.over, view)
    this.onPicture(view)
    // Another picture only while something is still on its way to its newest pose.
    if (!this.calm.matches && view.time < room.fleet.settledAt) this.draw()
  }

  private takePoses(selected: string | null): void {
    const { fleet, selection } = this.room
    this.stalePoses = false
    this.renderer?.setRobots(
      () => fleet.all(),
      selected,
      selection.ids.value,
      this.room.serverNow(),
      performance.now(),
      this.room.past,
    )
    const begins = !this.hadRobots && fleet.size > 0
    if (begins) this.hadRobots = true
    if (this.fitted.value && (begins || performance.now() < this.settledAt)) this.showEverything()
  }

  private count(): void {
    const now = performance.now()
    if (now - this.countedAt < COUNT_EVERY_MS) return
    this.countedAt = now
    this.whole = this.everything()
    const found = clusters(this.room.fleet.all(), this.camera.value, this.size)
    if (found.length === 0 && this.clusters.value.length === 0) return
    this.clusters.value = found
    this.staleOver = true
  }

  private placeLabel(label: HTMLElement, view: View, at: [number, number] | null): void {
    if (label.hidden !== (at === null)) label.hidden = at === null
    if (at === null) return
    const below = at[1] + drawnRadius(view) * view.camera.scale * 2.1 + 4
    // By the number of letters: to ask for its width would make the browser lay out the page.
    const half = Math.min(this.size.width / 2, (label.textContent.length * 7.4 + 20) / 2)
    const x = Math.min(this.size.width - half, Math.max(half, at[0]))
    const y = Math.min(this.size.height - LABEL_HEIGHT, Math.max(0, below))
    // Whole pixels: letters stay sharp, and a robot that creeps moves nothing.
    const place = `translate(${String(Math.round(x))}px, ${String(Math.round(y))}px) translateX(-50%)`
    if (label.style.transform !== place) label.style.transform = place
  }

  private placeOver(surface: HTMLCanvasElement, view: View): void {
    if ((!this.staleOver && this.goals.length === 0) || this.ink === null) return
    this.staleOver = false
    const goals = this.goals.map((goal) => {
      const robot = this.room.fleet.get(goal.robot)
      if (robot?.placed !== true) return { goal, from: null }
      const { x, y } = poseAt(robot, view.time)
      return { goal, from: toScreen(view.camera, this.size, x, y) }
    })
    // An empty one would be put together with the picture sixty times a second all the same.
    surface.hidden = !drawOver(surface, this.ink, {
      camera: view.camera,
      size: this.size,
      unders: this.unders,
      clusters: this.clusters.value,
      goals,
      lasso: this.lasso,
      cross: this.cross,
    })
  }
}
