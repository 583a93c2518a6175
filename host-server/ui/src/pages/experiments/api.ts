/** Calls of the pages about experiments. */

import type {
  Experiment,
  ExperimentMetrics,
  NewExperiment,
  ScenarioSummary,
  Scenarios,
} from '../../api-types'
import type { Act } from '../../experiments/shown'
import type { Send } from '../../http'
import { ApiError, SLOW_MS, call, fields, payloadOf, request, text } from '../../http'

/** The most that a server gives of them at once. */
export const TRIALS_AT_ONCE = 5_000
export const LISTED_AT_ONCE = 50

/** The server has looked at a form and does not take it: what is wrong with which field. */
export class FormRefused extends ApiError {
  constructor(
    from: ApiError,
    readonly errors: readonly { field: string; message: string }[],
  ) {
    super(from.message, from.status, from.code, from.retryAfter, from.detail)
  }
}

export interface ExperimentsApi {
  /** The newest ones, `pages` times as many as the server gives at once. */
  list(pages: number): Promise<{ experiments: readonly Experiment[]; more: boolean }>
  one(id: string): Promise<Experiment>
  create(experiment: NewExperiment): Promise<Experiment>
  act(id: string, act: Act): Promise<Experiment>
  remove(id: string): Promise<void>
  /** Trials after the one of this number; from the first with −1. */
  trials(id: string, after: number): Promise<ExperimentMetrics>
  /** `null` from a server that does not list them. */
  scenarios(): Promise<readonly ScenarioSummary[] | null>
}

export function experimentsApi(send: Send): ExperimentsApi {
  // The server's answers are what it says they are: a test on its side holds it to that.
  const ask = async <T>(method: string, path: string, body?: unknown): Promise<T> =>
    (await call(send, method, path, body, SLOW_MS)) as T
  const of = (id: string): string => `/experiments/${encodeURIComponent(id)}`

  return {
    async list(pages) {
      const found: Experiment[] = []
      let before: string | null = null
      for (let page = 0; page < pages; page++) {
        const from: string = before === null ? '' : `&before=${encodeURIComponent(before)}`
        const path = `/experiments?limit=${String(LISTED_AT_ONCE)}${from}`
        const told = await ask<{ experiments: Experiment[]; next?: string | null }>('GET', path)
        found.push(...told.experiments)
        before = told.next ?? null
        if (before === null) break
      }
      return { experiments: found, more: before !== null }
    },
    one: (id) => ask('GET', of(id)),
    async create(experiment) {
      const answer = await request(send, 'POST', '/experiments', experiment, SLOW_MS)
      const copy = answer.clone()
      try {
        return (await payloadOf(answer)) as Experiment
      } catch (error) {
        const errors = wrongFields(await copy.json().catch(() => null))
        throw error instanceof ApiError && errors.length > 0
          ? new FormRefused(error, errors)
          : error
      }
    },
    act: (id, act) => ask('POST', `${of(id)}/${act}`),
    async remove(id) {
      await ask('DELETE', of(id))
    },
    trials(id, after) {
      const from = after < 0 ? '' : `&after=${String(after)}`
      return ask('GET', `${of(id)}/metrics?limit=${String(TRIALS_AT_ONCE)}${from}`)
    },
    async scenarios() {
      try {
        return (await ask<Scenarios>('GET', '/simulator/scenarios')).scenarios
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

function wrongFields(payload: unknown): { field: string; message: string }[] {
  const errors = fields(payload)['errors']
  if (!Array.isArray(errors)) return []
  return errors.flatMap((one: unknown) => {
    const [field, message] = [text(fields(one)['field']), text(fields(one)['message'])]
    return message === null ? [] : [{ field: field ?? '', message }]
  })
}
