/** Calls of the part of the page about updates that is about rollouts. */

import type {
  NewRollout,
  Release,
  RobotBody,
  Rollout,
  RolloutRobot,
  RolloutRobotDetail,
  UpdateState,
} from '../../api-types'
import { createClient } from '../../client'
import type { Send } from '../../http'
import { ApiError } from '../../http'
import type { Acts, RobotActs } from '../../updates/rollouts'

const LISTED_AT_ONCE = 50
export const ROBOTS_AT_ONCE = 200
/** More than a server keeps of either. */
const MOST_PAGES = 100

export interface RolloutList {
  rollouts: readonly Rollout[]
  more: boolean
}

export interface RolloutsApi {
  /** The newest ones, `pages` times as many as the server gives at once. */
  list(pages: number): Promise<RolloutList>
  /** All that the server has. */
  all(): Promise<readonly Rollout[]>
  /** `null` where there is none of that id. */
  one(id: string): Promise<Rollout | null>
  /** By name, `pages` times as many as the server gives at once. */
  robots(
    id: string,
    state: UpdateState | null,
    pages: number,
  ): Promise<{ robots: readonly RolloutRobot[]; more: boolean }>
  robot(id: string, robot: string): Promise<RolloutRobotDetail>
  begin(plan: NewRollout): Promise<Rollout>
  act(id: string, act: Acts): Promise<Rollout>
  actOn(id: string, robot: string, act: RobotActs): Promise<Rollout>
  /** All releases that the server has. */
  releases(): Promise<readonly Release[]>
  /** Every robot that the server knows. */
  fleet(): Promise<readonly RobotBody[]>
}

export function rolloutsApi(send: Send): RolloutsApi {
  const ask = createClient(send)

  async function list(pages: number): Promise<RolloutList> {
    const found: Rollout[] = []
    let before: string | null = null
    for (let page = 0; page < pages; page++) {
      const query: { limit: number; before: string | null } = { limit: LISTED_AT_ONCE, before }
      const told = await ask('get', '/rollouts', { query })
      found.push(...told.rollouts)
      before = told.next ?? null
      if (before === null) break
    }
    return { rollouts: found, more: before !== null }
  }

  return {
    list,
    all: async () => (await list(MOST_PAGES)).rollouts,
    async one(id) {
      try {
        return await ask('get', '/rollouts/{id}', { path: { id } })
      } catch (error) {
        if (error instanceof ApiError && error.code === 'unknown_rollout') return null
        throw error
      }
    },
    async robots(id, state, pages) {
      const found: RolloutRobot[] = []
      let after: string | null = null
      for (let page = 0; page < pages; page++) {
        const query: { limit: number; state: string | null; after: string | null } = {
          limit: ROBOTS_AT_ONCE,
          state,
          after,
        }
        const told = await ask('get', '/rollouts/{id}/robots', { path: { id }, query })
        found.push(...told.robots)
        after = told.next ?? null
        if (after === null) break
      }
      return { robots: found, more: after !== null }
    },
    robot: (id, robot) => ask('get', '/rollouts/{id}/robots/{robot}', { path: { id, robot } }),
    begin: (plan) => ask('post', '/rollouts', { body: plan }),
    act: (id, act) => ask('post', `/rollouts/{id}/${act}`, { path: { id } }),
    actOn: (id, robot, act) =>
      ask('post', `/rollouts/{id}/robots/{robot}/${act}`, { path: { id, robot } }),
    async releases() {
      const found: Release[] = []
      let before: string | null = null
      for (let page = 0; page < MOST_PAGES; page++) {
        const query: { limit: number; before: string | null } = { limit: LISTED_AT_ONCE, before }
        const told = await ask('get', '/releases', { query })
        found.push(...told.releases)
        before = told.next ?? null
        if (before === null) break
      }
      return found
    },
    fleet: async () => (await ask('get', '/robots')).robots,
  }
}
