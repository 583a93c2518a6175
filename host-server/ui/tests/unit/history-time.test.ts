import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { Wish } from '../../src/history/address'
import {
  LEAST_WINDOW_MS,
  around,
  moved,
  queryOfWish,
  widened,
  wishOf,
  zoomed,
} from '../../src/history/address'
import { Player } from '../../src/history/player'
import { arrowStep, ticks } from '../../src/history/ticks'
import { formatRoute, momentLink, parseRoute } from '../../src/view'

const T = Date.UTC(2026, 10, 22, 12)

describe('what of the past is looked at', () => {
  it('stands in the address, and comes back from it', () => {
    const wish: Wish = {
      window: { from: T, to: T + 300_000 },
      at: T + 1_234,
      robot: 'rover-1',
      speed: 10,
      level: 'warn',
      only: true,
    }
    const hash = formatRoute({
      view: 'history',
      robot: null,
      experiment: null,
      release: null,
      query: queryOfWish(wish),
    })
    expect(hash).toBe(
      `#/history?from=${T}&to=${T + 300_000}&at=${T + 1_234}&robot=rover-1&speed=10&level=warn&only=1`,
    )
    expect(parseRoute(hash).view).toBe('history')
    expect(wishOf(parseRoute(hash).query)).toEqual(wish)
  })

  it('leaves out what is as usual', () => {
    expect(queryOfWish(wishOf({}))).toEqual({
      from: '',
      to: '',
      at: '',
      robot: '',
      speed: '',
      level: '',
      only: '',
    })
    expect(queryOfWish({ at: 5.4 })).toEqual({ at: '5' })
  })

  it('is the usual where the link is broken', () => {
    const usual = wishOf({})
    for (const query of [
      { from: 'x', to: '5' },
      { from: String(T), to: String(T + LEAST_WINDOW_MS - 1) },
      { from: String(T), to: String(T - 1) },
      { from: '1', to: String(T) },
      { speed: '3' },
      { speed: 'NaN' },
      { level: 'debug' },
      { at: '-5' },
      { at: '1e99' },
    ]) {
      expect(wishOf(query)).toEqual(usual)
    }
  })

  it('keeps the moment inside the window', () => {
    const query = { from: String(T), to: String(T + 60_000) }
    expect(wishOf({ ...query, at: String(T - 5) }).at).toBe(T)
    expect(wishOf({ ...query, at: String(T + 99_999) }).at).toBe(T + 60_000)
  })

  it('is zoomed around the moment, and never too far', () => {
    const window = { from: T, to: T + 100_000 }
    expect(zoomed(window, T + 25_000, 0.5)).toEqual({ from: T + 12_500, to: T + 62_500 })
    expect(zoomed(window, T, 2)).toEqual({ from: T, to: T + 200_000 })
    const closest = zoomed(window, T + 50_000, 1e-9)
    expect(closest.to - closest.from).toBe(LEAST_WINDOW_MS)
    expect(wishOf(queryOfWish({ window: zoomed(window, T, 1e9) })).window).not.toBeNull()
    expect(widened({ from: T, to: T + 1_000 })).toEqual({ from: T - 4_500, to: T + 5_500 })
    expect(moved(window, 1)).toEqual({ from: T + 50_000, to: T + 150_000 })
    expect(around(window, T + 99)).toBe(window)
    expect(around(window, T + 900_000)).toEqual({ from: T + 850_000, to: T + 950_000 })
  })

  it('is what a link to a moment shows', () => {
    const wish = wishOf(parseRoute(momentLink(T, 'rover-1')).query)
    expect(wish).toMatchObject({ at: T, robot: 'rover-1' })
    expect(wish.window).toEqual({ from: T - 240_000, to: T + 60_000 })
    expect(wishOf(parseRoute(momentLink(T)).query).robot).toBeNull()
  })
})

