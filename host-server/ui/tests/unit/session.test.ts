import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import { createApi } from '../../src/api'
import type { Exclusive } from '../../src/account/exclusive'
import { exclusively } from '../../src/account/exclusive'
import type { Channel } from '../../src/account/session'
import { Session } from '../../src/account/session'

type Answer = { status?: number; body?: unknown; headers?: Record<string, string> } | 'down'

/** A server that remembers what was asked; routes are `METHOD path`. */
function server(routes: Record<string, () => Answer>) {
  const calls: { what: string; token: string | null; body: unknown }[] = []
  const send: typeof fetch = async (input, init) => {
    const what = `${init?.method ?? 'GET'} ${(input as string).replace('/api/v1', '')}`
    const token = new Headers(init?.headers).get('authorization')
    calls.push({ what, token, body: JSON.parse((init?.body as string | undefined) ?? 'null') })
    await Promise.resolve()
    const answer = routes[what]?.() ?? { status: 404 }
    if (answer === 'down') throw new TypeError('Failed to fetch')
    const { status = 200, body = {}, headers = {} } = answer
    return new Response(status === 204 ? null : JSON.stringify(body), { status, headers })
  }
  return { send, calls, count: (what: string) => calls.filter((call) => call.what === what).length }
}

const alone: Exclusive = (act) => act()
const closed = { status: 401, body: { code: 'unauthenticated' } }
const noSession = { status: 401, body: { code: 'no_session' } }
const expired = { status: 401, body: { code: 'expired_token' } }
let made = 0
const grant = (role = 'operator', user = 'ada') => ({
  body: { token: `t${String(++made)}`, expires_in: 900, user, role },
})

function start(
  routes: Record<string, () => Answer>,
  { exclusive = alone, channel = null as Channel | null } = {},
) {
  const fake = server(routes)
  const session = new Session({ send: fake.send, exclusive, channel, random: () => 0 })
  const started = session.start()
  return { session, started, ...fake }
}

/** Two ends that hear each other, as tabs do. */
function channels(): [Channel, Channel] {
  const ends: Channel[] = [0, 1].map((at) => ({
    onmessage: null,
    postMessage: (data) => ends[1 - at]?.onmessage?.({ data } as MessageEvent),
    close: () => undefined,
  }))
  return ends as [Channel, Channel]
}

beforeEach(() => {
  made = 0
  vi.useFakeTimers()
})
afterEach(() => {
  vi.useRealTimers()
})

describe('at the start', () => {
  it('an open server asks for nothing, and everything is allowed', async () => {
    const { session, started, calls } = start({
      'GET /session': () => ({ body: { open: true, user: null, role: 'admin' } }),
    })
    await started
    expect(session.state.value).toBe('open')
    expect(session.role.value).toBe('admin')
    expect(await session.ticket()).toBeNull()
    expect(calls.map((call) => call.what)).toEqual(['GET /session'])
  })

  it('the cookie brings a session', async () => {
    const { session, started } = start({
      'GET /session': () => closed,
      'POST /session/refresh': () => grant(),
    })
    await started
    expect([session.state.value, session.user.value, session.role.value]).toEqual([
      'in',
      'ada',
      'operator',
    ])
  })

  it('without one the login is shown, and no reason', async () => {
    const { session, started } = start({
      'GET /session': () => closed,
      'POST /session/refresh': () => noSession,
    })
    await started
    expect([session.state.value, session.why.value]).toEqual(['out', null])
  })

  it('a server that is not there is waited for', async () => {
    let up = false
    const { session } = start({
      'GET /session': () => (up ? closed : 'down'),
      'POST /session/refresh': () => grant(),
    })
    await vi.advanceTimersByTimeAsync(1_000)
    expect(session.state.value).toBe('unreachable')
    expect(session.trouble.value).toContain('cannot be reached')
    up = true
    await vi.advanceTimersByTimeAsync(10_000)
    expect(session.state.value).toBe('in')
  })

  it('an answer that makes no sense lets nobody in', async () => {
    const { session } = start({ 'GET /session': () => ({ body: { open: 'yes' } }) })
    await vi.advanceTimersByTimeAsync(100)
    expect(session.state.value).toBe('unreachable')
  })
})

