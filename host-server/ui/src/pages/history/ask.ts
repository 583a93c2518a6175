/** Asking for something that may be given up: only what was asked for last is shown. */

import type { Ref, ShallowRef } from 'vue'
import { onBeforeUnmount, ref, shallowRef } from 'vue'
import { trouble } from '../../account/trouble'

export interface Asked<T> {
  data: ShallowRef<T | null>
  error: Ref<string | null>
  busy: Ref<boolean>
  /** What was asked for before is given up. What is shown stays until there is something newer. */
  ask(fetch: (signal: AbortSignal) => Promise<T>): Promise<void>
  /** The same once more. */
  again(): void
}

export function useAsk<T>(): Asked<T> {
  const data: ShallowRef<T | null> = shallowRef(null)
  const error: Ref<string | null> = ref(null)
  const busy = ref(false)
  let under: AbortController | null = null
  let latest: ((signal: AbortSignal) => Promise<T>) | null = null

  async function ask(fetch: (signal: AbortSignal) => Promise<T>): Promise<void> {
    under?.abort()
    const mine = new AbortController()
    under = mine
    latest = fetch
    busy.value = true
    try {
      const found = await fetch(mine.signal)
      if (mine.signal.aborted) return
      data.value = found
      error.value = null
    } catch (problem) {
      if (!mine.signal.aborted) error.value = trouble(problem)
    } finally {
      if (under === mine) busy.value = false
    }
  }

  onBeforeUnmount(() => under?.abort())
  return {
    data,
    error,
    busy,
    ask,
    again: () => {
      if (latest !== null) void ask(latest)
    },
  }
}
