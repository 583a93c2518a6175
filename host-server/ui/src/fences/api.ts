/** Calls about fences. */

import type { FenceBody, FencesBody, NewFence } from '../api-types'
import type { Send } from '../http'
import { SLOW_MS, call } from '../http'

export interface FencesApi {
  list(): Promise<readonly FenceBody[]>
  add(fence: NewFence): Promise<FenceBody>
  change(id: string, fence: NewFence): Promise<FenceBody>
  remove(id: string): Promise<void>
}

export function fencesApi(send: Send): FencesApi {
  const ask = async <T>(method: string, path: string, body?: unknown): Promise<T> =>
    (await call(send, method, path, body, SLOW_MS)) as T
  const of = (id: string): string => `/fences/${encodeURIComponent(id)}`

  return {
    async list() {
      return (await ask<FencesBody>('GET', '/fences')).fences
    },
    add: (fence) => ask('POST', '/fences', fence),
    change: (id, fence) => ask('PUT', of(id), fence),
    async remove(id) {
      await ask('DELETE', of(id))
    },
  }
}