describe('the token', () => {
  const routes = (refresh: () => Answer) => ({
    'GET /session': () => closed,
    'POST /session/refresh': refresh,
    'GET /robots': () => ({ body: { robots: [] } }),
  })

  it('is renewed a minute before it runs out', async () => {
    const { started, count } = start(routes(() => grant()))
    await started
    await vi.advanceTimersByTimeAsync(839_000)
    expect(count('POST /session/refresh')).toBe(1)
    await vi.advanceTimersByTimeAsync(2_000)
    expect(count('POST /session/refresh')).toBe(2)
  })

  it('is renewed after sleep, when timers are late', async () => {
    const { session, started, count } = start(routes(() => grant()))
    await started
    session.hurry()
    expect(count('POST /session/refresh')).toBe(1)
    vi.setSystemTime(Date.now() + 3_600_000)
    session.hurry()
    await vi.advanceTimersByTimeAsync(0)
    expect(count('POST /session/refresh')).toBe(2)
  })

  it('that has run out costs a call one repeat, and many calls one refresh', async () => {
    let token = ''
    const fake = server({
      'GET /session': () => closed,
      'POST /session/refresh': () => grant(),
      'GET /robots': () => (token === 't1' ? expired : { body: { robots: [] } }),
    })
    const send: typeof fetch = (input, init) => {
      token = new Headers(init?.headers).get('authorization')?.replace('Bearer ', '') ?? ''
      return fake.send(input, init)
    }
    const session = new Session({ send, exclusive: alone, channel: null })
    await session.start()
    const api = createApi(session.send)
    await Promise.all([api.summaries(), api.summaries(), api.summaries()])
    expect(fake.count('POST /session/refresh')).toBe(2)
    expect(session.state.value).toBe('in')
  })

  it('lost with the session brings the login, with the reason and the name', async () => {
    let ended = false
    const { session, started } = start({
      ...routes(() => (ended ? noSession : grant())),
      'GET /robots': () => expired,
    })
    await started
    ended = true
    await expect(createApi(session.send).summaries()).rejects.toMatchObject({ status: 401 })
    expect([session.state.value, session.why.value, session.user.value]).toEqual([
      'out',
      'ended',
      'ada',
    ])
    expect(session.role.value).toBe('viewer')
  })

  it('is not given up because the server is away', async () => {
    let away = false
    const { session, started, count } = start(routes(() => (away ? 'down' : grant())))
    await started
    away = true
    await vi.advanceTimersByTimeAsync(860_000)
    expect(session.state.value).toBe('in')
    const tried = count('POST /session/refresh')
    expect(tried).toBeGreaterThan(2)
    away = false
    await vi.advanceTimersByTimeAsync(5_000)
    expect(count('POST /session/refresh')).toBe(tried + 1)
  })

  it('waits as long as the server asks', async () => {
    let busy = false
    const { started, count } = start(
      routes(() => (busy ? { status: 429, headers: { 'retry-after': '20' } } : grant())),
    )
    await started
    busy = true
    await vi.advanceTimersByTimeAsync(841_000)
    expect(count('POST /session/refresh')).toBe(2)
    await vi.advanceTimersByTimeAsync(18_000)
    expect(count('POST /session/refresh')).toBe(2)
    await vi.advanceTimersByTimeAsync(2_000)
    expect(count('POST /session/refresh')).toBe(3)
  })

  it('follows a server that has become open', async () => {
    let open = false
    const { session, started } = start({
      'GET /session': () => (open ? { body: { open: true } } : closed),
      'POST /session/refresh': () => (open ? noSession : grant()),
      'GET /robots': () => (open ? expired : { body: { robots: [] } }),
    })
    await started
    open = true
    await createApi(session.send)
      .summaries()
      .catch(() => null)
    expect(session.state.value).toBe('open')
  })

  it('is looked at anew when something is refused, but not at every refusal', async () => {
    let role = 'operator'
    const { session, started, count } = start({
      ...routes(() => grant(role)),
      'POST /swarm/commands': () => ({ status: 403, body: { code: 'forbidden' } }),
    })
    await started
    role = 'viewer'
    const api = createApi(session.send)
    for (let i = 0; i < 3; i++) await api.commandSwarm({ command: 'stop' }).catch(() => null)
    await vi.advanceTimersByTimeAsync(0)
    expect(session.role.value).toBe('viewer')
    expect(count('POST /session/refresh')).toBe(2)
  })
})

