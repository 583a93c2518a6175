// @vitest-environment happy-dom

import { flushPromises, mount } from '@vue/test-utils'
import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { ShallowRef } from 'vue'
import { defineComponent, nextTick, shallowRef } from 'vue'
import type { HistorySpan } from '../../src/api-types'
import type { Room } from '../../src/control/room'
import type { ConnectionStatus } from '../../src/feed/connection'
import type { Piece } from '../../src/history/chunks'
import type { HistoryApi } from '../../src/history/history-api'
import type { Recorded, Track } from '../../src/history/record'
import { ApiError } from '../../src/http'
import type { Past } from '../../src/pages/history/use-history'
import { usePast } from '../../src/pages/history/use-history'
import { useView } from '../../src/view'

const T = 1_790_000_000_000
const MINUTE = 60_000
/** How often the moment goes into the address, and then some. */
const WRITTEN_MS = 800

function track({ asked, step }: Piece): Track {
  const at = Float64Array.from(
    { length: (asked.to - asked.from) / step },
    (_, i) => asked.from + i * step,
  )
  const none = at.map(() => 0)
  return {
    robot: 'rover-1',
    kind: 'simulated',
    at,
    x: Float32Array.from(none),
    y: Float32Array.from(none),
    theta: Float32Array.from(none),
    state: Uint8Array.from(none),
    range: Int32Array.from(none),
    battery: Uint8Array.from(none),
    spacing: step,
  }
}

function recorded(piece: Piece): Recorded {
  const one = track(piece)
  return {
    ...piece.asked,
    step: piece.step,
    tracks: new Map([[one.robot, one]]),
    arenas: [],
    points: one.at.length,
  }
}

/** The page about the past at a moment, with a server that can go away. */
async function open() {
  location.hash = `#/history?from=${T}&to=${T + 10 * MINUTE}&at=${T + 5 * MINUTE + 15_000}`
  let away = false
  const asked: string[] = []
  const answer = <A>(give: () => A): Promise<A> =>
    away ? Promise.reject(new ApiError('the server cannot be reached', 0)) : Promise.resolve(give())
  const span: HistorySpan = { from: T, to: T + 10 * MINUTE, robots: 50 } as HistorySpan
  const api: HistoryApi = {
    span: () => answer(() => ({ ...span })),
    frames: (piece) => {
      asked.push(piece.key)
      return answer(() => recorded(piece))
    },
    events: () => answer(() => ({ events: [], next: null })) as never,
    telemetry: () => answer(() => ({})) as never,
  }
  const status: ShallowRef<ConnectionStatus> = shallowRef({
    state: 'live',
    attempt: 0,
    retryAt: null,
  })
  const room = { serverNow: () => T + 60 * MINUTE, status } as unknown as Room
  const address = useView()
  let past!: Past
  const page = mount(
    defineComponent(() => {
      past = usePast(room, address, api)
      return () => null
    }),
  )
  const pass = async (milliseconds: number): Promise<void> => {
    await vi.advanceTimersByTimeAsync(milliseconds)
    await flushPromises()
    await nextTick()
  }
  await pass(WRITTEN_MS)
  return {
    past,
    asked,
    pass,
    setAway(now: boolean) {
      away = now
      status.value = { ...status.value, state: now ? 'waiting' : 'live' }
    },
    close() {
      page.unmount()
      address.close()
    },
  }
}

describe('what is loaded of the past', () => {
  beforeEach(() => vi.useFakeTimers({ now: T + 60 * MINUTE }))
  afterEach(() => {
    vi.useRealTimers()
    location.hash = ''
  })

  it('is asked for once, however often the moment goes into the address', async () => {
    const { past, asked, pass, close } = await open()
    expect(past.here.value).toBe('shown')
    const before = asked.length
    for (let step = 1; step <= 5; step++) {
      past.player.step(-1_000)
      await pass(WRITTEN_MS)
      expect(location.hash).toContain(`at=${T + 5 * MINUTE + 15_000 - step * 1_000}`)
    }
    expect(past.here.value).toBe('shown')
    expect(asked.slice(before)).toEqual([])
    close()
  })

  it('can be looked at while the server is away', async () => {
    const { past, pass, setAway, close } = await open()
    setAway(true)
    past.player.step(-1_000)
    await pass(WRITTEN_MS)
    expect(past.here.value).toBe('shown')
    // As far as it is not loaded it fails, and what is comes back.
    past.seek(T + MINUTE)
    await pass(WRITTEN_MS)
    expect(past.here.value).toBe('failed')
    past.seek(T + 5 * MINUTE + 15_000)
    await pass(WRITTEN_MS)
    expect(past.here.value).toBe('shown')
    close()
  })

  it('outlasts that the length of the record is asked for again', async () => {
    const { past, asked, pass, close } = await open()
    const before = asked.length
    past.retry()
    await pass(WRITTEN_MS)
    expect([past.here.value, asked.slice(before)]).toEqual(['shown', []])
    close()
  })

  it('is asked for anew at another speed, which has other points', async () => {
    const { past, asked, pass, close } = await open()
    const before = asked.length
    past.change({ speed: 60 })
    await pass(WRITTEN_MS)
    expect(past.here.value).toBe('shown')
    expect(asked.length).toBeGreaterThan(before)
    close()
  })
})

describe('the moment in the address', () => {
  beforeEach(() => vi.useFakeTimers({ now: T + 60 * MINUTE }))
  afterEach(() => {
    vi.useRealTimers()
    location.hash = ''
  })

  it.each([
    ['another moment', `#/history?from=${T}&to=${T + 10 * MINUTE}&at=${T + MINUTE}`],
    ['another page', '#/robots'],
  ])('does not undo that somebody goes to %s', async (_, elsewhere) => {
    const { past, pass, close } = await open()
    past.player.step(-1_000)
    // The browser is there, and tells the page later.
    history.replaceState(null, '', elsewhere)
    await pass(WRITTEN_MS)
    expect(location.hash).toBe(elsewhere)
    window.dispatchEvent(new Event('hashchange'))
    await pass(WRITTEN_MS)
    expect(location.hash).toBe(elsewhere)
    close()
  })
})
