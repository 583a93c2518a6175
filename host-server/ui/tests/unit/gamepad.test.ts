import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import { Driver } from '../../src/drive/driver'
import type { Pad } from '../../src/drive/gamepad'
import { DEAD_ZONE, PadDriver, pushOf } from '../../src/drive/gamepad'

function pad(x = 0, y = 0, pressed: number[] = []): Pad {
  return {
    index: 0,
    connected: true,
    axes: [x, y, 0, 0],
    buttons: Array.from({ length: 17 }, (_, button) => ({ pressed: pressed.includes(button) })),
  }
}

describe('a stick', () => {
  it.each([
    [0, 0],
    [0.1, -0.1],
    [DEAD_ZONE, 0],
    [Number.NaN, 0],
  ])('at %d, %d drives nothing', (x, y) => {
    expect(pushOf(pad(x, y))).toBeNull()
  })

  it('is forward when pushed away, left when pushed left', () => {
    expect(pushOf(pad(0, -1))).toEqual({ ahead: 1, left: 0 })
    expect(pushOf(pad(-1, 0))).toEqual({ ahead: 0, left: 1 })
    expect(pushOf(pad(1, 0))?.left).toBe(-1)
  })

  it('begins at nothing at the rim of the dead zone, and is no faster in a corner', () => {
    expect(pushOf(pad(0, -DEAD_ZONE - 0.01))?.ahead).toBeLessThan(0.02)
    const corner = pushOf(pad(1, -1))
    expect(Math.hypot(corner?.ahead ?? 0, corner?.left ?? 0)).toBeCloseTo(1, 6)
  })

  it('has a cross beside it', () => {
    expect(pushOf(pad(0, 0, [12]))).toEqual({ ahead: 1, left: 0 })
    expect(pushOf(pad(0, -1, [12, 15]))).toEqual({ ahead: 1, left: -1 })
  })

  it('of a gamepad without axes is at rest', () => {
    expect(pushOf({ axes: [], buttons: [] })).toBeNull()
  })
})

describe('driving with it', () => {
  let sent: string[] = []
  let driver: Driver
  let done: string[] = []
  let follower: PadDriver

  beforeEach(() => {
    vi.useFakeTimers()
    ;[sent, done] = [[], []]
    driver = new Driver({
      send: (robot, { command }) => {
        sent.push(`${robot} ${command}`)
        return Promise.resolve()
      },
      onFailure: () => undefined,
      onChange: () => undefined,
    })
    driver.setTarget('a')
    driver.setBlocked(null)
    follower = new PadDriver(0, {
      driver,
      prepare: () => undefined,
      stopRobot: () => done.push('robot'),
      stopAll: () => done.push('all'),
      neighbour: (step) => done.push(`to ${String(step)}`),
    })
    follower.look(pad())
  })
  afterEach(() => {
    vi.useRealTimers()
  })

  it('goes with the stick and stops with it', async () => {
    follower.look(pad(0, -1))
    expect(driver.twist()).toEqual({ v: 0.25, w: 0 })
    await vi.advanceTimersByTimeAsync(10)
    follower.look(pad())
    expect(sent).toEqual(['a drive', 'a stop'])
    expect(driver.driving).toBe(false)
  })

  it('tells a stick that moved at once, and one that trembles with the next turn', async () => {
    follower.look(pad(0, -1))
    await vi.advanceTimersByTimeAsync(1)
    follower.look(pad(0, -0.98))
    expect(sent).toHaveLength(1)
    follower.look(pad(0, -0.5))
    expect(sent).toHaveLength(2)
  })

  it('waits for the stick to be let go after any other stop', async () => {
    follower.look(pad(0, -1))
    await vi.advanceTimersByTimeAsync(1)
    driver.releaseAll()
    follower.look(pad(0, -1))
    await vi.advanceTimersByTimeAsync(400)
    expect(sent).toEqual(['a drive', 'a stop'])
    expect(follower.waits).toBe(true)
    follower.look(pad())
    follower.look(pad(0, -1))
    expect(sent.at(-1)).toBe('a drive')
  })

  it('does not start by itself when what was in the way is gone', () => {
    driver.setBlocked('stopped')
    follower.look(pad(0, -1))
    driver.setBlocked(null)
    follower.look(pad(0, -1))
    expect(sent).toEqual([])
  })

  it('does not drive with a stick that is pushed when it is plugged in', () => {
    const other = new PadDriver(1, { ...follower['act'] })
    other.look(pad(0, -1))
    expect(sent).toEqual([])
  })

  it('only stops where nobody may drive', () => {
    follower.look(pad(0, -1, [1]), () => false)
    expect(done).toEqual(['all'])
    expect(sent).toEqual([])
    follower.look(pad(0, -1), () => true)
    expect(sent).toEqual([])
  })

  it('stops when it is unplugged', async () => {
    follower.look(pad(0, -1))
    await vi.advanceTimersByTimeAsync(1)
    follower.look({ ...pad(0, -1), connected: false })
    expect(sent.at(-1)).toBe('a stop')
  })

  it('acts once for each press, and a stop drops the stick', async () => {
    follower.look(pad(0, -1))
    await vi.advanceTimersByTimeAsync(1)
    for (let i = 0; i < 3; i++) follower.look(pad(0, -1, [1]))
    expect(done).toEqual(['all'])
    expect(driver.driving).toBe(false)
    follower.look(pad())
    follower.look(pad(0, 0, [0]))
    follower.look(pad(0, 0, [5]))
    follower.look(pad(0, 0, [4]))
    expect(done).toEqual(['all', 'robot', 'to 1', 'to -1'])
  })
})
