import { describe, expect, it } from 'vitest'
import type { CommandRecord, OutcomeStatus } from '../../src/api-types'
import type { Command } from '../../src/api'
import { Dispatch, summarise } from '../../src/control/progress'
import type { Outlet } from '../../src/control/progress'
import { Slide } from '../../src/control/slide'
import { ApiError } from '../../src/http'

const COUNTS = {
  pending: 0,
  accepted: 0,
  completed: 0,
  rejected: 0,
  expired: 0,
  stale: 0,
  failed: 0,
  timeout: 0,
}

function record(id: string, robots: Record<string, OutcomeStatus>): CommandRecord {
  const all = Object.values(robots)
  return {
    id,
    seq: Number(id),
    command: 'stop',
    source: 'server',
    timestamp: 1,
    counts: COUNTS,
    status: all.find((status) => status !== 'completed') ?? 'completed',
    outcomes: Object.entries(robots).map(([robot, status]) => ({ robot, status })),
  }
}

/** A server on which each robot answers at the second look. */
class Toy implements Outlet {
  readonly sent: string[] = []
  refuse: (robot: string) => ApiError | null = () => null
  private readonly known = new Map<string, { robot: string; looks: number }>()

  toSwarm(): Promise<CommandRecord> {
    this.known.set('0', { robot: '', looks: 0 })
    return Promise.resolve({ ...record('0', {}), status: 'pending' })
  }

  toRobot(robot: string, command: Command): Promise<CommandRecord> {
    const error = this.refuse(robot)
    if (error !== null) return Promise.reject(error)
    this.sent.push(`${robot} ${command.command}`)
    const id = String(this.sent.length)
    this.known.set(id, { robot, looks: 0 })
    return Promise.resolve(record(id, { [robot]: 'pending' }))
  }

  command(id: string): Promise<CommandRecord> {
    const known = this.known.get(id)
    if (known === undefined) return Promise.reject(new ApiError('unknown', 404))
    known.looks += 1
    if (id === '0') {
      return Promise.resolve(
        record(
          '0',
          known.looks < 2 ? { a: 'completed', b: 'pending' } : { a: 'completed', b: 'failed' },
        ),
      )
    }
    return Promise.resolve(record(id, { [known.robot]: known.looks < 2 ? 'pending' : 'completed' }))
  }

  async commands(): Promise<readonly CommandRecord[]> {
    // The list forgets the first, so that it must be asked for by itself.
    const ids = [...this.known.keys()].filter((id) => id !== '1')
    return Promise.all(ids.map((id) => this.command(id)))
  }
}

const at_once = () => Promise.resolve()
const command = { command: 'stop' }

describe('a command to many', () => {
  it('to all is one command, followed to its end', async () => {
    const dispatch = new Dispatch([command], { all: true }, new Toy(), at_once)
    await dispatch.run()
    expect(dispatch.progress.value).toMatchObject({ done: 1, failed: 1, open: 0, error: null })
    expect(dispatch.failures).toEqual(['b'])
    // What went wrong stands first.
    expect(dispatch.progress.value.steps[0]?.robot).toBe('b')
  })

  it('to a group is one for each, and several where it takes several', async () => {
    const toy = new Toy()
    const dispatch = new Dispatch(
      [command, { command: 'identify' }],
      { all: false, robots: ['a', 'b', 'a'] },
      toy,
      at_once,
    )
    await dispatch.run()
    expect([...toy.sent].sort()).toEqual(['a identify', 'a stop', 'b identify', 'b stop'])
    expect(dispatch.progress.value).toMatchObject({ done: 2, failed: 0, open: 0 })
  })

  it('waits when it is told to, and says what was not sent', async () => {
    const toy = new Toy()
    let refusals = 0
    toy.refuse = (robot) => {
      if (robot === 'b') return new ApiError('nobody knows it', 404)
      refusals += 1
      return refusals < 3 ? new ApiError('too many', 429, null, 1) : null
    }
    const dispatch = new Dispatch([command], { all: false, robots: ['a', 'b'] }, toy, at_once)
    await dispatch.run()
    expect(toy.sent).toEqual(['a stop'])
    expect(dispatch.progress.value.steps).toEqual([
      { robot: 'b', status: 'unsent', reason: 'nobody knows it' },
      { robot: 'a', status: 'completed', reason: null },
    ])
  })

  it('does not go on for ever against a server that refuses', async () => {
    const toy = new Toy()
    toy.refuse = () => new ApiError('too many', 429, null, 1)
    const dispatch = new Dispatch([command], { all: false, robots: ['a'] }, toy, at_once)
    await dispatch.run()
    expect(dispatch.progress.value).toMatchObject({ failed: 1, open: 0 })
  })

  it('says when the whole of it was not taken', async () => {
    const toy = new Toy()
    toy.toSwarm = () => Promise.reject(new ApiError('no robot is online', 409))
    const dispatch = new Dispatch([command], { all: true }, toy, at_once)
    await dispatch.run()
    expect(dispatch.progress.value.error).toBe('no robot is online')
  })

  it('counts nobody twice', () => {
    const progress = summarise([
      { robot: 'b', status: 'completed', reason: null },
      { robot: 'a', status: 'timeout', reason: null },
      { robot: 'c', status: 'accepted', reason: null },
    ])
    expect(progress).toMatchObject({ done: 1, failed: 1, open: 1 })
    expect(progress.steps.map(({ robot }) => robot)).toEqual(['a', 'c', 'b'])
  })
})

describe('sliding to confirm', () => {
  it('takes the whole way', () => {
    const slide = new Slide()
    for (const share of [0.1, 0.3, 0.5, 0.8]) expect(slide.to(share)).toBe('sliding')
    expect(slide.to(1)).toBe('confirmed')
    expect(slide.to(0.2)).toBe('sliding')
  })

  it('a tap at the end is no slide', () => {
    expect(new Slide().to(1)).toBe('jumped')
    const slide = new Slide()
    slide.to(0.3)
    expect(slide.to(0.9)).toBe('jumped')
    // And the way begins anew.
    expect(slide.to(0.9)).toBe('jumped')
  })

  it('begins anew when it is let go', () => {
    const slide = new Slide()
    slide.to(0.3)
    slide.to(0.6)
    slide.release()
    expect(slide.to(0.8)).toBe('jumped')
  })
})
