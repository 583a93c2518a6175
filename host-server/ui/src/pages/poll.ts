/** Asking for something again and again while somebody looks. */

import type { Ref, ShallowRef } from 'vue'
import { onBeforeUnmount, ref, shallowRef } from 'vue'
import { trouble } from '../account/trouble'

interface Polled<T> {
  data: ShallowRef<T | null>
  error: Ref<string | null>
  busy: Ref<boolean>
  /** At once, and then as often as before; resolves with the answer. */
  again(): Promise<void>
}

/** `every` is asked after each answer; `null` stops until `again`. What was shown stays. */
export function usePoll<T>(fetch: () => Promise<T>, every: () => number | null): Polled<T> {
  const data: ShallowRef<T | null> = shallowRef(null)
  const error: Ref<string | null> = ref(null)
  const busy = ref(false)
  let timer: ReturnType<typeof setTimeout> | null = null
  let latest = 0

  async function ask(): Promise<void> {
    if (timer !== null) clearTimeout(timer)
    timer = null
    latest += 1
    const mine = latest
    if (!document.hidden || data.value === null) {
      busy.value = true
      try {
        const found = await fetch()
        if (mine !== latest) return
        data.value = found
        error.value = null
      } catch (problem) {
        if (mine !== latest) return
        error.value = trouble(problem)
      } finally {
        if (mine === latest) busy.value = false
      }
    }
    const wait = every()
    if (wait !== null) timer = setTimeout(() => void ask(), wait)
  }

  void ask()
  onBeforeUnmount(() => {
    latest += 1
    if (timer !== null) clearTimeout(timer)
  })
  return { data, error, busy, again: ask }
}
