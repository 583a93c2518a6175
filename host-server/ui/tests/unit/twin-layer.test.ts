// @vitest-environment happy-dom

import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import { nextTick, ref } from 'vue'
import { createApi } from '../../src/api'
import type { TwinForecastsBody } from '../../src/api-types'
import { Stage } from '../../src/arena/stage'
import { Room } from '../../src/control/room'
import { ApiError } from '../../src/http'
import { page } from '../../src/strings-twin'
import { AGAIN_MS, ASK_EVERY_MS, TwinLayer } from '../../src/twin/layer'
import { paint } from '../../src/twin/paint'

const pose = (x: number, sigma: number) => ({ x, y: 0, theta: 0, sigma, sigma_theta: 0.01 })

const twin = (time: number): TwinForecastsBody => ({
  robot: 'ada-1',
  time,
  pose: pose(1, 0.01),
  forecasts: [
    { ahead_s: 1, pose: pose(1.5, 0.05) },
    { ahead_s: 10, pose: pose(6, 0.5) },
  ],
  errors: [
    { ahead_s: 1, count: 9, median: 0.004, p90: 0.01 },
    { ahead_s: 10, count: 0, median: null, p90: null },
  ],
})

function setUp(answers: (() => Promise<TwinForecastsBody>)[] = []) {
  const off = createApi(() => Promise.reject(new Error('off')))
  const room = new Room({ url: 'ws://test', api: off, role: ref('viewer') })
  room.status.value = { ...room.status.value, state: 'live' }
  const stage = new Stage(room)
  stage.size = { width: 800, height: 600 }
  const asked: string[] = []
  const layer = new TwinLayer(room, stage, {
    forecast(robot) {
      asked.push(robot)
      return answers.shift()?.() ?? Promise.resolve(twin(room.serverNow()))
    },
  })
  return { room, layer, asked }
}

const refuse = (code: string) => () => {
  return Promise.reject(new ApiError('No', 404, code, null, 'no tracker sees it'))
}
const later = (ms = ASK_EVERY_MS) => vi.advanceTimersByTimeAsync(ms)

beforeEach(() => void vi.useFakeTimers())
afterEach(() => vi.useRealTimers())

describe('the twin of a robot', () => {
  it('is asked for again and again, of the robot that is selected', async () => {
    const { room, layer, asked } = setUp()
    layer.start()
    await later()
    expect(asked).toEqual([])
    expect(layer.said.value).toContain('select a robot')
    room.select('ada-1')
    await nextTick()
    await later(0)
    expect(layer.twin.value?.pose.x).toBe(1)
    expect(layer.said.value).toBe(
      'Twin of ada-1: 1.00, 0.00 m ± 1.0 cm; in 1 s at 1.50, 0.00 m ± 5.0 cm; off by 0.4 cm of late.',
    )
    await later()
    room.select('eve-1')
    await nextTick()
    await later()
    expect(asked).toEqual(['ada-1', 'ada-1', 'eve-1', 'eve-1'])
    layer.stop()
    await later()
    expect(asked).toHaveLength(4)
    expect([layer.twin.value, layer.said.value]).toEqual([null, ''])
  })

  it('says how old it is, and goes where there is none', async () => {
    const { room, layer, asked } = setUp([
      () => Promise.resolve(twin(room.serverNow() - 9_000)),
      refuse('internal'),
      refuse('no_twin'),
    ])
    room.select('ada-1')
    layer.start()
    await later(0)
    expect(layer.said.value).toContain('9 s old')
    await later()
    // Where only an answer is missing it stays, and is asked for after a while.
    expect(layer.twin.value).not.toBeNull()
    await later()
    expect(asked).toHaveLength(2)
    await later(AGAIN_MS)
    expect(layer.twin.value).toBeNull()
    expect(layer.said.value).toBe('No twin of ada-1: no tracker sees it.')
    layer.stop()
  })

  it('of the robot before is not shown any more', async () => {
    let answer: (found: TwinForecastsBody) => void = () => undefined
    const slow = () => new Promise<TwinForecastsBody>((resolve) => (answer = resolve))
    const { room, layer } = setUp([slow, refuse('no_twin')])
    room.select('ada-1')
    layer.start()
    room.select('eve-1')
    await nextTick()
    answer(twin(0))
    await later(0)
    expect(layer.twin.value).toBeNull()
    layer.stop()
  })
})

describe('its picture', () => {
  it('has an outline now, one in a second, and discs as large as it is unsure', () => {
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
    const size = { width: 400, height: 400 }
    expect(paint(context, ink, { camera, size, twin: twin(0) })).toBe(true)
    const arcs = done
      .filter((one) => one.startsWith('arc'))
      .map((one) => one.split(' ').slice(1, 4))
    // Two deviations around each; then both outlines, light and dark.
    expect(arcs.slice(0, 2)).toEqual([
      ['300', '200', '2'],
      ['350', '200', '10'],
    ])
    expect(arcs.slice(2)).toEqual([
      ['350', '200', '10'],
      ['300', '200', '10'],
      ['350', '200', '10'],
      ['300', '200', '10'],
    ])
    // It heads to the right, and a line leads to where it will be.
    expect(done).toContain('lineTo 315 200')
    expect(done).toContain('lineTo 350 200')

    done.length = 0
    expect(paint(context, ink, { camera, size, twin: { ...twin(0), forecasts: [] } })).toBe(true)
    expect(done.filter((one) => one.startsWith('arc'))).toHaveLength(3)
  })
})

describe('what is wrong with a robot', () => {
  it('is said in words, also what a newer server finds', () => {
    const said = (fault: string, amount: number) =>
      page.fault({ fault, amount, meaning: '', since: 0 }, '12:00')
    expect(said('left_weak', 0.104)).toBe('Left motor weak: 10 % is missing, since 12:00')
    expect(said('late', 0.42)).toBe('Messages come late: by 0.4 s, since 12:00')
    expect(said('tracker_wrong', 3)).toContain('3 jumps')
    expect(said('on_fire', 0.5)).toBe('on_fire: 50 % is missing, since 12:00')
  })
})
