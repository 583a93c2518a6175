/** The calls that manage accounts, keys and the audit log; needed by the pages only. */

import type { AuditVerdict, NewCredential, NewUser } from '../api-types'
import { createClient } from '../client'
import type { Send } from '../http'
import { fields, numeric, text, told } from '../http'
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
  const ask = createClient(send)

  return {
    async users(): Promise<User[]> {
      return list(await ask('get', '/users'), 'users').flatMap((item) => {
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
      return text(told<NewUser>(await ask('post', '/users', { body: { name, role } })).invitation)
    },
    async change(name: string, change: { role?: Role; disabled?: boolean }): Promise<void> {
      await ask('patch', '/users/{name}', { path: { name }, body: change })
    },
    async remove(name: string): Promise<void> {
      await ask('delete', '/users/{name}', { path: { name } })
    },

    async sessions(): Promise<OpenSession[]> {
      return list(await ask('get', '/sessions'), 'sessions').flatMap((item) => {
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
      await ask('delete', '/sessions/{id}', { path: { id } })
    },

    async credentials(): Promise<Credential[]> {
      return list(await ask('get', '/credentials'), 'credentials').flatMap((item) => {
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
      const body = told<NewCredential>(
        await ask('post', '/robots/{id}/credential', { path: { id: robot } }),
      )
      return {
        robot: text(body.robot) ?? robot,
        secret: text(body.secret) ?? '',
        url: text(body.url) ?? '',
      }
    },
    async revoke(robot: string): Promise<void> {
      await ask('delete', '/robots/{id}/credential', { path: { id: robot } })
    },

    async audit(who: string, before: number | null, limit: number): Promise<AuditPage> {
      const query = { limit, who: who === '' ? null : who, before }
      const body = await ask('get', '/audit', { query })
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
      const body = told<AuditVerdict>(
        await ask('get', '/audit/verify', {}, { milliseconds: VERIFY_MS }),
      )
      return {
        entries: numeric(body.entries) ?? 0,
        intact: body.intact === true,
        brokenAt: numeric(body.broken_at),
        lost: numeric(body.lost) ?? 0,
      }
    },
  }
}

function list(body: unknown, name: string): Record<string, unknown>[] {
  const found = Array.isArray(body) ? body : fields(body)[name]
  return Array.isArray(found) ? found.map(fields) : []
}
