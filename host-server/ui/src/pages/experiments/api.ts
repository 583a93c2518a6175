/** Calls of the pages about experiments. */

import type {
  Experiment,
  ExperimentMetrics,
  NewExperiment,
  NewTraining,
  ScenarioSummary,
  TrainingCurve,
} from '../../api-types'
import type { Act } from '../../experiments/shown'
import { createClient } from '../../client'
import type { Send } from '../../http'
import { ApiError, SLOW_MS, payloadOf, request } from '../../http'

/** The most that a server gives of them at once. */
const TRIALS_AT_ONCE = 5_000
const ROUNDS_AT_ONCE = 2_000
const LISTED_AT_ONCE = 50

export interface ExperimentsApi {
  /** The newest ones, `pages` times as many as the server gives at once. */
  list(pages: number): Promise<{ experiments: readonly Experiment[]; more: boolean }>
  one(id: string): Promise<Experiment>
  create(experiment: NewExperiment | NewTraining): Promise<Experiment>
  act(id: string, act: Act): Promise<Experiment>
  remove(id: string): Promise<void>
  /** Trials after the one of this number; from the first with −1. */
  trials(id: string, after: number): Promise<ExperimentMetrics>
  /** Rounds of a training after the one of this number; from the first with 0. */
  curve(id: string, after: number): Promise<TrainingCurve>
  /** A file of a training. */
  file(id: string, name: string): Promise<Blob>
  /** `null` from a server that does not list them. */
  scenarios(): Promise<readonly ScenarioSummary[] | null>
}

export function experimentsApi(send: Send): ExperimentsApi {
  const ask = createClient(send)

  return {
    async list(pages) {
      const found: Experiment[] = []
      let before: string | null = null
      for (let page = 0; page < pages; page++) {
        const query: { limit: number; before: string | null } = { limit: LISTED_AT_ONCE, before }
        const told = await ask('get', '/experiments', { query })
        found.push(...told.experiments)
        before = told.next ?? null
        if (before === null) break
      }
      return { experiments: found, more: before !== null }
    },
    one: (id) => ask('get', '/experiments/{id}', { path: { id } }),
    create: (experiment) => ask('post', '/experiments', { body: experiment }),
    act: (id, act) => ask('post', `/experiments/{id}/${act}`, { path: { id } }),
    async remove(id) {
      await ask('delete', '/experiments/{id}', { path: { id } })
    },
    trials(id, after) {
      const query = { limit: TRIALS_AT_ONCE, after: after < 0 ? null : after }
      return ask('get', '/experiments/{id}/metrics', { path: { id }, query })
    },
    curve(id, after) {
      const query = { limit: ROUNDS_AT_ONCE, after }
      return ask('get', '/experiments/{id}/curve', { path: { id }, query })
    },
    async file(id, name) {
      const path = `/experiments/${encodeURIComponent(id)}/files/${encodeURIComponent(name)}`
      const answer = await request(send, 'GET', path, undefined, SLOW_MS)
      if (!answer.ok) await payloadOf(answer)
      return answer.blob()
    },
    async scenarios() {
      try {
        return (await ask('get', '/simulator/scenarios')).scenarios
      } catch (error) {
        if (error instanceof ApiError && error.status === 404) return null
        throw error
      }
    },
  }
}

/** Whether a server knows nothing of experiments: a little older, or without a simulator. */
export function isWithout(error: unknown): boolean {
  return error instanceof ApiError && error.status === 404
}
