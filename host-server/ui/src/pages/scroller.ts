/** A box that scrolls over more rows than are rendered. */

import type { ComputedRef, Ref } from 'vue'
import { computed, onBeforeUnmount, onMounted, ref } from 'vue'
import type { Window } from '../fleet/rows'
import { reveal, visible } from '../fleet/rows'

interface Scroller {
  window: ComputedRef<Window>
  width: Ref<number>
  onScroll(event: Event): void
  /** Scrolls a row into view. */
  reveal(row: number): void
}

export function useScroller(
  box: Readonly<Ref<HTMLElement | null>>,
  rowHeight: number,
  rows: () => number,
  /** What stands above the first row and stays there, pixels. */
  head = 0,
): Scroller {
  const top = ref(0)
  const height = ref(400)
  const width = ref(800)
  let observer: ResizeObserver | null = null
  onMounted(() => {
    const element = box.value
    if (element === null) return
    observer = new ResizeObserver(() => {
      height.value = element.clientHeight
      width.value = element.clientWidth
    })
    observer.observe(element)
  })
  onBeforeUnmount(() => observer?.disconnect())
  return {
    window: computed(() => visible(top.value, height.value, rowHeight, rows())),
    width,
    onScroll(event) {
      top.value = (event.target as HTMLElement).scrollTop
    },
    reveal(row) {
      const element = box.value
      if (element === null) return
      element.scrollTop = reveal(row, element.scrollTop, element.clientHeight - head, rowHeight)
      top.value = element.scrollTop
    },
  }
}
