/** Calls of the page about updates. */

import type { Release, ReleaseDetail } from '../../api-types'
import { createClient } from '../../client'
import type { Send } from '../../http'
import { call } from '../../http'

/** Megabytes take their time. */
const UPLOAD_MS = 120_000
const LISTED_AT_ONCE = 50

export interface ReleaseList {
  releases: readonly Release[]
  more: boolean
  /** Whether the server has a public key to believe releases by. */
  canAdd: boolean
}

export interface UpdatesApi {
  /** Those that were added last, `pages` times as many as the server gives at once. */
  releases(pages: number): Promise<ReleaseList>
  release(id: string): Promise<ReleaseDetail>
  add(file: Blob): Promise<ReleaseDetail>
  withdraw(id: string, reason: string): Promise<ReleaseDetail>
}

export function updatesApi(send: Send): UpdatesApi {
  const ask = createClient(send)

  return {
    async releases(pages) {
      const found: Release[] = []
      let [before, canAdd]: [string | null, boolean] = [null, false]
      for (let page = 0; page < pages; page++) {
        const query: { limit: number; before: string | null } = { limit: LISTED_AT_ONCE, before }
        const told = await ask('get', '/releases', { query })
        found.push(...told.releases)
        canAdd = told.can_add
        before = told.next ?? null
        if (before === null) break
      }
      return { releases: found, more: before !== null, canAdd }
    },
    release: (id) => ask('get', '/releases/{id}', { path: { id } }),
    // The only body that is no JSON.
    add: async (file) => (await call(send, 'POST', '/releases', file, UPLOAD_MS)) as ReleaseDetail,
    withdraw: (id, reason) =>
      ask('post', '/releases/{id}/withdraw', { path: { id }, body: { reason } }),
  }
}
