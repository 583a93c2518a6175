/** The picture in a component: its surfaces, what hands and buttons do to the view, and its end. */

import type { Ref } from 'vue'
import { computed, onBeforeUnmount, onMounted, ref, useTemplateRef, watch } from 'vue'
import { theme } from '../theme'
import { panBy, scaleBar, zoomAt } from './camera'
import type { Extent } from './renderer'
import type { Shown } from './stage'
import { Stage } from './stage'

/** Beyond this many robots cones and trails of all hide more than they show. */
const MOST_CONES = 300

interface StageOptions {
  /** Changes when robots have been counted anew. */
  tick: Readonly<Ref<number>>
  selected: () => string | null
  /** What the arena changes with: a moment of the record must not be drawn in another one. */
  flush?: 'sync' | 'pre'
}

/** For a component whose template names `box`, `canvas`, `over` and `label`. */
export function useStage(shown: Shown, { tick, selected, flush = 'pre' }: StageOptions) {
  const stage = new Stage(shown)
  const box = useTemplateRef<HTMLElement>('box')
  const canvas = useTemplateRef<HTMLCanvasElement>('canvas')
  const over = useTemplateRef<HTMLCanvasElement>('over')
  const label = useTemplateRef<HTMLElement>('label')
  /** Null until somebody chooses: then all of them, as long as they hide nothing. */
  const chosenCones = ref<Extent | null>(null)
  const cones = computed<Extent>(() => {
    void tick.value
    return chosenCones.value ?? (shown.fleet.size > MOST_CONES ? 'selected' : 'all')
  })
  const trails = ref<Extent>('selected')
  const bar = ref({ metres: 1, pixels: 100 })

  function zoom(factor: number): void {
    // While following, the robot stays in the middle, which is what this zooms on.
    const { size } = stage
    stage.setCamera(zoomAt(stage.camera.value, size, size.width / 2, size.height / 2, factor))
  }

  function showEverything(): void {
    stage.follow.value = false
    stage.showEverything()
  }

  function moveTo(x: number, y: number): void {
    stage.look({ ...stage.camera.value, x, y })
  }

  function toggleFollow(): void {
    stage.follow.value = !stage.follow.value && selected() !== null
  }

  /** What moves the view by hand: a part of the gestures. */
  const moves = {
    pan: (dx: number, dy: number) => stage.look(panBy(stage.camera.value, dx, dy)),
    zoom: (x: number, y: number, factor: number) =>
      stage.setCamera(zoomAt(stage.camera.value, stage.size, x, y, factor)),
  }

  function onLost(event: Event): void {
    // Without this the browser does not give the context back.
    event.preventDefault()
    stage.lose()
  }

  watch(stage.camera, (now) => {
    const metres = scaleBar(now)
    const pixels = Math.round(metres * now.scale)
    // Following moves the view with every picture; the bar has nothing to do with that.
    if (metres !== bar.value.metres || pixels !== bar.value.pixels) bar.value = { metres, pixels }
  })
  watch(shown.arena, () => stage.setArena(), { flush })
  watch(
    [cones, trails, stage.follow],
    () => {
      stage.cones = cones.value
      stage.trails = trails.value
      stage.draw()
    },
    { immediate: true },
  )
  watch(theme, () => stage.recolour(), { flush: 'post' })
  watch(selected, (id) => {
    if (id === null) stage.follow.value = false
  })

  const night = matchMedia('(prefers-color-scheme: dark)')
  const recolour = (): void => stage.recolour()
  const redraw = (): void => stage.draw()
  let observer: ResizeObserver | null = null
  let ratioQuery: MediaQueryList | null = null

  function watchRatio(): void {
    ratioQuery?.removeEventListener('change', watchRatio)
    ratioQuery = matchMedia(`(resolution: ${String(devicePixelRatio)}dppx)`)
    ratioQuery.addEventListener('change', watchRatio)
    stage.resize()
  }

  onMounted(() => {
    if (!box.value || !canvas.value || !over.value || !label.value) return
    stage.start({ box: box.value, canvas: canvas.value, over: over.value, label: label.value })
    observer = new ResizeObserver(() => stage.resize())
    observer.observe(box.value)
    watchRatio()
    night.addEventListener('change', recolour)
    document.addEventListener('visibilitychange', redraw)
  })
  onBeforeUnmount(() => {
    stage.stop()
    observer?.disconnect()
    ratioQuery?.removeEventListener('change', watchRatio)
    night.removeEventListener('change', recolour)
    document.removeEventListener('visibilitychange', redraw)
  })

  return {
    stage,
    box,
    canvas,
    chosenCones,
    cones,
    trails,
    bar,
    zoom,
    showEverything,
    moveTo,
    toggleFollow,
    moves,
    onLost,
  }
}
