import { describe, expect, it } from 'vitest'
import {
  badgeCount,
  badgeRadius,
  cellSize,
  clusterAt,
  clusters,
  mixOf,
} from '../../src/arena/cluster'
import { frameOf, helps, seen, worldAt } from '../../src/arena/overview'
import { SELECTED, IN_GROUP, Texels } from '../../src/arena/texels'
import { TRAIL, TRAIL_EVERY_MS, Trails } from '../../src/arena/trails'
import { Fleet } from '../../src/fleet/fleet'
import { decodeFrame } from '../../src/feed/decode'
import { posesFrame } from '../mock/encode.mjs'

interface Place {
  x: number
  y: number
  state?: string
  presence?: string
}

function fleetOf(places: readonly Place[]): Fleet {
  const fleet = new Fleet()
  fleet.begin(1_000)
  fleet.applyRoster({
    kind: 'roster',
    removed: [],
    robots: places.map((_, index) => ({
      index,
      id: `r${String(index)}`,
      kind: index % 3 === 2 ? 'physical' : 'simulated',
      presence: 'online',
      firmware: '',
      board: '',
    })),
  })
  move(fleet, 1_000, places)
  return fleet
}

function move(fleet: Fleet, ms: number, places: readonly Place[]): void {
  const robots = places.map((place, index) => ({
    index,
    heading: 0,
    state: 'IDLE',
    presence: 'online',
    ...place,
  }))
  const decoded = decodeFrame(posesFrame({ ms, x0: -30, y0: -30, robots }))
  if (!decoded.ok || decoded.frame.kind !== 'poses') throw new Error('not poses')
  fleet.applyPoses(decoded.frame, ms)
}

const size = { width: 800, height: 600 }
const crowd = Array.from({ length: 2_500 }, (_, i) => ({
  x: (i % 50) * 0.5 - 12.5,
  y: Math.floor(i / 50) * 0.5 - 12.5,
  state: i % 10 === 0 ? 'ERROR' : 'MOVING',
}))

describe('clusters', () => {
  const camera = { x: 0, y: 0, scale: 12 }

  it('count every robot in view once, by what it does', () => {
    const found = clusters(fleetOf(crowd).all(), camera, size)
    const total = found.reduce((sum, { count }) => sum + count, 0)
    expect(total).toBe(2_500)
    for (const { count, mix } of found) {
      expect(mix.reduce((sum, part) => sum + part, 0)).toBe(count)
    }
    expect(found.reduce((sum, { mix }) => sum + (mix[3] ?? 0), 0)).toBe(250)
  })

  it('are none while there is room for every robot', () => {
    const fleet = fleetOf(crowd)
    expect(clusters(fleet.all(), { ...camera, scale: 60 }, size)).toEqual([])
    expect(clusters(fleetOf(crowd.slice(0, 300)).all(), camera, size)).toEqual([])
    expect(clusters(new Fleet().all(), camera, size)).toEqual([])
  })

  it('leave out who is not in view', () => {
    const away = { x: 500, y: 0, scale: 12 }
    expect(clusters(fleetOf(crowd).all(), away, size)).toEqual([])
  })

  it('stay where they are while the view moves', () => {
    const fleet = fleetOf(crowd)
    const names = (x: number) =>
      clusters(fleet.all(), { ...camera, x }, size).map(
        (c) => `${c.x.toFixed(3)} ${c.y.toFixed(3)}`,
      )
    expect(new Set(names(0.3))).toEqual(new Set(names(0)))
    expect(cellSize(12)).toBe(cellSize(12.4))
  })

  it('are found under their badge', () => {
    const found = clusters(fleetOf(crowd).all(), camera, size)
    const [first] = found
    if (first === undefined) throw new Error('none')
    const [x, y] = [400 + first.x * 12, 300 - first.y * 12]
    expect(clusterAt(found, camera, size, x, y)).toBe(first)
    expect(clusterAt([first], camera, size, x + 30, y)).toBeNull()
  })

  it.each([
    [7, '7'],
    [999, '999'],
    [1_000, '1.0k'],
    [9_940, '9.9k'],
    [9_960, '10k'],
    [65_000, '65k'],
  ])('write %d as %s', (count, words) => {
    expect(badgeCount(count)).toBe(words)
    expect(badgeRadius(count)).toBeLessThanOrEqual(24)
  })

  it('tell apart what robots do', () => {
    const [gone, caution, idle] = [
      ...fleetOf([
        { x: 0, y: 0, presence: 'offline' },
        { x: 1, y: 0, state: 'CAUTION' },
        { x: 2, y: 0 },
      ]).all(),
    ].map(mixOf)
    expect([gone, caution, idle]).toEqual([4, 2, 1])
  })
})