describe('marks of the time line', () => {
  beforeEach(() => {
    vi.stubEnv('TZ', 'Europe/Berlin')
    expect(new Date(Date.UTC(2026, 6, 1)).getTimezoneOffset()).toBe(-120)
  })
  afterEach(() => vi.unstubAllEnvs())
  const labels = (from: number, to: number, most: number): string[] =>
    ticks(from, to, most).map(({ label }) => label)

  it('stand at round times of the local clock, with the date where it changes', () => {
    const from = new Date(2026, 10, 22, 23, 58, 40).getTime()
    expect(ticks(from, from + 150_000, 5)).toEqual([
      { at: from + 20_000, label: '23:59:00', day: '22 Nov 2026' },
      { at: from + 50_000, label: '23:59:30', day: null },
      { at: from + 80_000, label: '00:00:00', day: '23 Nov 2026' },
      { at: from + 110_000, label: '00:00:30', day: null },
      { at: from + 140_000, label: '00:01:00', day: null },
    ])
  })

  it('are as many as fit, at any length', () => {
    for (const length of [10_000, 61_000, 3_599_000, 86_400_000, 9e8, 3.4e10]) {
      for (const most of [2, 5, 12, 30]) {
        const found = ticks(T, T + length, most)
        expect(found.length).toBeLessThanOrEqual(most + 1)
        expect(found.length).toBeGreaterThan(0)
        found.slice(1).forEach(({ at }, i) => expect(at).toBeGreaterThan(found[i]?.at ?? at))
      }
    }
  })

  it('go on by the clock where it is put forward', () => {
    const from = new Date(2026, 2, 29, 0).getTime()
    expect(labels(from, from + 5 * 3_600_000, 6)).toEqual([
      '00:00',
      '01:00',
      '03:00 CEST',
      '04:00',
      '05:00',
      '06:00',
    ])
    expect(labels(from, from + 23 * 3_600_000, 5)).toEqual([
      '00:00',
      '06:00 CEST',
      '12:00',
      '18:00',
      '00:00',
    ])
  })

  it('name the zone where an hour comes twice', () => {
    const from = new Date(2026, 9, 25, 1).getTime()
    expect(labels(from, from + 4 * 3_600_000, 5)).toEqual([
      '01:00',
      '02:00',
      '02:00 CET',
      '03:00',
      '04:00',
    ])
    // Every second hour, the one that comes twice is marked once.
    expect(labels(from - 3_600_000, from + 6 * 3_600_000, 4)).toEqual([
      '00:00',
      '02:00',
      '04:00 CET',
      '06:00',
    ])
  })

  it('stand at the beginning of days, however long those are', () => {
    const from = new Date(2026, 9, 23).getTime()
    const found = ticks(from, from + 5 * 86_400_000, 6)
    expect(found.map(({ label }) => label)).toContain('26 Oct 2026')
    for (const { at } of found) expect(new Date(at).getHours()).toBe(0)
  })

  it('an arrow key goes a round way', () => {
    expect(arrowStep(300_000)).toBe(2_000)
    expect(arrowStep(86_400_000)).toBe(600_000)
    expect(arrowStep(10_000)).toBe(1_000)
  })
})

describe('the clock of what is played', () => {
  const player = (ready = (): boolean => true) => {
    const onMove = vi.fn()
    const made = new Player({ window: () => ({ from: T, to: T + 10_000 }), ready, onMove })
    made.seek(T)
    onMove.mockClear()
    return { player: made, onMove }
  }

  it('passes as fast as is asked for, and stands at the end', () => {
    const { player: it, onMove } = player()
    it.speed.value = 5
    it.play()
    it.advance(100, 0)
    expect(it.now).toBe(T + 500)
    // A tab that slept does not jump.
    it.advance(60_000, 60_000)
    expect(it.now).toBe(T + 3_000)
    for (let i = 0; i < 4; i++) it.advance(500, 70_000 + i)
    expect([it.now, it.playing.value, it.at.value]).toEqual([T + 10_000, false, T + 10_000])
    expect(onMove).toHaveBeenCalled()
    it.play()
    expect(it.now).toBe(T)
  })

  it('waits for the record', () => {
    let there = false
    const { player: it } = player(() => there)
    it.play()
    it.advance(100, 0)
    expect([it.now, it.waits.value]).toEqual([T, true])
    there = true
    it.advance(100, 100)
    expect([it.now, it.waits.value]).toEqual([T + 100, false])
  })

  it('stays in the window, and stands when stepped', () => {
    const { player: it } = player()
    it.play()
    it.step(-1_000)
    expect([it.now, it.playing.value]).toEqual([T, false])
    it.seek(T + 99_999)
    expect(it.now).toBe(T + 10_000)
    it.advance(100, 0)
    expect(it.now).toBe(T + 10_000)
  })
})
