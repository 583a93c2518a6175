/** The calls that manage accounts, keys and the audit log; needed by the pages only. */

import type { Send } from '../http'
import { SLOW_MS, call, fields, numeric, text } from '../http'
import type { Role } from './roles'
import { parseRole } from './roles'

export interface User {
  name: string
  role: Role
  /** Invited and not here yet: without a password nobody can log in. */
  invited: boolean
  disabled: boolean
  /** Unix milliseconds, as all times here. */
  created: number | null
}

export interface OpenSession {
  id: string
  user: string
  from: string
  opened: number | null
  refreshed: number | null
  /** The one this page uses. */
  current: boolean
}

export interface Credential {
  robot: string
  by: string
  created: number | null
  revoked: number | null
}

export interface Enrolment {
  robot: string
  secret: string
  url: string
}

export interface AuditEntry {
  seq: number
  at: number
  who: string
  from: string
  action: string
  target: string
  detail: unknown
  outcome: string
}

export interface AuditPage {
  entries: AuditEntry[]
  /** Where the next, older page begins; `null` at the end. */
  next: number | null
}

export interface AuditCheck {
  entries: number
  intact: boolean
  brokenAt: number | null
  /** Lines that could not be written when they came. */
  lost: number
}

/** Reading the whole log takes its time. */
const VERIFY_MS = 120_000

export function accountApi(send: Send) {
  const ask = (method: string, path: string, body?: unknown, milliseconds = SLOW_MS) =>
    call(send, method, path, body, milliseconds)
  const user = (name: string) => `/users/${encodeURIComponent(name)}`
  const credential = (robot: string) => `/robots/${encodeURIComponent(robot)}/credential`

  return {
    async users(): Promise<User[]> {
      return list(await ask('GET', '/users'), 'users').flatMap((item) => {
        const [name, role] = [text(item['name']), parseRole(item['role'])]
        if (name === null || role === null) return []
        const invited =
          item['invited'] === true || item['pending'] === true || item['has_password'] === false
        const [disabled, created] = [item['disabled'] === true, numeric(item['created'])]
        return [{ name, role, invited, disabled, created }]
      })
    },
    /** Gives the invitation's link. */
    async invite(name: string, role: Role): Promise<string | null> {
      return text(fields(await ask('POST', '/users', { name, role }))['invitation'])
    },
    async change(name: string, change: { role?: Role; disabled?: boolean }): Promise<void> {
      await ask('PATCH', user(name), change)
    },
    async remove(name: string): Promise<void> {
      await ask('DELETE', user(name))
    },

    async sessions(): Promise<OpenSession[]> {
      return list(await ask('GET', '/sessions'), 'sessions').flatMap((item) => {
        const id = text(item['id']) ?? numeric(item['id'])
        if (id === null) return []
        return [
          {
            id: String(id),
            user: text(item['user']) ?? '',
            from: text(item['from']) ?? '',
            opened: numeric(item['opened']),
            refreshed: numeric(item['refreshed']),
            current: item['current'] === true,
          },
        ]
      })
    },
    async endSession(id: string): Promise<void> {
      await ask('DELETE', `/sessions/${encodeURIComponent(id)}`)
    },

    async credentials(): Promise<Credential[]> {
      return list(await ask('GET', '/credentials'), 'credentials').flatMap((item) => {
        const robot = text(item['robot']) ?? text(item['name'])
        if (robot === null) return []
        return [
          {
            robot,
            by: text(item['by']) ?? '',
            created: numeric(item['created']),
            revoked: numeric(item['revoked']),
          },
        ]
      })
    },
    async enrol(robot: string): Promise<Enrolment> {
      const body = fields(await ask('POST', credential(robot)))
      return {
        robot: text(body['robot']) ?? robot,
        secret: text(body['secret']) ?? '',
        url: text(body['url']) ?? '',
      }
    },
    async revoke(robot: string): Promise<void> {
      await ask('DELETE', credential(robot))
    },

    async audit(who: string, before: number | null, limit: number): Promise<AuditPage> {
      const query = new URLSearchParams({ limit: String(limit) })
      if (who !== '') query.set('who', who)
      if (before !== null) query.set('before', String(before))
      const body = await ask('GET', `/audit?${query.toString()}`)
      const entries = list(body, 'entries').flatMap((item) => {
        const [seq, at] = [numeric(item['seq']), numeric(item['at'])]
        if (seq === null || at === null) return []
        const word = (name: string) => text(item[name]) ?? ''
        return [
          {
            seq,
            at,
            who: word('who'),
            from: word('from'),
            action: word('action'),
            target: word('target'),
            detail: item['detail'] ?? null,
            outcome: word('outcome'),
          },
        ]
      })
      return { entries, next: numeric(fields(body)['next']) }
    },
    async verifyAudit(): Promise<AuditCheck> {
      const body = fields(await ask('GET', '/audit/verify', undefined, VERIFY_MS))
      return {
        entries: numeric(body['entries']) ?? 0,
        intact: body['intact'] === true,
        brokenAt: numeric(body['broken_at']),
        lost: numeric(body['lost']) ?? 0,
      }
    },
  }
}

export type AccountApi = ReturnType<typeof accountApi>

function list(body: unknown, name: string): Record<string, unknown>[] {
  const found = Array.isArray(body) ? body : fields(body)[name]
  return Array.isArray(found) ? found.map(fields) : []
}
