/**
 * Who is using the page. The short-lived token lives in memory only; a cookie
 * that scripts cannot read brings a new one, before the old one runs out and
 * whenever the page is opened. Tabs hand each other what they get.
 */

import type { Ref } from 'vue'
import { ref } from 'vue'
import type { Ticket } from '../api-types'
import type { Client } from '../client'
import { createClient, quickClient } from '../client'
import type { Send } from '../http'
import { ApiError, fields, numeric, payloadOf, request, text, told } from '../http'
import { words } from '../strings-account'
import type { Exclusive } from './exclusive'
import type { Role } from './roles'
import { parseRole } from './roles'

type SessionState =
  /** Nobody has answered yet. */
  | 'starting'
  /** The server cannot be reached; tried again and again. */
  | 'unreachable'
  /** The server has no accounts: whoever reaches it may do everything. */
  | 'open'
  | 'in'
  | 'out'

/** Why the login page is shown; `null` when nobody was logged in. */
type WhyOut = 'ended' | 'logged-out' | 'elsewhere' | null

/** What came of asking for a new token. */
type Renewal = 'renewed' | 'ended' | 'unreachable'

/** Part of a `BroadcastChannel`. */
export interface Channel {
  postMessage(message: unknown): void
  onmessage: ((event: MessageEvent<unknown>) => void) | null
  close(): void
}

interface SessionOptions {
  send: Send
  exclusive: Exclusive
  channel: Channel | null
  /** Unix milliseconds; goes on while the machine sleeps. */
  now?: () => number
  random?: () => number
}

interface Grant {
  token: string
  /** Unix milliseconds by this machine's clock. */
  expires: number
  user: string
  role: Role
}

/** A token is renewed when this share of its life is left, at most a minute. */
const LEFT_SHARE = 0.25
const LONGEST_LEAD_MS = 60_000
const SHORTEST_WAIT_MS = 500
const RETRY_MS = 3_000
const FIRST_RETRY_MS = 500
const LONGEST_RETRY_MS = 8_000
/** A refusal may come of a new role: look, but not at every refusal. */
const LOOK_AGAIN_MS = 10_000

export class Session {
  readonly state: Ref<SessionState> = ref('starting')
  readonly user: Ref<string | null> = ref(null)
  readonly role: Ref<Role> = ref('viewer')
  readonly why: Ref<WhyOut> = ref(null)
  /** What keeps the page from its start, in words. */
  readonly trouble: Ref<string | null> = ref(null)

  private readonly now: () => number
  private readonly random: () => number
  private grant: Grant | null = null
  /** When to renew, by the same clock. */
  private due = Number.POSITIVE_INFINITY
  private renewing: Promise<Renewal> | null = null
  private timer: ReturnType<typeof setTimeout> | null = null
  private wake: (() => void) | null = null
  private lookedAt = Number.NEGATIVE_INFINITY
  private closed = false

  constructor(private readonly options: SessionOptions) {
    this.now = options.now ?? Date.now
    this.random = options.random ?? Math.random
    if (options.channel !== null) {
      options.channel.onmessage = ({ data }) => this.hear(fields(data))
    }
  }

  /** Finds out whether anyone is logged in; waits for a server that is not there. */
  async start(): Promise<void> {
    for (let wait = FIRST_RETRY_MS; !this.closed; wait = Math.min(LONGEST_RETRY_MS, 2 * wait)) {
      try {
        await this.look()
        this.trouble.value = null
        return
      } catch (error) {
        this.trouble.value = error instanceof Error ? error.message : String(error)
        if (this.state.value === 'starting') this.state.value = 'unreachable'
      }
      await new Promise<void>((resolve) => {
        this.wake = resolve
        setTimeout(resolve, wait * (0.5 + this.random() / 2))
      })
      this.wake = null
    }
  }

  /** Does now what would be done later: after sleep, or when the network is back. */
  hurry(): void {
    this.wake?.()
    if (this.grant !== null && this.now() >= this.due) void this.renew()
  }

  close(): void {
    this.closed = true
    this.wake?.()
    if (this.timer !== null) clearTimeout(this.timer)
    this.options.channel?.close()
  }

  async logIn(user: string, password: string): Promise<void> {
    await this.enter((ask) => ask('post', '/session', { body: { user, password } }))
  }

  /** Makes the account that an invitation is for, and is logged in by it. */
  async accept(code: string, name: string, password: string): Promise<void> {
    const body = { code, ...(name === '' ? {} : { name }), password }
    await this.enter((ask) => ask('post', '/invitations', { body }))
  }

  /** Ends the session at the server; only the server can take the cookie away. */
  async logOut(): Promise<void> {
    // The cookie must not change under it.
    await this.renewing
    const response = await request(this.send, 'DELETE', '/session')
    if (!response.ok && response.status !== 401) await payloadOf(response)
    this.options.channel?.postMessage({ kind: 'out' })
    this.leave('logged-out')
  }

  async changePassword(old: string, next: string): Promise<void> {
    await createClient(this.send)('put', '/session/password', { body: { old, new: next } })
  }

  /** Something to open the live feed with; `null` where none is needed. */
  async ticket(): Promise<string | null> {
    if (this.state.value === 'open') return null
    return text(told<Ticket>(await quickClient(this.send)('post', '/session/ticket')).ticket)
  }

