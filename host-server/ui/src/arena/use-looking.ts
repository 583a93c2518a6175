/** An arena to look at and not to drive in: fingers, mouse and keys move the view, and choose a robot. */

import { clusterAt } from './cluster'
import { useGestures } from './gestures'
import { nearest } from './pick'
import type { Shown } from './stage'
import type { useStage } from './use-stage'

/** Finger or pointer this close to a robot selects it, pixels. */
const REACH = 18
const ZOOM_STEP = 1.25

/** `more`: what other keys do. */
export function useLooking(
  shown: Shown,
  { stage, canvas, zoom, showEverything, moves }: ReturnType<typeof useStage>,
  chosen: (robot: string | null) => void,
  more: Readonly<Record<string, () => void>> = {},
) {
  function choose(x: number, y: number, reach: number): void {
    chosen(nearest(shown.fleet.all(), stage.view(), x, y, reach)?.id ?? null)
  }

  useGestures(canvas, {
    ...moves,
    tap(x, y) {
      const view = stage.view()
      const cluster = clusterAt(stage.clusters.value, view.camera, view.size, x, y)
      if (cluster === null) choose(x, y, view.points ? 3 : REACH)
      else stage.comeNear(cluster)
    },
    lassoing: () => false,
    lassoStart: () => undefined,
    lassoMove: () => undefined,
    lassoEnd: () => undefined,
  })

  function onKey(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey) return
    const { width, height } = stage.size
    const keys: Readonly<Record<string, () => void>> = {
      ArrowLeft: () => stage.step(-1, 0),
      ArrowRight: () => stage.step(1, 0),
      ArrowUp: () => stage.step(0, 1),
      ArrowDown: () => stage.step(0, -1),
      '+': () => zoom(ZOOM_STEP),
      '=': () => zoom(ZOOM_STEP),
      '-': () => zoom(1 / ZOOM_STEP),
      Home: showEverything,
      Enter: () => choose(width / 2, height / 2, Math.max(width, height)),
      ...more,
    }
    const act = keys[event.key]
    if (act === undefined) return
    event.preventDefault()
    act()
  }

  function showCross(): void {
    stage.cross = canvas.value?.matches(':focus-visible') ?? false
    stage.drawOver()
  }

  return { onKey, showCross }
}
