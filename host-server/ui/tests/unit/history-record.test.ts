import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { HistoryFrames } from '../../src/api-types'
import { TRAIL, TRAIL_EVERY_MS, Trails } from '../../src/arena/trails'
import { SPEEDS } from '../../src/history/address'
import type { Piece } from '../../src/history/chunks'
import {
  MOST_ALL,
  MOST_POINTS,
  layoutFor,
  pieceAt,
  pieceBefore,
  wanted,
} from '../../src/history/chunks'
import { newSeen, seenAt } from '../../src/history/moment'
import type { Recorded } from '../../src/history/record'
import { Unreadable, arenaAt, lastAt, readFrames } from '../../src/history/record'
import { Replay } from '../../src/history/replay'
import { Store } from '../../src/history/store'
import { ApiError } from '../../src/http'

const T = 1_790_000_000_000
type Row = HistoryFrames['robots'][number]

function row(robot: string, points: readonly (readonly [number, number, number, number])[]): Row {
  return {
    robot,
    kind: 'simulated',
    at: points.map(([at]) => T + at),
    x: points.map(([, x]) => x),
    y: points.map(([, , y]) => y),
    theta: points.map(([, , , theta]) => theta),
    state: points.map(() => 1),
    range_mm: points.map(() => null),
    battery_percent: points.map(() => 80),
  }
}

const ground = (width: number) => ({ width, height: 4, obstacles: [] }) as never

function frames(robots: Row[], change: Partial<HistoryFrames> = {}): HistoryFrames {
  return {
    from: T,
    to: T + 60_000,
    step: 200,
    arena: ground(5),
    arenas: [],
    states: ['ERROR', 'MOVING', 'DANCING'],
    robots,
    ...change,
  }
}

describe('a record', () => {
  it('is read into columns, with states by name', () => {
    const told = frames([row('a', [[0, 1, 2, 3]]), row('b', [])])
    told.robots[0]?.state.splice(0, 1, 2)
    const { tracks, points } = readFrames(told)
    expect([...tracks.keys()]).toEqual(['a'])
    expect(points).toBe(1)
    // A state of a newer server is one that stands.
    expect(tracks.get('a')?.state[0]).toBe(1)
    expect(tracks.get('a')?.range[0]).toBe(-1)
  })

  it('that does not fit together is refused', () => {
    const short = row('a', [[0, 1, 2, 3]])
    short.x.push(5)
    expect(() => readFrames(frames([short]))).toThrow(Unreadable)
    const twice = row('a', [
      [0, 1, 2, 3],
      [0, 1, 2, 3],
    ])
    expect(() => readFrames(frames([twice]))).toThrow(Unreadable)
  })

  it('has the arena of each time', () => {
    const told = frames([], { arenas: [{ at: T + 500, arena: ground(9) }] } as never)
    const read = readFrames(told)
    expect(arenaAt(read, T)?.width).toBe(5)
    expect(arenaAt(read, T + 500)?.width).toBe(9)
    expect(arenaAt(readFrames(frames([], { arena: null })), T)).toBeNull()
    expect(arenaAt(readFrames(frames([], { arena: { width: 'x' } } as never)), T)).toBeNull()
  })

  it('is searched by halves', () => {
    const at = Float64Array.from([10, 20, 30])
    expect([9, 10, 19, 20, 30, 99].map((time) => lastAt(at, time))).toEqual([-1, 0, 0, 1, 2, 2])
    expect(lastAt(new Float64Array(0), 5)).toBe(-1)
  })
})

describe('a moment', () => {
  const track = (points: Parameters<typeof row>[1]) =>
    readFrames(frames([row('a', points)])).tracks.get('a') as never

  it('is blended between points, turning the short way round', () => {
    const seen = newSeen()
    const found = track([
      [0, 1, 0, 3],
      [200, 2, 4, -3],
    ])
    expect(seenAt(found, T + 50, 200, seen)).toBe(true)
    expect(seen.x).toBeCloseTo(1.25)
    expect(seen.y).toBeCloseTo(1)
    expect(seen.heading).toBeCloseTo(3 + (2 * Math.PI - 6) / 4)
    expect(seen.gap).toBe(0)
    expect(seenAt(found, T - 1, 200, seen)).toBe(false)
  })

  it('makes nothing up across a gap, and says how old it is', () => {
    const seen = newSeen()
    const found = track([
      [0, 1, 0, 0],
      [200, 1, 0, 0],
      [400, 1, 0, 0],
      [20_400, 9, 0, 0],
    ])
    for (const [at, gap] of [
      [1_000, 0],
      [12_400, 12_000],
      [20_399, 19_999],
    ] as const) {
      expect(seenAt(found, T + at, 200, seen)).toBe(true)
      expect([seen.x, seen.gap, seen.told]).toEqual([1, gap, T + 400])
    }
    seenAt(found, T + 20_400, 200, seen)
    expect([seen.x, seen.gap]).toEqual([9, 0])
  })

  it('of an old record is as good as its points, which are far apart', () => {
    const seen = newSeen()
    const minutes = track([0, 1, 2, 3, 4].map((i) => [i * 60_000, i, 0, 0] as const))
    seenAt(minutes, T + 90_000, 200, seen)
    // It stands where it was told, and is not late.
    expect([seen.x, seen.gap]).toEqual([1, 0])
    seenAt(minutes, T + 240_000 + 151_000, 200, seen)
    expect(seen.gap).toBe(151_000)
  })
})

