/** Something that a page shows once the server has given it. */

import type { Ref, ShallowRef } from 'vue'
import { ref, shallowRef } from 'vue'
import { trouble } from '../account/trouble'

interface Loaded<T> {
  data: ShallowRef<T | null>
  error: Ref<string | null>
  busy: Ref<boolean>
  load(): Promise<void>
}

/** Asks at once. What was shown stays until there is something newer. */
export function useLoad<T>(fetch: () => Promise<T>): Loaded<T> {
  const data: ShallowRef<T | null> = shallowRef(null)
  const error: Ref<string | null> = ref(null)
  const busy = ref(false)
  let latest = 0

  async function load(): Promise<void> {
    latest += 1
    const mine = latest
    busy.value = true
    try {
      const found = await fetch()
      if (mine !== latest) return
      data.value = found
      error.value = null
    } catch (problem) {
      if (mine === latest) error.value = trouble(problem)
    } finally {
      if (mine === latest) busy.value = false
    }
  }

  void load()
  return { data, error, busy, load }
}
