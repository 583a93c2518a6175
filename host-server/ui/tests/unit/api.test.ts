import { describe, expect, it } from 'vitest'
import { trouble } from '../../src/account/trouble'
import { ApiError, createApi, problemText, picturePath } from '../../src/api'
import { wrongAt } from '../../src/http'
import { sighting } from '../../src/strings'

function answering(status: number, body: unknown) {
  const calls: { url: string; init: RequestInit }[] = []
  const api = createApi((url, init) => {
    calls.push({ url: url as string, init: init ?? {} })
    return Promise.resolve(new Response(JSON.stringify(body), { status }))
  })
  return { api, calls }
}

describe('the API', () => {
  it('posts a command without seq, time or source', async () => {
    const { api, calls } = answering(202, { id: 'abc' })
    const command = { command: 'drive', parameters: { v: 0.2, w: 0 } }
    expect(await api.commandRobot('sim-0001', command)).toBe('abc')
    expect(calls[0]?.url).toBe('/api/v1/robots/sim-0001/commands')
    expect(calls[0]?.init).toMatchObject({ method: 'POST', keepalive: true })
    expect(JSON.parse(calls[0]?.init.body as string)).toEqual(command)
  })

  it('words an error as the problem document does', async () => {
    const { api } = answering(404, { title: 'No such robot', detail: 'sim-9 is unknown' })
    await expect(api.commandSwarm({ command: 'stop' })).rejects.toThrow(
      'No such robot: sim-9 is unknown',
    )
  })

  it('words an unreachable server', async () => {
    const api = createApi(() => Promise.reject(new TypeError('Failed to fetch')))
    const failure = await api.commandSwarm({ command: 'stop' }).catch((error: unknown) => error)
    expect(failure).toBeInstanceOf(ApiError)
    expect(failure).toMatchObject({ status: 0, message: 'the server cannot be reached' })
  })

  it('falls back to the status without a problem document', () => {
    expect(problemText(null, 502)).toBe('the server answered 502')
    expect(problemText({ title: 5 }, 502)).toBe('the server answered 502')
  })
})

describe('parts that are wrong', () => {
  const refused = (detail: string, errors: unknown) =>
    new ApiError('x', 422, 'out_of_range', null, detail, { errors })

  it('are found at their fields', () => {
    const error = refused('two things', [
      { pointer: '/name', detail: 'is missing' },
      { pointer: '/corners/1', detail: 'must be two numbers' },
      { parameter: 'limit', detail: 'must be 1' },
      { pointer: '/name' },
      5,
    ])
    expect(error.parts).toHaveLength(3)
    expect(wrongAt(error, '/name')).toBe('is missing')
    expect(wrongAt(error, '/corners')).toBe('must be two numbers')
    expect(wrongAt(error, '/corner')).toBe(null)
    expect(wrongAt(new Error('x'), '/name')).toBe(null)
    expect(refused('x', 'many').parts).toEqual([])
  })

  it('are named where the words do not say so', () => {
    const range = [{ pointer: '/parameters/v', detail: 'must be -1 to 1' }]
    expect(trouble(refused('a value is out of range', range))).toBe(
      'a value is out of range (/parameters/v must be -1 to 1)',
    )
    expect(trouble(refused('`/parameters/v` must be -1 to 1', range))).toBe(
      '`/parameters/v` must be -1 to 1',
    )
    expect(trouble(refused('too short', [{ pointer: '/new', detail: 'too short' }]))).toBe(
      'too short (/new)',
    )
    expect(trouble(refused('all of it', [{ pointer: '', detail: 'all of it' }]))).toBe('all of it')
  })
})

describe('what the server tells', () => {
  it('is read as the server writes it', async () => {
    const robot = {
      id: 'sim-0001',
      presence: 'online',
      duplicate: false,
      behaviour: 'wander',
      battery: { mv: 7_610, percent: 71 },
      temperature_c: 22.5,
      rssi_dbm: null,
      capabilities: ['drive', 'range', 'camera'],
      image: 1_800_000_000_000,
      sees: {
        timestamp: 1_800_000_000_000,
        frame: 7,
        objects: [{ class: 'object', x: 0.5, y: 0.5, bearing: 0.25, margin: 40 }, { class: 5 }],
      },
    }
    expect(await answering(200, robot).api.robot('sim-0001')).toMatchObject({
      behaviour: 'wander',
      batteryPercent: 71,
      batteryMillivolts: 7_610,
      temperature: 22.5,
      rssi: null,
      camera: true,
      image: 1_800_000_000_000,
      sees: [{ kind: 'object', bearing: 0.25, at: { x: 0.5, y: 0.5 } }],
      duplicate: false,
    })
    expect(await answering(200, {}).api.robot('sim-0001')).toMatchObject({
      camera: false,
      image: null,
      sees: null,
    })
    expect(sighting('object', 0.25)).toBe('object 14° left')
    expect(sighting('robot', -0.5)).toBe('robot 29° right')
    expect(sighting('obstacle', 0.001)).toBe('obstacle ahead')
    expect(picturePath('a/b', 5)).toBe('/robots/a%2Fb/image?received=5')
    const { api } = answering(200, { time: 1, robots: [robot, { id: 'sim-0002', battery: null }] })
    const summaries = await api.summaries()
    expect(summaries.get('sim-0001')).toMatchObject({ battery: 71, behaviour: 'wander' })
    expect(summaries.get('sim-0002')?.battery).toBe(null)
  })

  it('adds up the outcomes of a command', async () => {
    const { api } = answering(200, {
      id: '5',
      status: 'pending',
      reason: null,
      counts: { pending: 2, completed: 48, timeout: 0 },
    })
    expect(await api.outcome('5')).toEqual({
      status: 'pending',
      reason: null,
      completed: 48,
      expected: 50,
    })
  })
})
