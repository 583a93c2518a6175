/** What the charts share: colours of the page, a size that follows its box, and few drawings. */

import uPlot from 'uplot'
import 'uplot/dist/uPlot.min.css'
import type { Ref } from 'vue'
import { onBeforeUnmount, onMounted, watch } from 'vue'
import { theme } from '../theme'

/** At most ten drawings a second, however fast a window is dragged. */
const REDRAW_MS = 100
/** Narrower than this, labels cover each other, CSS pixels. */
const LEAST_WIDTH = 200

/** What a chart is built with. */
export interface Looks {
  /** A custom property of the style sheet. */
  tone(name: string): string
  /** Size of letters that the style sheet gives, CSS pixels. */
  letter: number
  axis: uPlot.Axis
}

interface PlotOptions {
  /** CSS pixels. */
  height: (element: HTMLElement) => number
  options: (looks: Looks) => Omit<uPlot.Options, 'width' | 'height'>
  data: () => uPlot.AlignedData
  /** It was built, drawn anew or made larger or smaller. */
  onPlaced?: (plot: uPlot) => void
  /** It was built: what listens to the one before is gone. */
  onBuilt?: (plot: uPlot) => void
}

export function usePlot(box: Readonly<Ref<HTMLElement | null>>, given: PlotOptions) {
  const { onPlaced = () => undefined, onBuilt = () => undefined } = given
  const dark = matchMedia('(prefers-color-scheme: dark)')
  let plot: uPlot | null = null
  let observer: ResizeObserver | null = null
  let pending: ReturnType<typeof setTimeout> | null = null

  const sizeOf = (element: HTMLElement) => ({
    width: Math.max(LEAST_WIDTH, element.clientWidth),
    height: given.height(element),
  })

  /** Makes it anew: colours, or what is in it, are others. */
  function build(): void {
    const element = box.value
    if (element === null) return
    plot?.destroy()
    const style = getComputedStyle(element)
    const tone = (name: string): string => style.getPropertyValue(name).trim()
    const looks: Looks = {
      tone,
      letter: Number.parseFloat(style.fontSize),
      axis: {
        stroke: tone('--quiet'),
        grid: { stroke: tone('--line'), width: 1 },
        ticks: { stroke: tone('--line'), width: 1, size: 4 },
      },
    }
    plot = new uPlot({ ...sizeOf(element), ...given.options(looks) }, given.data(), element)
    onBuilt(plot)
    onPlaced(plot)
  }

  /** Draws what there is now, soon; with `anew` it is made anew where that says so. */
  function redraw(anew: () => boolean = () => false): void {
    pending ??= setTimeout(() => {
      pending = null
      if (anew()) {
        build()
        return
      }
      plot?.setData(given.data())
      if (plot !== null) onPlaced(plot)
    }, REDRAW_MS)
  }

  watch(theme, build, { flush: 'post' })
  onMounted(() => {
    build()
    const element = box.value
    if (element === null) return
    observer = new ResizeObserver(() => {
      plot?.setSize(sizeOf(element))
      if (plot !== null) onPlaced(plot)
    })
    observer.observe(element)
    dark.addEventListener('change', build)
  })
  onBeforeUnmount(() => {
    if (pending !== null) clearTimeout(pending)
    dark.removeEventListener('change', build)
    observer?.disconnect()
    plot?.destroy()
  })

  return { redraw, plot: () => plot }
}

/** Numbers of an axis with a minus that is one. */
export function signs(_self: uPlot, ticks: number[]): string[] {
  return ticks.map((tick) => String(tick).replace('-', '−'))
}