describe('logging in and out', () => {
  const routes = {
    'GET /session': () => closed,
    'POST /session/refresh': () => noSession,
    'POST /session': () => grant('admin'),
    'DELETE /session': () => ({ status: 204 }),
  }

  it('goes in with name and password', async () => {
    const { session, started, calls } = start(routes)
    await started
    await session.logIn('ada', 'correct horse')
    expect(session.state.value).toBe('in')
    expect(calls.at(-1)?.body).toEqual({ user: 'ada', password: 'correct horse' })
  })

  it('stays out with a wrong password, and refreshes nothing for it', async () => {
    const { session, started, count } = start({
      ...routes,
      'POST /session': () => ({ status: 401, body: { code: 'bad_credentials' } }),
    })
    await started
    await expect(session.logIn('ada', 'x')).rejects.toMatchObject({ code: 'bad_credentials' })
    expect(session.state.value).toBe('out')
    expect(count('POST /session/refresh')).toBe(1)
  })

  it('goes in without an account when the server has become open', async () => {
    const { session, started } = start({
      ...routes,
      'POST /session': () => ({ status: 409, body: { code: 'open_server' } }),
    })
    await started
    await session.logIn('ada', 'x')
    expect([session.state.value, session.user.value]).toEqual(['open', null])
  })

  it('sends nothing while logged out', async () => {
    const { session, started, calls } = start(routes)
    await started
    const before = calls.length
    const failure = createApi(session.send).commandSwarm({ command: 'estop' })
    await expect(failure).rejects.toMatchObject({ status: 401 })
    expect(calls).toHaveLength(before)
  })

  it('forgets who was there after a logout', async () => {
    const { session, started, calls } = start(routes)
    await started
    await session.logIn('ada', 'correct horse')
    await session.logOut()
    expect(calls.at(-1)).toMatchObject({ what: 'DELETE /session', token: 'Bearer t1' })
    expect([session.state.value, session.why.value, session.user.value]).toEqual([
      'out',
      'logged-out',
      null,
    ])
    // The renewal that was due must not come.
    const before = calls.length
    await vi.advanceTimersByTimeAsync(2_000_000)
    expect(calls).toHaveLength(before)
  })

  it('stays in when the server did not hear of the logout: the cookie is still good', async () => {
    const { session, started } = start({ ...routes, 'DELETE /session': () => 'down' as const })
    await started
    await session.logIn('ada', 'correct horse')
    await expect(session.logOut()).rejects.toMatchObject({ status: 0 })
    expect(session.state.value).toBe('in')
  })

  it('leaves the old password to the form when it is wrong', async () => {
    const { session, started, count } = start({
      ...routes,
      'PUT /session/password': () => ({ status: 401, body: { code: 'bad_credentials' } }),
    })
    await started
    await session.logIn('ada', 'correct horse')
    await expect(session.changePassword('a', 'b')).rejects.toMatchObject({
      code: 'bad_credentials',
    })
    expect(session.state.value).toBe('in')
    expect(count('PUT /session/password')).toBe(1)
  })
})

describe('two tabs', () => {
  it('share what one of them gets, in and out', async () => {
    const [one, two] = channels()
    const routes = {
      'GET /session': () => closed,
      'POST /session/refresh': () => noSession,
      'POST /session': () => grant(),
      'DELETE /session': () => ({ status: 204 }),
    }
    const first = start(routes, { channel: one })
    const second = start(routes, { channel: two })
    await Promise.all([first.started, second.started])
    await first.session.logIn('ada', 'correct horse')
    expect([second.session.state.value, second.session.user.value]).toEqual(['in', 'ada'])
    await first.session.logOut()
    expect([second.session.state.value, second.session.why.value]).toEqual(['out', 'elsewhere'])
  })

  it('keep nothing after a logout, also where the server told of the end first', async () => {
    const [one, two] = channels()
    const routes = {
      'GET /session': () => closed,
      'POST /session/refresh': () => noSession,
      'POST /session': () => grant(),
      'DELETE /session': () => ({ status: 204 }),
    }
    const first = start(routes, { channel: one })
    const second = start(routes, { channel: two })
    await Promise.all([first.started, second.started])
    await first.session.logIn('ada', 'correct horse')
    // While the answer to the other tab is on its way.
    await second.session.renew()
    expect([second.session.why.value, second.session.user.value]).toEqual(['ended', 'ada'])
    await first.session.logOut()
    expect(second.session.why.value).toBe('elsewhere')
    expect([second.session.state.value, second.session.user.value]).toEqual(['out', null])
  })

  it('never use one refresh token twice', async () => {
    const [one, two] = channels()
    let current = 0
    let reused = 0
    // The cookie is read when a call leaves and set when its answer arrives.
    let cookie = 0
    const routes = (): Record<string, () => Answer> => ({ 'GET /session': () => closed })
    const exclusive = exclusively('test', queue(), null)
    const tab = (channel: Channel) => {
      const fake = server(routes())
      const send: typeof fetch = async (input, init) => {
        if (!(input as string).endsWith('/refresh')) return fake.send(input, init)
        const sent = cookie
        await new Promise((resolve) => setTimeout(resolve, 50))
        if (sent !== current) reused += 1
        current += 1
        await new Promise((resolve) => setTimeout(resolve, 50))
        cookie = current
        return new Response(JSON.stringify(grant().body))
      }
      return new Session({ send, exclusive, channel })
    }
    const tabs = [tab(one), tab(two)]
    const started = Promise.all(tabs.map((session) => session.start()))
    await vi.advanceTimersByTimeAsync(1_000)
    await started
    const before = current
    const renewed = Promise.all([...tabs, ...tabs].map((session) => session.renew()))
    await vi.advanceTimersByTimeAsync(1_000)
    expect(await renewed).toEqual(['renewed', 'renewed', 'renewed', 'renewed'])
    expect(reused).toBe(0)
    expect(current - before).toBe(1)
  })
})

/** What `navigator.locks` does, for one name. */
function queue() {
  let last: Promise<unknown> = Promise.resolve()
  return {
    request<T>(_name: string, act: () => Promise<T>): Promise<T> {
      const mine = last.then(act, act)
      last = mine.catch(() => undefined)
      return mine
    },
  }
}
