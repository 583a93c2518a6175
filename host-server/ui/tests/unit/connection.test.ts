import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { ConnectionStatus } from '../../src/feed/connection'
import { Connection, DEAD_AFTER_MS, SILENT_AFTER_MS, feedUrl } from '../../src/feed/connection'
import type { Frame, Refusal } from '../../src/feed/decode'
import { ApiError } from '../../src/http'
import { jsonFrame } from '../mock/encode.mjs'

/** A socket without a network. */
class FakeSocket {
  binaryType = 'blob'
  onmessage: ((message: { data: unknown }) => void) | null = null
  onclose: (() => void) | null = null
  onerror: (() => void) | null = null
  closed = false
  close(): void {
    this.closed = true
  }
}

const hello = () =>
  jsonFrame('hello', { protocol: 2, fleet: 'swarm', time: 1_700_000_000_000, arena: null })
const event = () => jsonFrame('event', { time: 1, level: 'info', robot: null, text: 'x' })

function setUp() {
  const sockets: FakeSocket[] = []
  const statuses: ConnectionStatus[] = []
  const frames: Frame[] = []
  const refusals: Refusal[] = []
  const connection = new Connection({
    url: 'ws://test/api/v1/live',
    now: () => Date.now(),
    random: () => 1,
    open() {
      const socket = new FakeSocket()
      sockets.push(socket)
      return socket as unknown as WebSocket
    },
    onFrame: (frame) => frames.push(frame),
    onRefused: (reason) => refusals.push(reason),
    onStatus: (status) => statuses.push(status),
  })
  connection.start()
  const state = () => statuses.at(-1)?.state
  return { connection, sockets, statuses, frames, refusals, state }
}

beforeEach(() => {
  vi.useFakeTimers()
})
afterEach(() => {
  vi.useRealTimers()
})

describe('the connection', () => {
  it('is live from the hello on', () => {
    const { sockets, frames, state } = setUp()
    expect(state()).toBe('connecting')
    sockets[0]?.onmessage?.({ data: hello() })
    expect(state()).toBe('live')
    expect(frames).toHaveLength(1)
  })

  it('hands on another hello on the same socket, and stays live', () => {
    const { sockets, statuses, frames, state } = setUp()
    sockets[0]?.onmessage?.({ data: hello() })
    sockets[0]?.onmessage?.({ data: event() })
    sockets[0]?.onmessage?.({ data: hello() })
    expect(frames.map(({ kind }) => kind)).toEqual(['hello', 'event', 'hello'])
    expect(state()).toBe('live')
    expect(statuses.map((status) => status.state)).not.toContain('waiting')
    expect(sockets).toHaveLength(1)
  })

  it('counts what it cannot read, and goes on', () => {
    const { sockets, frames, refusals, state } = setUp()
    sockets[0]?.onmessage?.({ data: hello() })
    sockets[0]?.onmessage?.({ data: new Uint8Array([99]).buffer })
    sockets[0]?.onmessage?.({ data: 'text' })
    sockets[0]?.onmessage?.({ data: event() })
    expect(refusals).toEqual(['unknown-kind', 'unknown-kind'])
    expect(frames).toHaveLength(2)
    expect(state()).toBe('live')
  })

  it('comes back with growing, bounded waits', async () => {
    const { sockets, statuses } = setUp()
    const waits: number[] = []
    for (let i = 0; i < 7; i++) {
      sockets.at(-1)?.onclose?.()
      const status = statuses.at(-1)
      if (status?.state !== 'waiting' || status.retryAt === null) throw new Error('not waiting')
      waits.push(status.retryAt - Date.now())
      await vi.advanceTimersByTimeAsync(waits.at(-1) ?? 0)
    }
    expect(waits).toEqual([500, 1_000, 2_000, 4_000, 8_000, 8_000, 8_000])
    sockets.at(-1)?.onmessage?.({ data: hello() })
    sockets.at(-1)?.onclose?.()
    expect((statuses.at(-1)?.retryAt ?? 0) - Date.now()).toBe(500)
  })

  it('says when the server has gone quiet, and gives it up in the end', async () => {
    const { sockets, state } = setUp()
    sockets[0]?.onmessage?.({ data: hello() })
    await vi.advanceTimersByTimeAsync(SILENT_AFTER_MS + 600)
    expect(state()).toBe('silent')
    sockets[0]?.onmessage?.({ data: event() })
    expect(state()).toBe('live')
    await vi.advanceTimersByTimeAsync(DEAD_AFTER_MS + 1_500)
    expect(sockets[0]?.closed).toBe(true)
    expect(sockets.length).toBeGreaterThan(1)
  })

  it('does not listen to a socket it has given up', async () => {
    const { sockets, frames } = setUp()
    sockets[0]?.onclose?.()
    await vi.advanceTimersByTimeAsync(500)
    sockets[0]?.onmessage?.({ data: hello() })
    expect(frames).toHaveLength(0)
  })

  it('tries at once when asked to, and only one at a time', async () => {
    const { connection, sockets } = setUp()
    sockets[0]?.onclose?.()
    connection.retryNow()
    connection.retryNow()
    expect(sockets).toHaveLength(2)
    await vi.advanceTimersByTimeAsync(2_000)
    expect(sockets).toHaveLength(2)
  })

  it('stays closed once closed', async () => {
    const { connection, sockets } = setUp()
    connection.close()
    sockets[0]?.onclose?.()
    await vi.advanceTimersByTimeAsync(60_000)
    expect(sockets).toHaveLength(1)
  })
})

