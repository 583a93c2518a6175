import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { CalibrationBody } from '../../src/api-types'
import { ApiError } from '../../src/http'
import { FIVE, words } from '../../src/strings-calibration'
import { outlineOf } from '../../src/twin/outline'
import { LOOK_MS, Queue } from '../../src/twin/queue'

const one = (change: Partial<CalibrationBody>): CalibrationBody => ({
  number: 1,
  robot: 'ada-1',
  by: 'eve',
  floor: '',
  begun: 0,
  ended: null,
  state: 'baseline',
  seconds: 80,
  begun_legs: 3,
  legs: 82,
  area: [],
  reason: null,
  certificate: null,
  errors: [],
  took_s: null,
  ...change,
})

describe('the floor of a drive', () => {
  it('is drawn with its y axis up, and some room around', () => {
    const outline = outlineOf([
      [1, 2],
      [2, 2],
      [2, 4],
    ])
    expect(outline).toEqual({
      viewBox: '0.850 -4.150 1.300 2.300',
      path: 'M1.000 -2.000 L2.000 -2.000 L2.000 -4.000 Z',
    })
  })

  it('is not drawn where nobody knows it', () => {
    expect(outlineOf([])).toBe(null)
  })
})

describe('a calibration', () => {
  it('says what came of it, or why nothing did', () => {
    expect(words.result(one({ state: 'certified', certificate: 'abc' }))).toBe('Certified: abc')
    const reason = { code: 'left_area', detail: 'the robot left the area' }
    expect(words.result(one({ state: 'broken_off', reason }))).toBe(
      'Broken off: the robot left the area',
    )
    expect(words.state('of a later server')).toBe('of a later server')
  })

  it('goes through five steps', () => {
    expect(FIVE).toHaveLength(5)
    for (const state of ['preparing', 'baseline', 'held_out', 'identifying', 'certified']) {
      expect(
        FIVE.filter(({ states }) => (states as readonly string[]).includes(state)),
      ).toHaveLength(1)
    }
  })

  it('says how long it takes and on how much floor, and why it may not begin', () => {
    const permit = { robot: 'ada-1', refused: null, seconds: 79.7, size: [1.24, 1.3], area: [] }
    expect(words.wouldTake(permit as never)).toContain('80 s on 1.2 × 1.3 m')
    expect(words.wouldTake({ ...permit, size: null } as never)).toContain('80 s,')
    const refused = { code: 'leaves', detail: 'it may come too near to a wall', at: [1, -2] }
    expect(words.mayNot(refused)).toBe(
      'It may not begin: it may come too near to a wall (at 1.00, −2.00 m).',
    )
  })
})

const refusal = (detail: string) => new ApiError('No', 409, 'not_permitted', null, detail)

describe('several robots', () => {
  beforeEach(() => void vi.useFakeTimers())
  afterEach(() => vi.useRealTimers())

  /** A server where robots are in each other's way: one drives at a time, for three looks. */
  function setUp(robots: readonly string[], refused: Readonly<Record<string, string>> = {}) {
    const all: CalibrationBody[] = []
    const stopped: string[] = []
    const looks = new Map<string, number>()
    const queue = new Queue(
      robots,
      {
        calibrate(robot, { floor }) {
          const why = refused[robot]
          if (why !== undefined) return Promise.reject(refusal(why))
          if (all.some(({ ended }) => ended == null)) {
            return Promise.reject(refusal('near_calibration: robot x is being calibrated too near'))
          }
          const begun = one({ robot, number: all.length + 1, floor: floor ?? '' })
          all.push(begun)
          return Promise.resolve({ ...begun })
        },
        calibrations(robot) {
          const own = all.filter((found) => found.robot === robot)
          const count = (looks.get(robot) ?? 0) + 1
          looks.set(robot, count)
          if (count === 3)
            own.forEach((found) => Object.assign(found, { ended: 9, state: 'certified' }))
          return Promise.resolve({ calibrations: own.map((found) => ({ ...found })) })
        },
        stopCalibration(robot) {
          stopped.push(robot)
          for (const found of all) {
            if (found.robot === robot) Object.assign(found, { ended: 9, state: 'broken_off' })
          }
          return Promise.resolve(null)
        },
      },
      'lino',
    )
    const states = () =>
      queue.turns.value.map(({ calibration, error }) => error ?? calibration?.state ?? 'waits')
    return { queue, states, stopped, all }
  }

  it('have their turns one after the other', async () => {
    const { queue, states, all } = setUp(['a', 'b'])
    await queue.look()
    expect(states()).toEqual(['baseline', 'waits'])
    await vi.advanceTimersByTimeAsync(3 * LOOK_MS)
    expect(states()).toEqual(['certified', 'baseline'])
    expect(queue.isOver).toBe(false)
    await vi.advanceTimersByTimeAsync(4 * LOOK_MS)
    expect(states()).toEqual(['certified', 'certified'])
    expect(queue.isOver).toBe(true)
    expect(all.map(({ floor }) => floor)).toEqual(['lino', 'lino'])
  })

  it('lose their turn where they may not be calibrated at all', async () => {
    const { queue, states } = setUp(['a', 'b'], { a: 'no_area: nothing says where' })
    await queue.look()
    expect(states()[0]).toContain('nothing says where')
    expect(states()[1]).toBe('baseline')
  })

  it('are all stopped at once', async () => {
    const { queue, states, stopped } = setUp(['a', 'b'])
    await queue.look()
    await queue.stop('stopped')
    expect(stopped).toEqual(['a'])
    expect(states()).toEqual(['broken_off', 'stopped'])
    await vi.advanceTimersByTimeAsync(9 * LOOK_MS)
    expect(states()).toEqual(['broken_off', 'stopped'])
  })
})
