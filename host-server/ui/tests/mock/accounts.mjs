// Accounts of the mock: sessions with tokens that run out and refresh tokens that
// work once, roles, invitations, robots' keys and an audit log. What a closed server does.

import { randomBytes } from 'node:crypto'

const ROLES = ['viewer', 'operator', 'admin']
const COOKIE = 'terracrawler_refresh'
const NAME = /^[a-z][a-z0-9._-]{0,31}$/
const secret = () => randomBytes(32).toString('base64url')

/** An answer that is an error; thrown by the calls below. */
export class Refusal extends Error {
  constructor(status, code, detail, headers = {}) {
    super(detail)
    Object.assign(this, { status, code, headers })
  }
}

export function createAccounts({ open = true, tokenSeconds = 900, freeAttempts = 5 } = {}) {
  const users = new Map()
  const sessions = new Map()
  const invitations = new Map()
  const credentials = new Map()
  const tickets = new Set()
  const failures = new Map()
  const log = []
  const firstCode = secret()
  let nextSession = 1
  let brokenAt = null
  let lost = 0
  invitations.set(firstCode, { name: null, role: 'admin' })

  function audit(who, action, target, outcome = 'ok', detail = {}) {
    log.push({
      seq: log.length + 1,
      at: Date.now(),
      who,
      from: '127.0.0.1',
      action,
      target,
      detail,
      outcome,
      hash: '0'.repeat(64),
    })
  }

  function addUser(name, role, password = null, created = Date.now()) {
    users.set(name, { name, role, password, created, disabled: false })
  }

  function cookieOf(request) {
    const found = (request.headers.cookie ?? '')
      .split('; ')
      .find((part) => part.startsWith(`${COOKIE}=`))
    return found?.slice(COOKIE.length + 1)
  }

  const setCookie = (value, age) =>
    `${COOKIE}=${value}; HttpOnly; SameSite=Strict; Path=/api/v1/session; Max-Age=${age}`

  function enter(user) {
    const id = nextSession++
    const now = Date.now()
    sessions.set(id, {
      id,
      user: user.name,
      from: '127.0.0.1',
      opened: now,
      refreshed: now,
      refresh: secret(),
      used: new Set(),
      tokens: new Map(),
    })
    audit(user.name, 'login', '')
    return grant(sessions.get(id))
  }

  function grant(session) {
    const token = secret()
    session.tokens.set(token, Date.now() + tokenSeconds * 1_000)
    session.refreshed = Date.now()
    const { role } = users.get(session.user)
    return {
      status: 200,
      body: { token, expires_in: tokenSeconds, user: session.user, role },
      headers: { 'set-cookie': setCookie(session.refresh, 1_209_600) },
    }
  }

  function endSessions(name, except = null) {
    for (const [id, session] of sessions) {
      if (session.user === name && id !== except) sessions.delete(id)
    }
  }

  /** Who calls, with at least this role; throws what a server answers otherwise. */
  function caller(request, needed = 'viewer') {
    if (open) return { name: 'server', role: 'admin', session: null }
    const token = (request.headers.authorization ?? '').replace(/^Bearer /, '')
    for (const session of sessions.values()) {
      const expires = session.tokens.get(token)
      if (expires === undefined) continue
      if (expires <= Date.now()) {
        throw new Refusal(401, 'expired_token', 'the token has run out')
      }
      const user = users.get(session.user)
      if (ROLES.indexOf(user.role) < ROLES.indexOf(needed)) {
        throw new Refusal(403, 'forbidden', `this needs the role ${needed}`)
      }
      return { name: user.name, role: user.role, session: session.id }
    }
    throw new Refusal(401, 'unauthenticated', 'log in first')
  }

  function refresh(request) {
    const value = cookieOf(request)
    for (const session of sessions.values()) {
      if (session.used.has(value)) {
        sessions.delete(session.id)
        api.reuses += 1
        audit(session.user, 'refresh', '', 'reused')
        break
      }
      if (value === undefined || session.refresh !== value) continue
      session.used.add(value)
      session.refresh = secret()
      api.refreshes += 1
      return grant(session)
    }
    throw new Refusal(401, 'no_session', 'there is no session')
  }

  function logIn({ user: name, password }) {
    const failed = failures.get(name) ?? 0
    if (failed >= freeAttempts) {
      throw new Refusal(429, 'too_many_attempts', 'wait', { 'retry-after': '30' })
    }
    const user = users.get(name)
    if (user?.password !== password || user.disabled || password === null) {
      failures.set(name, failed + 1)
      audit(name, 'login', '', 'bad_credentials')
      throw new Refusal(401, 'bad_credentials', 'name or password is wrong')
    }
    failures.delete(name)
    return enter(user)
  }

  function accept({ code, name, password }) {
    const invitation = invitations.get(code)
    if (invitation === undefined) {
      throw new Refusal(401, 'bad_invitation', 'the invitation is not valid')
    }
    const who = invitation.name ?? name
    if (!NAME.test(who ?? '') || (name !== undefined && name !== who)) {
      throw new Refusal(422, 'bad_name', 'the invitation is for another name')
    }
    if ([...password].length < 10) throw new Refusal(422, 'weak_password', 'too short')
    invitations.delete(code)
    addUser(who, invitation.role, password)
    return enter(users.get(who))
  }

  function lastAdmin(name) {
    const admins = [...users.values()].filter(
      ({ role, disabled, password }) => role === 'admin' && !disabled && password !== null,
    )
    return admins.length === 1 && admins[0].name === name
  }

  function people(method, name, body, by) {
    if (method === 'GET') {
      const list = [...users.values()].map(({ name, role, created, disabled, password }) => {
        return { name, role, created, disabled, invited: password === null }
      })
      return { status: 200, body: { users: list } }
    }
    if (method === 'POST') {
      if (!NAME.test(body.name ?? '') || !ROLES.includes(body.role)) {
        throw new Refusal(422, 'bad_name', 'this is no name')
      }
      if (users.has(body.name)) throw new Refusal(409, 'user_exists', `${body.name} exists`)
      addUser(body.name, body.role, body.password ?? null)
      const code = secret()
      invitations.set(code, { name: body.name, role: body.role })
      audit(by, 'user.add', body.name, 'ok', { role: body.role })
      return { status: 201, body: { invitation: `http://127.0.0.1:8080/#invite=${code}` } }
    }
    const user = users.get(name)
    if (user === undefined) throw new Refusal(404, 'unknown_user', `no user ${name}`)
    const loses =
      method === 'DELETE' ||
      body.disabled === true ||
      (body.role !== undefined && body.role !== 'admin')
    if (loses && lastAdmin(name)) throw new Refusal(409, 'last_admin', 'the last admin')
    if (method === 'DELETE') {
      users.delete(name)
      endSessions(name)
      audit(by, 'user.remove', name)
    } else {
      Object.assign(user, body)
      if (body.disabled) endSessions(name)
      audit(by, 'user.change', name, 'ok', body)
    }
    return { status: 204 }
  }

  function own(method, id, me) {
    const mine = (session) => session.user === me.name
    if (method === 'GET') {
      const list = [...sessions.values()]
        .filter(mine)
        .map(({ id, user, from, opened, refreshed }) => {
          return { id, user, from, opened, refreshed, current: id === me.session }
        })
      return { status: 200, body: { sessions: list } }
    }
    if (sessions.get(Number(id))?.user !== me.name) {
      throw new Refusal(404, 'unknown_session', 'no such session')
    }
    sessions.delete(Number(id))
    return { status: 204 }
  }

  function auditPage(query) {
    const who = query.get('who')
    const before = Number(query.get('before') ?? Number.POSITIVE_INFINITY)
    const limit = Number(query.get('limit') ?? 50)
    const fits = log.filter((entry) => entry.seq < before && (who === null || entry.who === who))
    const entries = fits.slice(-limit).reverse()
    return {
      status: 200,
      body: { entries, next: fits.length > limit ? entries.at(-1).seq : null },
    }
  }

  const api = {
    open,
    users,
    sessions,
    log,
    firstCode,
    credentials,
    refreshes: 0,
    reuses: 0,
    addUser,
    audit,
    caller,
    endSessions,
    /** All tokens run out now; sessions go on. */
    expireTokens() {
      for (const session of sessions.values()) {
        for (const token of session.tokens.keys()) session.tokens.set(token, 0)
      }
    },
    breakLog(seq) {
      brokenAt = seq
    },
    loseLines(count) {
      lost = count
    },
    setOpen(now) {
      open = now
      api.open = now
    },
    /** Whether a live feed may be opened with this ticket, which is good once. */
    admits: (ticket) => open || tickets.delete(ticket),

    /** Answers a call, or gives `null` when it is none of accounts. */
    answer(request, url, parts, body) {
      const { method } = request
      const call = `${method} ${parts.slice(0, 2).join('/')}`
      if (parts[0] === 'session') {
        switch (call) {
          case 'GET session':
            if (open) return { status: 200, body: { open, user: null, role: 'admin' } }
            return { status: 200, body: { open, ...pick(caller(request)) } }
          case 'POST session':
            return logIn(body)
          case 'POST session/refresh':
            return refresh(request)
          case 'DELETE session': {
            const me = caller(request)
            sessions.delete(me.session)
            audit(me.name, 'logout', '')
            return { status: 204, headers: { 'set-cookie': setCookie('', 0) } }
          }
          case 'PUT session/password': {
            const me = caller(request)
            const user = users.get(me.name)
            if (user.password !== body.old) {
              throw new Refusal(401, 'bad_credentials', 'the old password is wrong')
            }
            user.password = body.new
            endSessions(me.name, me.session)
            audit(me.name, 'password', me.name)
            return { status: 204 }
          }
          case 'POST session/ticket': {
            caller(request)
            const ticket = secret()
            tickets.add(ticket)
            return { status: 200, body: { ticket, expires_in: 30 } }
          }
        }
      }
      if (call === 'POST invitations') return accept(body)
      if (parts[0] === 'sessions') return own(method, parts[1], caller(request))
      if (parts[0] === 'users') {
        return people(method, parts[1], body, caller(request, 'admin').name)
      }
      if (call === 'GET credentials') {
        caller(request, 'admin')
        return { status: 200, body: { credentials: [...credentials.values()] } }
      }
      if (parts[0] === 'robots' && parts[2] === 'credential') {
        const { name: by } = caller(request, 'admin')
        const robot = parts[1]
        if (method === 'POST') {
          credentials.set(robot, { robot, by, created: Date.now(), revoked: null })
          audit(by, 'robot.enrol', robot)
          const key = secret()
          const made = { robot, secret: key, url: `mqtts://${robot}:${key}@127.0.0.1:8883` }
          return { status: 201, body: made }
        }
        const found = credentials.get(robot)
        if (found === undefined) throw new Refusal(404, 'unknown_credential', 'no key')
        found.revoked = Date.now()
        audit(by, 'robot.revoke', robot)
        return { status: 204 }
      }
      if (parts[0] === 'audit') {
        caller(request, 'admin')
        if (parts[1] !== 'verify') return auditPage(url.searchParams)
        const intact = brokenAt === null
        return { status: 200, body: { entries: log.length, intact, broken_at: brokenAt, lost } }
      }
      return null
    },
  }
  return api
}

function pick({ name, role }) {
  return { user: name, role }
}
