import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import { EmergencyStop } from '../../src/control/stop'
import type { Command } from '../../src/api'

beforeEach(() => {
  vi.useFakeTimers()
})
afterEach(() => {
  vi.useRealTimers()
})

function setUp(answers: (() => Promise<string | null>)[]) {
  const sent: string[] = []
  const changes: string[] = []
  const taken: (string | null)[] = []
  const stop = new EmergencyStop({
    send(command: Command) {
      sent.push(command.command)
      return (answers.shift() ?? take)()
    },
    onChange: (state, error) => changes.push(error === null ? state : `${state}: ${error}`),
    onTaken: (id) => taken.push(id),
  })
  return { stop, sent, changes, taken }
}

const take = () => Promise.resolve('7')
const refuse = () => Promise.reject(new Error('unreachable'))

describe('the emergency stop', () => {
  it('latches at once and stands until re-armed', async () => {
    const { stop, sent } = setUp([])
    stop.trigger()
    expect(stop.latched).toBe(true)
    await vi.advanceTimersByTimeAsync(60_000)
    expect(stop.state).toBe('stopped')
    expect(sent).toEqual(['estop'])
    expect(await stop.rearm()).toBe(true)
    expect(stop.state).toBe('armed')
    expect(sent).toEqual(['estop', 'reset'])
  })

  it('sends again until the server takes it, and says so meanwhile', async () => {
    const { stop, sent, changes, taken } = setUp([refuse, refuse, refuse])
    stop.trigger()
    await vi.advanceTimersByTimeAsync(5_000)
    expect(sent).toEqual(['estop', 'estop', 'estop', 'estop'])
    expect(changes).toContain('sending: unreachable')
    expect(taken).toEqual(['7'])
    expect(stop.state).toBe('stopped')
  })

  it('cannot be re-armed before the server has taken it', async () => {
    const { stop, sent } = setUp([refuse])
    stop.trigger()
    await vi.advanceTimersByTimeAsync(0)
    expect(await stop.rearm()).toBe(false)
    expect(sent).not.toContain('reset')
  })

  it('stays stopped when re-arming fails', async () => {
    const { stop, changes } = setUp([take, refuse])
    stop.trigger()
    await vi.advanceTimersByTimeAsync(0)
    expect(await stop.rearm()).toBe(false)
    expect(stop.state).toBe('stopped')
    expect(changes.at(-1)).toBe('stopped: unreachable')
  })

  it('wins over a re-arming that is under way', async () => {
    let answer: () => void = () => undefined
    const { stop } = setUp([
      take,
      () =>
        new Promise<null>((resolve) => {
          answer = () => resolve(null)
        }),
    ])
    stop.trigger()
    await vi.advanceTimersByTimeAsync(0)
    const rearmed = stop.rearm()
    stop.trigger()
    answer()
    expect(await rearmed).toBe(false)
    await vi.advanceTimersByTimeAsync(0)
    expect(stop.state).toBe('stopped')
  })

  it('takes over a stop pressed elsewhere without sending one', async () => {
    const { stop, sent } = setUp([])
    stop.adopt()
    expect(stop.state).toBe('stopped')
    expect(sent).toEqual([])
  })
})