  /** `fetch` in the name of the user; a token that has run out is replaced and the call repeated. */
  readonly send: Send = async (input, init) => {
    if (this.state.value === 'out') return refused()
    const used = this.grant
    const response = await this.options.send(input, signed(init, used))
    if (response.status === 403) this.lookAgain()
    if (response.status !== 401) return response
    const code = fields(
      await response
        .clone()
        .json()
        .catch(() => null),
    )['code']
    // The wrong old password, say: a new token would not help.
    if (code !== 'unauthenticated' && code !== 'expired_token') return response
    if (this.grant === used && (await this.renew()) === 'unreachable') return response
    // Read anew: it may have changed while the answer was on its way.
    if ((this.state.value as SessionState) === 'out') return response
    return this.options.send(input, signed(init, this.grant))
  }

  /** Asks for a new token, once per tab at a time and in one tab at a time. */
  renew(): Promise<Renewal> {
    this.renewing ??= this.renewOnce().finally(() => {
      this.renewing = null
    })
    return this.renewing
  }

  private async renewOnce(): Promise<Renewal> {
    const before = this.grant
    try {
      return await this.options.exclusive(async () => {
        // Another tab was first, and has told.
        if (this.grant !== before && this.grant !== null) return 'renewed'
        const response = await request(this.options.send, 'POST', '/session/refresh')
        if (response.status === 401) return await this.refuse()
        this.take(await payloadOf(response), true)
        return 'renewed'
      })
    } catch (error) {
      const wait = error instanceof ApiError ? error.retryAfter : null
      if (this.grant !== null) this.renewIn(wait === null ? RETRY_MS : wait * 1_000)
      return 'unreachable'
    }
  }

  /** No session by the cookie: then the server is open, or this is the end. */
  private async refuse(): Promise<Renewal> {
    const response = await request(this.options.send, 'GET', '/session')
    if (response.ok && fields(await payloadOf(response))['open'] === true) {
      this.open()
      return 'renewed'
    }
    this.leave(this.grant === null && this.state.value !== 'open' ? null : 'ended')
    return 'ended'
  }

  private async look(): Promise<void> {
    const response = await request(this.options.send, 'GET', '/session')
    if (response.status === 401) {
      if ((await this.renew()) === 'unreachable') throw new ApiError(words.entrance.noAnswer, 0)
      return
    }
    if (fields(await payloadOf(response))['open'] !== true) {
      throw new ApiError(words.entrance.oddAnswer, response.status)
    }
    this.open()
  }

  private lookAgain(): void {
    if (this.grant === null || this.now() - this.lookedAt < LOOK_AGAIN_MS) return
    this.lookedAt = this.now()
    void this.renew()
  }

  private async enter(call: (ask: Client) => Promise<unknown>): Promise<void> {
    try {
      this.take(await call(createClient(this.options.send)), true)
    } catch (error) {
      // It was started anew without accounts while the form was filled in.
      if (!(error instanceof ApiError) || error.code !== 'open_server') throw error
      this.open()
    }
  }

  private take(answer: unknown, tell: boolean): void {
    const body = fields(answer)
    const [token, user, role] = [text(body['token']), text(body['user']), parseRole(body['role'])]
    const seconds = numeric(body['expires_in'])
    if (token === null || user === null || role === null || seconds === null) {
      throw new ApiError(words.entrance.oddAnswer, 200)
    }
    this.adopt({ token, user, role, expires: this.now() + seconds * 1_000 })
    if (tell) this.options.channel?.postMessage({ kind: 'in', ...this.grant })
  }

  private adopt(grant: Grant): void {
    this.grant = grant
    this.user.value = grant.user
    this.role.value = grant.role
    this.why.value = null
    this.state.value = 'in'
    const left = grant.expires - this.now()
    // Drawn by lot, so that not all tabs ask in one instant.
    const lead = Math.min(LONGEST_LEAD_MS, left * LEFT_SHARE) * (1 + this.random())
    this.due = grant.expires - lead
    this.renewIn(Math.max(SHORTEST_WAIT_MS, left - lead))
  }

  private renewIn(milliseconds: number): void {
    if (this.timer !== null) clearTimeout(this.timer)
    this.timer = setTimeout(() => void this.renew(), milliseconds)
  }

  private open(): void {
    this.forget()
    this.user.value = null
    this.role.value = 'admin'
    this.state.value = 'open'
  }

  private leave(why: WhyOut): void {
    this.forget()
    // Whoever was here when a session ends is the likeliest to come back.
    if (why !== 'ended') this.user.value = null
    this.role.value = 'viewer'
    this.why.value = why
    this.state.value = 'out'
  }

  private forget(): void {
    if (this.timer !== null) clearTimeout(this.timer)
    this.timer = null
    this.grant = null
  }

  /** What another tab of this browser tells. */
  private hear(message: Record<string, unknown>): void {
    if (message['kind'] === 'out') {
      // The server may have told this tab first, that its session has ended: nothing is kept now.
      if (this.state.value === 'in' || this.why.value === 'ended') this.leave('elsewhere')
      return
    }
    const [token, user, role] = [
      text(message['token']),
      text(message['user']),
      parseRole(message['role']),
    ]
    const expires = numeric(message['expires'])
    if (token === null || user === null || role === null || expires === null) return
    if (expires > this.now() && this.state.value !== 'open') {
      this.adopt({ token, user, role, expires })
    }
  }
}

function signed(init: RequestInit | undefined, grant: Grant | null): RequestInit {
  const headers = new Headers(init?.headers)
  if (grant !== null) headers.set('authorization', `Bearer ${grant.token}`)
  return { ...init, headers }
}

/** What the server would answer, without asking it. */
function refused(): Response {
  const body = { title: words.entrance.loggedOut, status: 401, code: 'unauthenticated' }
  return new Response(JSON.stringify(body), { status: 401 })
}
