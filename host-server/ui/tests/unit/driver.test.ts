import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { Command } from '../../src/api'
import { Driver, FULL_SPEED_M_PER_S, FULL_TURN_RAD_PER_S, REPEAT_MS } from '../../src/drive/driver'

interface Sent {
  robot: string
  command: Command
}

function setUp(send: (sent: Sent) => Promise<unknown> = () => Promise.resolve()) {
  const sent: Sent[] = []
  const failures: string[] = []
  const driver = new Driver({
    send(robot, command) {
      sent.push({ robot, command })
      return send({ robot, command })
    },
    onFailure: (robot, command) => failures.push(`${robot} ${command.command}`),
    onChange: () => undefined,
  })
  driver.setTarget('sim-0001')
  driver.setBlocked(null)
  driver.setSpeed(1)
  const names = () => sent.map(({ command }) => command.command)
  return { driver, sent, failures, names }
}

beforeEach(() => {
  vi.useFakeTimers()
})
afterEach(() => {
  vi.useRealTimers()
})

describe('driving', () => {
  it('sends at once, then every 150 ms while held, and a stop on release', async () => {
    const { driver, names } = setUp()
    driver.hold('key:ArrowUp', 'forward')
    expect(names()).toEqual(['drive'])
    await vi.advanceTimersByTimeAsync(3 * REPEAT_MS)
    expect(names()).toEqual(['drive', 'drive', 'drive', 'drive'])
    driver.release('key:ArrowUp')
    expect(names().at(-1)).toBe('stop')
    await vi.advanceTimersByTimeAsync(2_000)
    expect(names()).toHaveLength(5)
  })

  it('turns held directions into one twist', () => {
    const { driver } = setUp()
    driver.hold('a', 'forward')
    driver.hold('b', 'left')
    expect(driver.twist()).toEqual({ v: FULL_SPEED_M_PER_S, w: FULL_TURN_RAD_PER_S })
    driver.hold('c', 'backward')
    driver.hold('d', 'right')
    expect(driver.twist()).toEqual({ v: 0, w: 0 })
    driver.release('a')
    driver.release('b')
    driver.setSpeed(0.5)
    expect(driver.twist()).toEqual({ v: -FULL_SPEED_M_PER_S / 2, w: -FULL_TURN_RAD_PER_S / 2 })
  })

  it('drives on while one of two keys for a direction is still held', () => {
    const { driver, names } = setUp()
    driver.hold('key:ArrowUp', 'forward')
    driver.hold('pointer:1', 'forward')
    driver.release('key:ArrowUp')
    expect(driver.driving).toBe(true)
    expect(names()).not.toContain('stop')
    driver.release('pointer:1')
    expect(driver.driving).toBe(false)
    expect(names().at(-1)).toBe('stop')
  })

  it('ignores the release of what was not held', () => {
    const { driver, names } = setUp()
    driver.release('key:ArrowUp')
    expect(names()).toEqual([])
  })

  it.each([
    ['blur and the like', (driver: Driver) => driver.releaseAll()],
    ['a reason not to drive', (driver: Driver) => driver.setBlocked('link')],
    ['another robot', (driver: Driver) => driver.setTarget('sim-0002')],
    ['no robot', (driver: Driver) => driver.setTarget(null)],
  ])('%s stops the robot that was driven', async (_, act) => {
    const { driver, sent } = setUp()
    driver.hold('key:ArrowUp', 'forward')
    await vi.advanceTimersByTimeAsync(REPEAT_MS)
    act(driver)
    expect(driver.driving).toBe(false)
    expect(sent.at(-1)).toEqual({ robot: 'sim-0001', command: { command: 'stop' } })
    const count = sent.length
    await vi.advanceTimersByTimeAsync(2_000)
    expect(sent).toHaveLength(count)
  })

  it('does not start while blocked or without a robot', () => {
    const { driver, names } = setUp()
    driver.setBlocked('offline')
    expect(driver.hold('a', 'forward')).toBe(false)
    driver.setBlocked(null)
    driver.setTarget(null)
    expect(driver.hold('a', 'forward')).toBe(false)
    expect(names()).toEqual([])
  })

  it('never has two drive commands under way', async () => {
    const { driver, names } = setUp(() => new Promise(() => undefined))
    driver.hold('a', 'forward')
    await vi.advanceTimersByTimeAsync(10 * REPEAT_MS)
    expect(names()).toEqual(['drive'])
  })

  it('stops again when a drive command was still under way at the release', async () => {
    let arrive: () => void = () => undefined
    const { driver, names } = setUp(({ command }) =>
      command.command === 'drive'
        ? new Promise<void>((resolve) => {
            arrive = resolve
          })
        : Promise.resolve(),
    )
    driver.hold('a', 'forward')
    driver.release('a')
    expect(names()).toEqual(['drive', 'stop'])
    arrive()
    await vi.advanceTimersByTimeAsync(0)
    expect(names()).toEqual(['drive', 'stop', 'stop'])
  })

  it('does not cut a new drive short because of an old command', async () => {
    const arrivals: (() => void)[] = []
    const { driver, names } = setUp(({ command }) =>
      command.command === 'drive'
        ? new Promise<void>((resolve) => arrivals.push(resolve))
        : Promise.resolve(),
    )
    driver.hold('a', 'forward')
    driver.release('a')
    driver.hold('a', 'forward')
    // A hand does not wait for the answer to what it did before.
    expect(names()).toEqual(['drive', 'stop', 'drive'])
    arrivals[0]?.()
    await vi.advanceTimersByTimeAsync(0)
    expect(names()).toEqual(['drive', 'stop', 'drive'])
  })

  it('has no more than two commands on their way, and catches up as soon as it may', async () => {
    const arrivals: (() => void)[] = []
    const { driver, names } = setUp(({ command }) =>
      command.command === 'drive'
        ? new Promise<void>((resolve) => arrivals.push(resolve))
        : Promise.resolve(),
    )
    driver.hold('a', 'forward')
    driver.hold('b', 'left')
    driver.hold('c', 'right')
    await vi.advanceTimersByTimeAsync(10 * REPEAT_MS)
    expect(names()).toEqual(['drive', 'drive'])
    arrivals[0]?.()
    arrivals[1]?.()
    await vi.advanceTimersByTimeAsync(0)
    expect(names()).toEqual(['drive', 'drive', 'drive'])
    driver.releaseAll()
  })

  it('reports a command that was not taken, and goes on trying while held', async () => {
    const { driver, failures, names } = setUp(() => Promise.reject(new Error('no')))
    driver.hold('a', 'forward')
    await vi.advanceTimersByTimeAsync(REPEAT_MS)
    expect(failures).toEqual(['sim-0001 drive', 'sim-0001 drive'])
    expect(names()).toEqual(['drive', 'drive'])
  })
})