describe('the picture of a moment', () => {
  const line = (robot: string, from: number, to: number) =>
    row(
      robot,
      Array.from({ length: (to - from) / 200 + 1 }, (_, i) => {
        const at = from + i * 200
        return [at, at / 1_000, 0, 0] as const
      }),
    )

  it('has whoever is in the record, late ones and gone ones told apart', () => {
    const replay = new Replay()
    const read = readFrames(
      frames([line('a', 0, 60_000), line('b', 0, 20_000), line('c', 0, 50_000)]),
    )
    replay.show(T + 55_000, read, null)
    expect(replay.fleet.size).toBe(3)
    expect(['a', 'b', 'c'].map((id) => replay.fleet.get(id)?.presence)).toEqual([
      'online',
      'offline',
      'stale',
    ])
    expect([...replay.gaps]).toEqual([
      ['b', 35_000],
      ['c', 5_000],
    ])
    expect(replay.moving).toBe(1)
    replay.selectedId = 'a'
    expect(replay.selected?.x).toBeCloseTo(55)
    replay.show(T - 1, read, null)
    expect([replay.fleet.size, replay.selected]).toEqual([0, undefined])
  })

  it('keeps those of the piece before who said nothing since', () => {
    const replay = new Replay()
    const before = readFrames(frames([line('a', 0, 1_000)]))
    replay.show(T + 60_500, readFrames(frames([line('b', 60_000, 61_000)])), before)
    expect(replay.fleet.get('a')?.x).toBeCloseTo(1)
    expect(replay.gaps.get('a')).toBe(59_500)
    replay.clear()
    expect(replay.fleet.size).toBe(0)
  })

  it('changes the arena only for another one', () => {
    const replay = new Replay()
    const first = frames([])
    replay.show(T, readFrames(first), null)
    const arena = replay.arena.value
    replay.show(T + 1, readFrames(first), null)
    expect(replay.arena.value).toBe(arena)
    replay.show(T + 2, readFrames(frames([], { arena: ground(9) } as never)), null)
    expect(replay.arena.value?.width).toBe(9)
    replay.show(T + 3, readFrames(frames([], { arena: null })), null)
    expect(replay.arena.value).toBeNull()
  })

  it('has trails of the record, which end at a gap', () => {
    const replay = new Replay()
    const points = [...line('a', 0, 1_000).at, ...line('a', 6_000, 9_000).at].map(
      (at) => [at - T, (at - T) / 1_000, 0, 0] as const,
    )
    replay.show(T + 8_000, readFrames(frames([row('a', points)])), null)
    const trails = new Trails()
    trails.reserve(256)
    trails.replay(replay.fleet.all(), replay.past)
    const places = Array.from({ length: TRAIL }, (_, age) => {
      return trails.layers[(trails.head - age + TRAIL) % TRAIL]?.[0] ?? Number.NaN
    })
    const known = 2_000 / TRAIL_EVERY_MS
    places.forEach((x, age) => {
      expect(x).toBeCloseTo(8 - Math.min(age, known) * (TRAIL_EVERY_MS / 1_000))
    })
  })
})

describe('pieces of the record', () => {
  it('never ask for more than the server gives', () => {
    for (const robots of [0, 1, 50, 500, 1_000, 10_000, 20_000]) {
      for (const speed of SPEEDS) {
        const { asked, step } = pieceAt(layoutFor(robots, speed), T + 1_234)
        const points = (asked.to - asked.from) / step
        expect(step).toBeGreaterThanOrEqual(100)
        expect(points).toBeLessThanOrEqual(MOST_POINTS)
        expect(points * robots).toBeLessThanOrEqual(MOST_ALL)
      }
    }
  })

  it('are found again, and lie side by side', () => {
    const layout = layoutFor(50, 1)
    const piece = pieceAt(layout, T)
    expect(pieceAt(layout, piece.from)).toEqual(piece)
    expect(pieceAt(layout, piece.to - 1)).toEqual(piece)
    expect(pieceAt(layout, piece.to).from).toBe(piece.to)
    expect(pieceBefore(layout, T).to).toBe(piece.from)
    expect(piece.asked.from).toBeLessThanOrEqual(piece.from - TRAIL * TRAIL_EVERY_MS)
    expect(layoutFor(50, 1, 1).points).toBe(layout.points / 2)
  })

  it('are fetched ahead while time passes, not beyond the window', () => {
    const layout = layoutFor(50, 60)
    const first = pieceAt(layout, T)
    const window = { from: T, to: T + 86_400_000 }
    const before = pieceBefore(layout, T)
    expect(wanted(layout, first.from, 0, window)).toEqual([first, before])
    const ahead = wanted(layout, first.from, 60, window)
    expect(ahead.pop()).toEqual(before)
    expect(ahead.length).toBeGreaterThan(1)
    expect(ahead.length).toBeLessThanOrEqual(4)
    ahead.slice(1).forEach((piece, i) => expect(piece.from).toBe(ahead[i]?.to))
    expect(wanted(layout, T, 60, { from: T, to: T + 1 }).length).toBe(2)
    expect(wanted(layout, first.to - 1, 0, window).length).toBe(3)
  })
})

