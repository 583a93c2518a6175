import { describe, expect, it } from 'vitest'
import type { Camera } from '../../src/arena/camera'
import { fit, panBy, scaleBar, toScreen, toWorld, zoomAt } from '../../src/arena/camera'
import { boundsOf, nearest, smallestRadius, union } from '../../src/arena/pick'
import { TONES, buildScene } from '../../src/arena/scene'
import { OBJECT_SHAPES } from '../../src/feed/arena'
import { Fleet } from '../../src/fleet/fleet'
import { decodeFrame } from '../../src/feed/decode'
import { posesFrame } from '../mock/encode.mjs'

const size = { width: 800, height: 600 }
const camera: Camera = { x: 1, y: -2, scale: 50 }

describe('the camera', () => {
  it('maps there and back', () => {
    const [x, y] = toScreen(camera, size, 2.5, -1)
    expect([x, y]).toEqual([475, 250])
    expect(toWorld(camera, size, x, y)).toEqual([2.5, -1])
  })

  it('keeps the point under the pointer when zooming', () => {
    const before = toWorld(camera, size, 120, 470)
    const after = toWorld(zoomAt(camera, size, 120, 470, 1.7), size, 120, 470)
    expect(after[0]).toBeCloseTo(before[0], 9)
    expect(after[1]).toBeCloseTo(before[1], 9)
  })

  it('moves the world with the hand', () => {
    const moved = panBy(camera, 30, 40)
    expect(toScreen(moved, size, 1, -2)).toEqual([430, 340])
  })

  it('fits the bounds inside the margins', () => {
    const margins = { top: 60, sides: 10, bottom: 20 }
    const bounds = { minX: -5, minY: -4, maxX: 5, maxY: 4 }
    const fitted = fit(bounds, size, margins)
    const [left, top] = toScreen(fitted, size, bounds.minX, bounds.maxY)
    const [right, bottom] = toScreen(fitted, size, bounds.maxX, bounds.minY)
    expect(left).toBeGreaterThanOrEqual(10)
    expect(right).toBeLessThanOrEqual(790)
    expect(top).toBeCloseTo(60, 6)
    expect(bottom).toBeCloseTo(580, 6)
  })

  it.each([3, 7, 50, 333, 1_000])('has a scale bar of a usable length at %d px/m', (scale) => {
    const pixels = scaleBar({ x: 0, y: 0, scale }) * scale
    expect(pixels).toBeGreaterThanOrEqual(40)
    expect(pixels).toBeLessThanOrEqual(120)
  })
})

describe('picking', () => {
  function fleetAt(...places: [number, number][]): Fleet {
    const fleet = new Fleet()
    fleet.begin(1_000)
    fleet.applyRoster({
      kind: 'roster',
      removed: [],
      robots: places.map((_, index) => ({
        index,
        id: `r${String(index)}`,
        kind: 'simulated',
        presence: 'online',
        firmware: '',
        board: '',
      })),
    })
    const robots = places.map(([x, y], index) => ({
      index,
      x,
      y,
      heading: 0,
      state: 'IDLE',
      presence: 'online',
    }))
    const decoded = decodeFrame(posesFrame({ ms: 1_000, x0: -9, y0: -9, robots }))
    if (!decoded.ok || decoded.frame.kind !== 'poses') throw new Error('not poses')
    fleet.applyPoses(decoded.frame, 1_000)
    return fleet
  }
  const view = {
    camera,
    size,
    time: 2_000,
    smallest: 8,
    cones: 'none' as const,
    trails: 'none' as const,
    points: false,
  }

  it('takes the nearest robot, and none when all are far', () => {
    const fleet = fleetAt([1, -2], [1.5, -2])
    expect(nearest(fleet.all(), view, 402, 301, 10)?.id).toBe('r0')
    expect(nearest(fleet.all(), view, 420, 300, 10)?.id).toBe('r1')
    expect(nearest(fleet.all(), view, 100, 100, 10)).toBeNull()
  })

  it('bounds the robots, and what is beyond the walls', () => {
    const robots = boundsOf(fleetAt([1, -2], [3, -2]).all())
    expect(robots?.minX).toBeCloseTo(1, 3)
    expect(robots?.maxX).toBeCloseTo(3, 3)
    const walls = { minX: -2, minY: -2, maxX: 2, maxY: 2 }
    expect(union(walls, robots).maxX).toBeCloseTo(3, 3)
    expect(union(walls, null)).toEqual(walls)
    expect(boundsOf(new Fleet().all())).toBeNull()
  })

  it('draws robots smaller where there are too many', () => {
    const area = { minX: -5, minY: -5, maxX: 5, maxY: 5 }
    expect(smallestRadius(10, area, camera)).toBeGreaterThan(smallestRadius(5_000, area, camera))
  })
})

describe('the scene', () => {
  it('holds only finite numbers and known tones', () => {
    const scene = buildScene({
      width: 10,
      height: 6,
      obstacles: [
        { shape: 'circle', x: 0, y: 0, r: 0.2 },
        { shape: 'box', x: 2, y: 1, w: 0.01, h: 1, theta: 0.3 },
      ],
      movers: [
        {
          body: { shape: 'circle', x: 1, y: 1, r: 0.1 },
          path: [
            [3, 1],
            [3, 1],
          ],
        },
      ],
      patches: [{ x: -2, y: 0, w: 1, h: 0.4, theta: 0.5, grip: 0.3 }],
      objects: OBJECT_SHAPES.map((shape, x) => ({ shape, colour: 'blue', x, y: 2, size: 0.2 })),
    })
    for (const list of [scene.triangles, scene.lines]) {
      expect(list.length % 3).toBe(0)
      expect(list.every(Number.isFinite)).toBe(true)
    }
    const tones = new Set([...scene.triangles, ...scene.lines].filter((_, at) => at % 3 === 2))
    expect([...tones].sort((a, b) => a - b)).toEqual([0, 1, 2, 3, 4, 5, 6, 9])
    expect(Math.max(...tones)).toBeLessThan(TONES)
  })

  it('bounds the number of grid lines', () => {
    const huge = buildScene({
      width: 100_000,
      height: 100_000,
      obstacles: [],
      movers: [],
      patches: [{ x: 0, y: 0, w: 90_000, h: 90_000, theta: 0, grip: 0.05 }],
      objects: [],
    })
    expect(huge.lines.length / 6).toBeLessThan(2_000)
  })
})
