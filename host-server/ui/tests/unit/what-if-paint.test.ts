// @vitest-environment happy-dom

import { describe, expect, it } from 'vitest'
import { nextTick } from 'vue'
import { mirror } from '../../src/arena/mirror'
import type { Ink } from '../../src/arena/overlay'
import { Stage } from '../../src/arena/stage'
import { Replay } from '../../src/history/replay'
import { paintOverlay } from '../../src/what-if/paint'

const INK: Ink = { panel: 'p', text: 't', accent: 'a', ok: 'o', danger: 'd', mix: [] }
const VIEW = { camera: { x: 0, y: 0, scale: 100 }, size: { width: 800, height: 600 }, radius: 10 }

/** Notes arcs and the colours of strokes. */
function surface() {
  const arcs: number[][] = []
  const strokes: string[] = []
  const context = {
    strokeStyle: '',
    arc: (x: number, y: number, radius: number) => arcs.push([x, y, radius]),
    stroke: () => strokes.push(context.strokeStyle),
    save: () => undefined,
    restore: () => undefined,
    beginPath: () => undefined,
    moveTo: () => undefined,
    lineTo: () => undefined,
    fill: () => undefined,
    setLineDash: () => undefined,
  }
  return { context: context as unknown as CanvasRenderingContext2D, arcs, strokes }
}

const ghost = (x: number, outside: boolean, chosen = false) => {
  return { x, y: 0, theta: 0, drawn: [0, 0] as const, outside, chosen }
}

describe('the overlay of a world', () => {
  it('has discs in their true size', () => {
    const { context, arcs } = surface()
    const discs = [{ x: 1, y: 1, radius: 0.5, chosen: false }]
    expect(paintOverlay(context, INK, { ...VIEW, overlay: { discs, ghosts: [], way: [] } })).toBe(
      true,
    )
    expect(arcs).toEqual([[500, 200, 50]])
  })

  it('has ghosts of robots that were elsewhere, those beyond the draws in another colour', () => {
    const { context, arcs, strokes } = surface()
    const ghosts = [ghost(0.02, false), ghost(0.5, true), ghost(0.3, false)]
    paintOverlay(context, INK, { ...VIEW, overlay: { discs: [], ghosts, way: [] } })
    expect(new Set(arcs.map(([x]) => x))).toEqual(new Set([450, 430]))
    expect(strokes).toContain('d')
    expect(strokes).toContain('t')
  })

  it('is nothing where there is nothing', () => {
    const { context } = surface()
    const overlay = { discs: [], ghosts: [], way: [] }
    expect(paintOverlay(context, INK, { ...VIEW, overlay })).toBe(false)
  })
})

describe('two pictures of one place', () => {
  it('have one view, until both show everything again', async () => {
    const [one, other] = [new Stage(new Replay()), new Stage(new Replay())]
    mirror(one, other)
    one.setCamera({ x: 1, y: 2, scale: 50 })
    await nextTick()
    expect(other.camera.value).toEqual({ x: 1, y: 2, scale: 50 })
    other.setCamera({ x: 0, y: 0, scale: 20 })
    await nextTick()
    expect(one.camera.value.scale).toBe(20)
    one.showEverything()
    await nextTick()
    expect(other.fitted.value).toBe(true)
  })
})
