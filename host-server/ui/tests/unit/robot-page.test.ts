import { describe, expect, it } from 'vitest'
import type { CommandRecord, TelemetryPoint } from '../../src/api-types'
import { Groups } from '../../src/fleet/groups'
import type { Parameter } from '../../src/fleet/parameters'
import {
  batches,
  differences,
  exported,
  read,
  same,
  shareable,
  write,
} from '../../src/fleet/parameters'
import { CHARTS, columns, extremes, gist, latencies } from '../../src/fleet/series'
import {
  RANGES,
  bounds,
  queryOf,
  refreshMs,
  shifted,
  stepFor,
  stretchOf,
} from '../../src/fleet/span'

const point = (at: number, change: Partial<TelemetryPoint> = {}): TelemetryPoint => ({
  at,
  count: 1,
  x: 0,
  y: 0,
  theta: 0,
  range_mm: 1_500,
  battery_mv: 8_000,
  battery_percent: 80,
  rssi_dbm: null,
  left: 0.5,
  right: -0.25,
  state: 'MOVING',
  least: { range_mm: 300, battery_mv: 7_900, battery_percent: 79, rssi_dbm: null },
  most: { range_mm: 1_700, battery_mv: 8_100, battery_percent: 81, rssi_dbm: null },
  ...change,
})

describe('charts', () => {
  it('draw in the units that are written', () => {
    expect(columns('range', [point(1_000)], 1_000)).toEqual([[1], [1.5]])
    expect(columns('wheels', [point(1_000)], 1_000)).toEqual([[1], [50], [-25]])
    expect(columns('signal', [point(1_000)], 1_000)).toEqual([[1], [null]])
    for (const chart of CHARTS) expect(columns(chart, [], 1)[0]).toEqual([])
  })

  it('do not bridge a gap', () => {
    const [x, y] = columns('battery', [point(1_000), point(2_000), point(9_000)], 1_000)
    expect(x).toEqual([1, 2, 3, 9])
    expect(y).toEqual([80, 80, null, 80])
  })

  it('have lowest and highest beside the mean, with the same gaps', () => {
    const points = [point(1_000), point(2_000), point(9_000)]
    expect(extremes('range', points, 1_000)).toEqual([
      [0.3, 0.3, null, 0.3],
      [1.7, 1.7, null, 1.7],
    ])
    expect(extremes('signal', points, 1_000)?.[0]).toEqual([null, null, null, null])
    for (const chart of ['wheels', 'latency'] as const)
      expect(extremes(chart, points, 1)).toBe(null)
    // What was near for a moment is not lost in a mean.
    const around = extremes('range', points, 1_000)
    expect(gist([1.5, null, 1.5], around)).toEqual({ now: 1.5, least: 0.3, most: 1.7, mean: 1.5 })
  })

  it('show how long answers took', () => {
    const command = (timestamp: number, status: 'completed' | 'failed', at: number | null) =>
      ({ timestamp, outcomes: [{ robot: 'a', status, timestamp: at }] }) as CommandRecord
    const records = [
      command(5_000, 'completed', 5_250),
      command(3_000, 'completed', 2_990),
      command(4_000, 'failed', 4_100),
      command(90_000, 'completed', 90_001),
    ]
    expect(latencies(records, 'a', 0, 10_000)).toEqual([
      [3, 5],
      [0, 0.25],
    ])
    expect(latencies(records, 'b', 0, 10_000)).toEqual([[], []])
  })

  it('say the same in numbers', () => {
    expect(gist([3, null, 1, 2])).toEqual({ now: 2, least: 1, most: 3, mean: 2 })
    expect(gist([null])).toBe(null)
  })
})

describe('stretches of time', () => {
  it('stand in the address, and nonsense is the usual one', () => {
    for (const stretch of [
      { live: '1h' } as const,
      { live: '5m' } as const,
      { live: null, from: 1_000_000, to: 2_000_000 },
    ]) {
      expect(stretchOf(queryOf(stretch))).toEqual(stretch)
    }
    for (const query of [{ range: 'x' }, { from: '5', to: '4' }, { from: 'a' }, { from: '-5' }]) {
      expect(stretchOf(query)).toEqual({ live: '5m' })
    }
  })

  it('are asked for no finer than can be drawn, and never too finely', () => {
    for (const length of Object.values(RANGES)) {
      expect(length / stepFor(0, length)).toBeLessThan(2_000)
    }
    expect(refreshMs('1m')).toBe(1_000)
    expect(refreshMs('7d')).toBe(60_000)
  })

  it('move by half of themselves, and are live again at the end', () => {
    const now = 10_000_000
    const earlier = shifted({ live: '1m' }, -1, now)
    expect(earlier).toEqual({ live: null, from: now - 90_000, to: now - 30_000 })
    expect(shifted(earlier, 1, now)).toEqual({ live: '1m' })
    expect(bounds({ live: '1m' }, now)).toEqual({ from: now - 60_000, to: now })
  })
})

