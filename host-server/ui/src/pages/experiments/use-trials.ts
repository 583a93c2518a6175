/** The trials of an experiment, asked for as they are done. */

import type { Ref } from 'vue'
import { onBeforeUnmount, ref } from 'vue'
import { trouble } from '../../account/trouble'
import { Trials } from '../../experiments/trials'
import type { ExperimentsApi } from './api'

interface TrialsOf {
  readonly trials: Trials
  /** Changes whenever `trials` has: it is kept outside Vue's reactivity. */
  readonly loaded: Ref<number>
  readonly error: Ref<string | null>
  /** Asks until it has all there are. One call at a time; more than one is one. */
  pull(): Promise<void>
}

export function useTrials(api: ExperimentsApi, id: string): TrialsOf {
  const trials = new Trials()
  const loaded = ref(0)
  const error = ref<string | null>(null)
  let busy = false
  let closed = false

  async function pull(): Promise<void> {
    if (busy || closed) return
    busy = true
    try {
      for (let more = true; more && !closed;) {
        const page = await api.trials(id, trials.last)
        // A page without anything new ends it, whatever the server says of more.
        more = trials.append(page) > 0 && (page.next ?? null) !== null
        loaded.value = trials.count
        error.value = null
      }
    } catch (problem) {
      error.value = trouble(problem)
    } finally {
      busy = false
    }
  }

  onBeforeUnmount(() => {
    closed = true
  })
  return { trials, loaded, error, pull }
}