describe('the overview', () => {
  const world = { minX: -10, minY: -5, maxX: 10, maxY: 5 }
  const frame = frameOf(world, { width: 200, height: 200 })

  it('holds the whole world', () => {
    expect(frame).toMatchObject({ scale: 10, width: 200, height: 100 })
    expect(worldAt(frame, 0, 0)).toEqual([-10, 5])
    expect(worldAt(frame, 200, 100)).toEqual([10, -5])
  })

  it('shows what is seen, never beyond its rim', () => {
    expect(seen(frame, { x: 0, y: 0, scale: 100 }, size)).toEqual({
      x: 60,
      y: 20,
      width: 80,
      height: 60,
    })
    expect(seen(frame, { x: 10, y: 5, scale: 100 }, size)).toMatchObject({
      x: 160,
      y: 0,
      height: 30,
    })
    expect(seen(frame, { x: 99, y: 0, scale: 100 }, size).width).toBe(0)
  })

  it('helps only while something is out of sight', () => {
    expect(helps(world, { x: 0, y: 0, scale: 40 }, size)).toBe(false)
    expect(helps(world, { x: 0.1, y: 0, scale: 40 }, size)).toBe(true)
    expect(helps(world, { x: 0, y: 0, scale: 41 }, size)).toBe(true)
  })
})

describe('what the shaders get', () => {
  it('stands in the slot of the robot, and says who is chosen, the driven one last', () => {
    const fleet = fleetOf([
      { x: 1, y: 2 },
      { x: 3, y: 4 },
      { x: 5, y: 6 },
    ])
    const texels = new Texels()
    expect(texels.write(fleet.all(), 'r0', new Set(['r0', 'r2']), 1_000)).toEqual([2, 0])
    expect(texels.slots).toBe(3)
    expect(texels.data[12 + 4]).toBeCloseTo(3, 3)
    expect([0, 1, 2].map((slot) => texels.data[12 * slot + 10])).toEqual([
      SELECTED + IN_GROUP,
      0,
      2 + IN_GROUP,
    ])
    expect(texels.data[9]).toBe(1)
  })

  it('forgets robots that are gone', () => {
    const fleet = fleetOf([
      { x: 1, y: 2 },
      { x: 3, y: 4 },
    ])
    const texels = new Texels()
    texels.write(fleet.all(), null, new Set(), 0)
    fleet.applyRoster({ kind: 'roster', robots: [], removed: [0] })
    texels.write(fleet.all(), null, new Set(), 0)
    expect([...texels.data.slice(0, 12)]).toEqual(new Array(12).fill(0))
    expect(texels.slots).toBe(2)
  })
})

describe('trails', () => {
  it('begin where a robot is first seen, and go on at an even pace', () => {
    const fleet = fleetOf([{ x: 1, y: 1 }])
    const trails = new Trails()
    trails.reserve(256)
    expect(trails.record(fleet.all(), 0)).toBe(true)
    expect(trails.layers.every((layer) => Math.abs((layer[0] ?? 0) - 1) < 0.001)).toBe(true)
    expect(trails.dirty.size).toBe(TRAIL)
    trails.dirty.clear()
    expect(trails.record(fleet.all(), TRAIL_EVERY_MS - 1)).toBe(false)
    move(fleet, 1_500, [{ x: 1.5, y: 1 }])
    expect(trails.record(fleet.all(), TRAIL_EVERY_MS)).toBe(true)
    expect([...trails.dirty]).toEqual([trails.head])
    expect(trails.layers[trails.head]?.[0]).toBeCloseTo(1.5, 3)
  })

  it('do not cross the arena with a robot that was set down elsewhere', () => {
    const fleet = fleetOf([{ x: 1, y: 1 }])
    const trails = new Trails()
    trails.reserve(256)
    trails.record(fleet.all(), 0)
    move(fleet, 2_000, [{ x: 20, y: 1 }])
    trails.record(fleet.all(), 1_000)
    expect(trails.layers.every((layer) => (layer[0] ?? 0) > 19)).toBe(true)
  })
})
