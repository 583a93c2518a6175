// @vitest-environment happy-dom

import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import { nextTick, ref } from 'vue'
import { createApi } from '../../src/api'
import type { MapBody } from '../../src/api-types'
import { Stage } from '../../src/arena/stage'
import { Room } from '../../src/control/room'
import { ApiError } from '../../src/http'
import { ASK_EVERY_MS, MapLayer } from '../../src/map/layer'
import { paint } from '../../src/map/paint'

const map: MapBody = {
  timestamp: 7,
  resolution: 0.1,
  origin: [-1, -1],
  columns: 4,
  rows: ['#..#', '.o..', '....'],
  goal: [1, 2],
  next: [0.25, 0],
  way: [
    [0.05, 0.05],
    [0.45, 0.05],
  ],
}

function setUp(answers: (() => Promise<MapBody>)[] = []) {
  const off = createApi(() => Promise.reject(new Error('off')))
  const room = new Room({ url: 'ws://test', api: off, role: ref('viewer') })
  room.status.value = { ...room.status.value, state: 'live' }
  const stage = new Stage(room)
  stage.size = { width: 800, height: 600 }
  const asked: string[] = []
  const layer = new MapLayer(room, stage, {
    map(robot) {
      asked.push(robot)
      return answers.shift()?.() ?? Promise.resolve(map)
    },
  })
  return { room, layer, asked }
}

const refuse = (code: string) => () => {
  return Promise.reject(new ApiError('No', 404, code, null, 'there is none'))
}
const later = () => vi.advanceTimersByTimeAsync(ASK_EVERY_MS)

beforeEach(() => void vi.useFakeTimers())
afterEach(() => vi.useRealTimers())

describe('the map of a robot', () => {
  it('is asked for once a second, of the robot that is selected', async () => {
    const { room, layer, asked } = setUp()
    layer.start()
    await later()
    expect(asked).toEqual([])
    expect(layer.said.value).toContain('select a robot')
    room.select('ada-1')
    await nextTick()
    await vi.advanceTimersByTimeAsync(0)
    expect(layer.map.value).toEqual(map)
    expect(layer.said.value).toBe('Map of ada-1: 2 cells blocked, 1 cleared; goal 1.00, 2.00 m.')
    await later()
    room.select('eve-1')
    await nextTick()
    await later()
    expect(asked).toEqual(['ada-1', 'ada-1', 'eve-1', 'eve-1'])
    layer.stop()
    await later()
    expect(asked).toHaveLength(4)
    expect([layer.map.value, layer.said.value]).toEqual([null, ''])
  })

  it('goes when the robot has none, and stays when an answer is missing', async () => {
    const { room, layer } = setUp([
      () => Promise.resolve(map),
      refuse('no_answer'),
      refuse('no_map'),
    ])
    room.select('ada-1')
    layer.start()
    await vi.advanceTimersByTimeAsync(0)
    expect(layer.map.value).toEqual(map)
    await later()
    expect(layer.map.value).toEqual(map)
    expect(layer.said.value).toBe('No map of ada-1: there is none.')
    await later()
    expect(layer.map.value).toBeNull()
    expect(layer.said.value).toContain('ada-1 has no map')
    layer.stop()
  })

  it('of the robot before is not shown any more', async () => {
    let answer: (found: MapBody) => void = () => undefined
    const slow = () => new Promise<MapBody>((resolve) => (answer = resolve))
    const { room, layer } = setUp([slow, refuse('no_map')])
    room.select('ada-1')
    layer.start()
    room.select('eve-1')
    await nextTick()
    answer(map)
    await vi.advanceTimersByTimeAsync(0)
    expect(layer.map.value).toBeNull()
    layer.stop()
  })
})

describe('its picture', () => {
  it('fills what is blocked, and outlines what was looked through', () => {
    const done: string[] = []
    const context = new Proxy({} as CanvasRenderingContext2D, {
      get:
        (_, name) =>
        (...given: unknown[]) =>
          void done.push(`${String(name)} ${given.join(' ')}`),
      set: () => true,
    })
    const ink = { panel: 'p', text: 't', accent: 'a', ok: 'o', danger: 'd', mix: [] }
    const camera = { x: 0, y: 0, scale: 100 }
    expect(paint(context, ink, { camera, size: { width: 400, height: 400 }, map })).toBe(true)
    // The frame, and the lowest left cell, half a pixel in on each side.
    expect(done).toContain('strokeRect 100 270 40 30')
    expect(done.filter((one) => one.startsWith('rect'))).toEqual([
      'rect 100.5 290.5 9 9',
      'rect 130.5 290.5 9 9',
      'rect 113 283 4 4',
    ])
    expect(done.indexOf('fill ')).toBeGreaterThan(done.indexOf('rect 130.5 290.5 9 9'))
  })
})
