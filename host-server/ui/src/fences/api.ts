/** Calls about fences. */

import type { FenceBody, NewFence } from '../api-types'
import { createClient } from '../client'
import type { Send } from '../http'

export interface FencesApi {
  list(): Promise<readonly FenceBody[]>
  add(fence: NewFence): Promise<FenceBody>
  change(id: string, fence: NewFence): Promise<FenceBody>
  remove(id: string): Promise<void>
}

export function fencesApi(send: Send): FencesApi {
  const ask = createClient(send)

  return {
    async list() {
      return (await ask('get', '/fences')).fences
    },
    add: (fence) => ask('post', '/fences', { body: fence }),
    change: (id, fence) => ask('put', '/fences/{id}', { path: { id }, body: fence }),
    async remove(id) {
      await ask('delete', '/fences/{id}', { path: { id } })
    },
  }
}
