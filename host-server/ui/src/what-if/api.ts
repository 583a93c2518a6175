/** The calls for counterfactuals: what would have been, had robots been told something else. */

import type { Counterfactual, NewCounterfactual } from '../api-types'
import { createClient } from '../client'
import type { Send } from '../http'

export interface WhatIfApi {
  /** Those that the server keeps, the newest first, without their answers. */
  list(): Promise<readonly Counterfactual[]>
  one(id: string): Promise<Counterfactual>
  ask(wanted: NewCounterfactual): Promise<Counterfactual>
  /** Ends it where it runs, and forgets it. */
  remove(id: string): Promise<unknown>
}

export function whatIfApi(send: Send): WhatIfApi {
  const ask = createClient(send)
  return {
    list: async () => (await ask('get', '/counterfactuals')).counterfactuals,
    one: (id) => ask('get', '/counterfactuals/{id}', { path: { id } }),
    ask: (body) => ask('post', '/counterfactuals', { body }),
    remove: (id) => ask('delete', '/counterfactuals/{id}', { path: { id } }),
  }
}