describe('a feed that takes a ticket', () => {
  function withTickets(give: () => Promise<string>) {
    const opened: string[] = []
    const sockets: FakeSocket[] = []
    const statuses: ConnectionStatus[] = []
    const connection = new Connection({
      url: give,
      now: () => Date.now(),
      random: () => 1,
      open(url) {
        opened.push(url)
        sockets.push(new FakeSocket())
        return sockets.at(-1) as unknown as WebSocket
      },
      onFrame: () => undefined,
      onRefused: () => undefined,
      onStatus: (status) => statuses.push(status),
    })
    connection.start()
    return { connection, opened, sockets, statuses }
  }

  it('gets a new one for every attempt', async () => {
    let count = 0
    const { opened, sockets } = withTickets(() => Promise.resolve(`ws://x/${String(++count)}`))
    await vi.advanceTimersByTimeAsync(0)
    sockets[0]?.onclose?.()
    await vi.advanceTimersByTimeAsync(600)
    expect(opened).toEqual(['ws://x/1', 'ws://x/2'])
  })

  it('waits when there is none to be had, as long as it is told to', async () => {
    const fail = () => Promise.reject(new ApiError('slow down', 429, 'rate_limited', 5))
    const { opened, statuses } = withTickets(fail)
    await vi.advanceTimersByTimeAsync(0)
    expect(statuses.at(-1)).toMatchObject({ state: 'waiting', retryAt: Date.now() + 5_000 })
    expect(opened).toEqual([])
  })

  it('opens nothing with a ticket that comes after the end', async () => {
    const { connection, opened } = withTickets(
      () => new Promise((resolve) => setTimeout(() => resolve('ws://late'), 1_000)),
    )
    connection.close()
    await vi.advanceTimersByTimeAsync(2_000)
    expect(opened).toEqual([])
    connection.start()
    connection.close()
    connection.start()
    await vi.advanceTimersByTimeAsync(2_000)
    expect(opened).toEqual(['ws://late'])
  })
})

describe('feedUrl', () => {
  it('carries a ticket', () => {
    expect(feedUrl({ protocol: 'https:', host: 'b' }, 'a+b')).toBe(
      'wss://b/api/v1/live?ticket=a%2Bb',
    )
  })

  it('follows the page', () => {
    expect(feedUrl({ protocol: 'http:', host: 'a:1' })).toBe('ws://a:1/api/v1/live')
    expect(feedUrl({ protocol: 'https:', host: 'b' })).toBe('wss://b/api/v1/live')
  })
})
