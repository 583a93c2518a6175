import { describe, expect, it, vi } from 'vitest'
import type { EventsBody } from '../../src/api-types'
import { MOST_EVENTS, PAGE, RecordedLog, currentAt } from '../../src/history/events'
import type { EventsWanted } from '../../src/history/history-api'
import { historyApi } from '../../src/history/history-api'

const T = 1_790_000_000_000
const WINDOW = { from: T, to: T + 10_000_000 }

/** One event each second, as the server gives them: newest first, by pages. */
function server(count: number) {
  const all = Array.from({ length: count }, (_, i) => ({
    id: String(i),
    time: T + i * 1_000,
    level: 'info' as const,
    robot: null,
    text: `event ${String(i)}`,
  })).reverse()
  const asked: EventsWanted[] = []
  const fetch = (wanted: EventsWanted): Promise<EventsBody> => {
    asked.push(wanted)
    const before = wanted.before === null ? Number.POSITIVE_INFINITY : Number(wanted.before)
    const fits = all.filter(({ id, time }) => Number(id) < before && time <= wanted.to)
    const events = fits.slice(0, wanted.limit)
    return Promise.resolve({
      events,
      next: fits.length > events.length ? (events.at(-1)?.id ?? null) : null,
    })
  }
  return { fetch, asked }
}

const filter = { window: WINDOW, level: 'info' as const, robot: null }

describe('recorded events', () => {
  it('come by pages until the moment is among them', async () => {
    const { fetch } = server(700)
    const log = new RecordedLog(fetch)
    log.open(filter, T + 150_000)
    await vi.waitFor(() => expect(log.entries.value.length).toBe(3 * PAGE))
    expect(log.entries.value[currentAt(log.entries.value, T + 150_500)]?.text).toBe('event 150')
    expect([log.older.value, log.newer.value, log.busy.value]).toEqual([true, false, false])
    log.more()
    await vi.waitFor(() => expect(log.entries.value.length).toBe(700))
    expect(log.older.value).toBe(false)
  })

  it('are no more than are kept: far from the newest, those around the moment', async () => {
    const { fetch } = server(5_000)
    const log = new RecordedLog(fetch)
    log.open(filter, T + 100_500)
    await vi.waitFor(() => {
      expect(log.entries.value[currentAt(log.entries.value, T + 100_500)]?.text).toBe('event 100')
    })
    expect(log.entries.value.length).toBeLessThanOrEqual(MOST_EVENTS)
    expect(log.newer.value).toBe(true)
    log.follow(T + 4_999_000)
    await vi.waitFor(() => expect(log.entries.value[0]?.text).toBe('event 4999'))
    expect(log.newer.value).toBe(false)
  })

  it('say what went wrong, and come when asked again', async () => {
    let broken = true
    const { fetch } = server(3)
    const log = new RecordedLog((wanted) =>
      broken ? Promise.reject(new Error('broken')) : fetch(wanted),
    )
    log.open(filter, T)
    await vi.waitFor(() => expect(log.error.value).toBe('broken'))
    broken = false
    log.again()
    await vi.waitFor(() => expect(log.entries.value.length).toBe(3))
    expect(log.error.value).toBeNull()
  })

  it('of before are given up for those of another window', async () => {
    const signals: AbortSignal[] = []
    const log = new RecordedLog((_wanted, signal) => {
      signals.push(signal)
      return new Promise(() => undefined)
    })
    log.open(filter, T)
    log.open({ ...filter, level: 'error' }, T)
    expect(signals.map(({ aborted }) => aborted)).toEqual([true, false])
    log.close()
    expect(signals.map(({ aborted }) => aborted)).toEqual([true, true])
  })

  it('know which was the last at a moment', () => {
    const list = [30, 20, 20, 10].map((time) => ({ time }))
    expect([35, 30, 29, 10, 9].map((at) => currentAt(list, at))).toEqual([0, 0, 1, 3, -1])
    expect(currentAt([], 5)).toBe(-1)
  })
})

describe('calls about the past', () => {
  it('ask for what is needed, and can be given up', async () => {
    const asked: string[] = []
    let signal: AbortSignal | null | undefined
    const api = historyApi((input, init) => {
      asked.push(input as string)
      signal = init?.signal
      return Promise.resolve(Response.json({ events: [], next: null }))
    })
    const giveUp = new AbortController()
    const wanted = { from: 1.4, to: 9, limit: 5 }
    await api.events({ ...wanted, level: 'info', robot: null, before: null }, giveUp.signal)
    await api.events({ ...wanted, level: 'warn', robot: 'a&b', before: '7' }, giveUp.signal)
    expect(asked).toEqual([
      '/api/v1/events?from=1&to=9&limit=5',
      '/api/v1/events?from=1&to=9&limit=5&level=warn&robot=a%26b&before=7',
    ])
    expect(signal?.aborted).toBe(false)
    giveUp.abort()
    expect(signal?.aborted).toBe(true)
  })
})