describe('the store of pieces', () => {
  beforeEach(() => vi.useFakeTimers({ now: T }))
  afterEach(() => vi.useRealTimers())
  const layout = layoutFor(50, 1)
  const old = (number: number): Piece => pieceAt(layout, T - 10_000_000 + number * 60_000)
  const recorded = (points: number): Recorded => ({
    from: 0,
    to: 1,
    step: 200,
    tracks: new Map(),
    arenas: [],
    points,
  })

  function store(answer: (piece: Piece) => Promise<Recorded>, most = 1_000) {
    const asked: { piece: Piece; signal: AbortSignal }[] = []
    const onChange = vi.fn()
    const made = new Store({
      fetch: (piece, signal) => {
        asked.push({ piece, signal })
        return answer(piece)
      },
      now: () => Date.now(),
      onChange,
      most,
    })
    return { store: made, asked, onChange }
  }
  const settle = () => vi.advanceTimersByTimeAsync(0)

  it('asks for two at a time, in order, and once for each', async () => {
    const { store: it, asked, onChange } = store(() => Promise.resolve(recorded(10)))
    const pieces = [old(0), old(1), old(2)]
    it.want(pieces)
    expect(asked.map(({ piece }) => piece.key)).toEqual(pieces.slice(0, 2).map(({ key }) => key))
    expect(it.loading(old(0))).toBe(true)
    await settle()
    expect(asked.length).toBe(3)
    it.want(pieces)
    await vi.advanceTimersByTimeAsync(60_000)
    expect(asked.length).toBe(3)
    expect(pieces.every((piece) => it.has(piece))).toBe(true)
    expect(onChange).toHaveBeenCalledTimes(3)
  })

  it('gives up what is no longer wanted', async () => {
    const { store: it, asked } = store(() => new Promise(() => undefined))
    it.want([old(0)])
    it.want([old(1)])
    expect(asked[0]?.signal.aborted).toBe(true)
    expect(asked[1]?.signal.aborted).toBe(false)
    it.close()
    expect(asked[1]?.signal.aborted).toBe(true)
    await settle()
  })

  it('keeps no more than there is room for, and what is used last', async () => {
    const { store: it } = store(() => Promise.resolve(recorded(400)))
    for (const number of [0, 1]) {
      it.want([old(number)])
      await settle()
    }
    it.get(old(0))
    it.want([old(2)])
    await settle()
    expect([0, 1, 2].map((number) => it.has(old(number)))).toEqual([true, false, true])
    expect(it.points).toBe(800)
    it.clear()
    expect([it.points, it.has(old(0))]).toEqual([0, false])
  })

  it('tries again after a while, longer each time, or when told to', async () => {
    let broken = true
    const { store: it, asked } = store(() =>
      broken ? Promise.reject(new ApiError('away', 0)) : Promise.resolve(recorded(1)),
    )
    it.want([old(0)])
    await settle()
    expect(it.failure(old(0))).toBeInstanceOf(ApiError)
    await vi.advanceTimersByTimeAsync(2_100)
    expect(asked.length).toBe(2)
    await vi.advanceTimersByTimeAsync(2_100)
    expect(asked.length).toBe(2)
    broken = false
    it.retry()
    await settle()
    expect([it.failure(old(0)), it.has(old(0))]).toEqual([null, true])
  })

  it('asks again for what was not all there', async () => {
    const { store: it, asked } = store(() => Promise.resolve(recorded(1)))
    const now = pieceAt(layout, T)
    it.want([now])
    await settle()
    await vi.advanceTimersByTimeAsync(2_100)
    expect(asked.length).toBe(2)
    expect(it.has(now)).toBe(true)
    await vi.advanceTimersByTimeAsync(180_000)
    const many = asked.length
    await vi.advanceTimersByTimeAsync(60_000)
    expect(asked.length).toBe(many)
    it.close()
  })
})