describe('parameters', () => {
  const speed: Parameter = { name: 'max_speed', value: 0.5, default: 0.5, min: 0.05, max: 2 }
  const avoid: Parameter = { name: 'avoidance', value: true }
  const name: Parameter = { name: 'name', value: 'left' }

  it('are read as the kind of value that they are', () => {
    expect(read(' 0,75 ', speed)).toEqual({ ok: true, value: 0.75 })
    expect(read('', speed)).toEqual({ ok: false, why: 'number' })
    expect(read('1e9', speed)).toEqual({ ok: false, why: 'high' })
    expect(read('-1', speed)).toEqual({ ok: false, why: 'low' })
    expect(read('false', avoid)).toEqual({ ok: true, value: false })
    expect(read('', name)).toEqual({ ok: true, value: '' })
  })

  it('are the same when a float of 32 bits is', () => {
    expect(same(0.1, 0.10000000149011612)).toBe(true)
    expect(same(0.1, 0.2)).toBe(false)
    expect(same('1', 1)).toBe(false)
    expect(write(0.10000000149011612)).toBe('0.1')
  })

  it('are compared, saved and handed on', () => {
    const mine = [speed, avoid, name]
    const theirs = [{ ...speed, value: 0.7 }, avoid]
    expect([...differences(mine, theirs)]).toEqual([
      ['max_speed', 0.7],
      ['name', null],
    ])
    expect(JSON.parse(exported('a', mine))).toEqual({
      robot: 'a',
      parameters: { max_speed: 0.5, avoidance: true, name: 'left' },
    })
    expect(shareable(mine)).toEqual({ max_speed: 0.5, avoidance: true })
  })

  it('go in as many sets as a robot takes', () => {
    const many = Object.fromEntries(Array.from({ length: 17 }, (_, at) => [`p${String(at)}`, at]))
    const sets = batches(many)
    expect(sets.map((set) => Object.keys(set).length)).toEqual([8, 8, 1])
    expect(Object.assign({}, ...sets)).toEqual(many)
    expect(batches({})).toEqual([])
  })
})

describe('groups', () => {
  function storage(kept: string | null = null) {
    const map = new Map<string, string>(kept === null ? [] : [['terracrawler.groups.ada', kept]])
    return {
      map,
      getItem: (key: string) => map.get(key) ?? null,
      setItem: (key: string, value: string) => void map.set(key, value),
    }
  }

  it('are kept for whoever made them', () => {
    const place = storage()
    const groups = new Groups('ada', place)
    expect(groups.save(' Left wing ', ['b', 'a', 'b'])).toBe(true)
    expect(new Groups('ada', place).get('Left wing')?.robots).toEqual(['a', 'b'])
    expect(new Groups('bob', place).all.value).toEqual([])
    groups.save('Left wing', ['c'])
    expect(groups.all.value).toEqual([{ name: 'Left wing', robots: ['c'] }])
    groups.remove('Left wing')
    expect(new Groups('ada', place).all.value).toEqual([])
  })

  it('have a name, somebody in them, and an end to their number', () => {
    const groups = new Groups(null, null)
    expect(groups.save('  ', ['a'])).toBe(false)
    expect(groups.save('empty', [])).toBe(false)
    for (let i = 0; i < 100; i++) expect(groups.save(`g${String(i)}`, ['a'])).toBe(true)
    expect(groups.save('one more', ['a'])).toBe(false)
    expect(groups.save('g5', ['b'])).toBe(true)
  })

  it('survive whatever stands in storage', () => {
    for (const kept of ['{', '5', '[5, null, {"name": 3}, {"name": "x", "robots": [1]}]']) {
      expect(new Groups('ada', storage(kept)).all.value).toEqual([])
    }
    const broken = {
      getItem: () => {
        throw new Error('off')
      },
      setItem: () => {
        throw new Error('off')
      },
    }
    const groups = new Groups('ada', broken)
    expect(groups.save('a', ['b'])).toBe(true)
    expect(groups.get('a')?.robots).toEqual(['b'])
  })
})
