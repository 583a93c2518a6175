// @vitest-environment happy-dom

import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { Api, Command, Outcome } from '../../src/api'
import { installControls } from '../../src/control/controls'
import { MOST_LOG_ENTRIES, Room } from '../../src/control/room'
import type { PoseRow } from '../mock/encode.mjs'
import { jsonFrame, posesFrame } from '../mock/encode.mjs'

class FakeSocket {
  binaryType = 'blob'
  onmessage: ((message: { data: unknown }) => void) | null = null
  onclose: (() => void) | null = null
  onerror: (() => void) | null = null
  close(): void {
    this.onclose?.()
  }
}

const T0 = 1_700_000_000_000
let keys: 'room' | 'page' | 'off' = 'room'
const page = {
  keys: () => keys,
  help: () => undefined,
  search: () => undefined,
  neighbour: () => undefined,
  zoom: () => undefined,
  fit: () => undefined,
}
let clean: (() => void)[] = []

function setUp(
  outcome: Outcome = { status: 'completed', reason: null, completed: 1, expected: 1 },
) {
  const sent: string[] = []
  const sockets: FakeSocket[] = []
  const record = (to: string, { command }: Command) => {
    sent.push(`${to} ${command}`)
    return Promise.resolve(String(sent.length))
  }
  const api: Api = {
    commandRobot: record,
    commandSwarm: (command) => record('swarm', command),
    outcome: () => Promise.resolve(outcome),
    robot: () => Promise.reject(new Error('not asked for here')),
    summaries: () => Promise.resolve(new Map()),
    readiness: () =>
      Promise.resolve({ broker: true, simulation: null, journal: true, audit: true }),
    metrics: () => Promise.resolve(''),
    picture: () => Promise.reject(new Error('not asked for here')),
  }
  const room = new Room({
    url: 'ws://test',
    api,
    open() {
      const socket = new FakeSocket()
      sockets.push(socket)
      return socket as unknown as WebSocket
    },
  })
  room.start()
  clean.push(() => room.close(), installControls(room, page))
  const receive = (frame: ArrayBuffer) => sockets.at(-1)?.onmessage?.({ data: frame })
  const pose = (index: number, change: Partial<PoseRow> = {}): PoseRow => ({
    index,
    x: 0,
    y: 0,
    heading: 0,
    state: 'MOVING',
    presence: 'online',
    ...change,
  })
  receive(jsonFrame('hello', { protocol: 2, fleet: 'swarm', time: T0, arena: null }))
  receive(
    jsonFrame('roster', {
      removed: [],
      robots: [0, 1].map((index) => ({
        index,
        id: `sim-${String(index)}`,
        kind: 'simulated',
        online: 'online',
        firmware: '',
        board: '',
      })),
    }),
  )
  const show = (ms: number, ...robots: PoseRow[]) => {
    receive(posesFrame({ ms: T0 + ms, robots }))
  }
  show(0, pose(0), pose(1))
  return { room, sent, sockets, receive, pose, show }
}

function key(
  type: 'keydown' | 'keyup',
  code: string,
  name = code,
  target: Element = document.body,
) {
  const event = new KeyboardEvent(type, { code, key: name, bubbles: true, cancelable: true })
  target.dispatchEvent(event)
  return event
}

beforeEach(() => {
  keys = 'room'
  vi.useFakeTimers()
  document.body.innerHTML = '<button>press</button><input />'
})
afterEach(() => {
  for (const undo of clean) undo()
  clean = []
  vi.useRealTimers()
})

describe('Space on the page', () => {
  it('stops the swarm and never reaches the focused button', () => {
    const { sent } = setUp()
    const button = document.querySelector('button') as HTMLButtonElement
    const seen: string[] = []
    for (const type of ['keydown', 'keyup']) button.addEventListener(type, () => seen.push(type))
    button.focus()
    const down = key('keydown', 'Space', ' ', button)
    const up = key('keyup', 'Space', ' ', button)
    expect(sent).toEqual(['swarm estop'])
    expect([down.defaultPrevented, up.defaultPrevented]).toEqual([true, true])
    expect(seen).toEqual([])
  })

  it('is left to a text field', () => {
    const { sent } = setUp()
    const input = document.querySelector('input') as HTMLInputElement
    input.focus()
    expect(key('keydown', 'Space', ' ', input).defaultPrevented).toBe(false)
    expect(sent).toEqual([])
  })

  it('ends driving, and driving stays refused until re-armed', async () => {
    const { room, sent } = setUp()
    room.select('sim-0')
    key('keydown', 'ArrowUp')
    key('keydown', 'Space', ' ')
    expect(sent).toEqual(['sim-0 drive', 'swarm estop', 'sim-0 stop'])
    await vi.advanceTimersByTimeAsync(1_000)
    key('keydown', 'ArrowUp')
    expect(sent.filter((text) => text.includes('drive'))).toHaveLength(1)
    await room.rearm()
    key('keyup', 'ArrowUp')
    key('keydown', 'ArrowUp')
    expect(sent.filter((text) => text.includes('drive'))).toHaveLength(2)
  })

  it('counts who has confirmed', async () => {
    const { room } = setUp({ status: 'timeout', reason: null, completed: 1, expected: 2 })
    room.stopAll()
    await vi.advanceTimersByTimeAsync(50)
    expect(room.stopReceipt.value).toEqual({ completed: 1, expected: 2 })
  })
})

describe('keys on other pages', () => {
  it('stop, and do nothing else', () => {
    const { room, sent } = setUp()
    room.select('sim-0')
    keys = 'page'
    for (const code of ['ArrowUp', 'KeyW', 'Escape']) {
      expect(key('keydown', code).defaultPrevented).toBe(false)
    }
    expect(room.selectedId.value).toBe('sim-0')
    expect(sent).toEqual([])
    key('keydown', 'Space', ' ')
    expect(sent).toEqual(['swarm estop'])
  })

  it('do nothing at all on a page that is covered by the login', () => {
    const { sent } = setUp()
    keys = 'off'
    expect(key('keydown', 'Space', ' ').defaultPrevented).toBe(false)
    expect(key('keyup', 'Space', ' ').defaultPrevented).toBe(false)
    expect(sent).toEqual([])
  })
})

describe('driving with the keyboard', () => {
  it.each([
    ['letting go', () => key('keyup', 'ArrowUp')],
    ['losing the window', () => window.dispatchEvent(new Event('blur'))],
    ['Escape', () => key('keydown', 'Escape')],
  ])('ends with %s', async (_, act) => {
    const { room, sent } = setUp()
    room.select('sim-0')
    key('keydown', 'ArrowUp')
    await vi.advanceTimersByTimeAsync(310)
    act()
    expect(sent).toEqual(['sim-0 drive', 'sim-0 drive', 'sim-0 drive', 'sim-0 stop'])
    await vi.advanceTimersByTimeAsync(1_000)
    expect(sent).toHaveLength(4)
    expect(room.selectedId.value).toBe('sim-0')
  })

  it('ends with the tab going to the back', () => {
    const { room, sent } = setUp()
    room.select('sim-0')
    key('keydown', 'ArrowUp')
    vi.spyOn(document, 'hidden', 'get').mockReturnValue(true)
    document.dispatchEvent(new Event('visibilitychange'))
    expect(sent.at(-1)).toBe('sim-0 stop')
  })

  it('ends with the connection', () => {
    const { room, sent, sockets } = setUp()
    room.select('sim-0')
    key('keydown', 'ArrowUp')
    sockets[0]?.onclose?.()
    expect(sent.at(-1)).toBe('sim-0 stop')
    expect(room.blocked.value).toBe('link')
  })

  it.each([
    ['stale', { presence: 'stale' }],
    ['offline', { presence: 'offline' }],
    ['updating', { state: 'UPDATING' }],
  ] as const)('ends when the robot is %s', async (reason, change) => {
    const { room, sent, pose, show } = setUp()
    room.select('sim-0')
    key('keydown', 'ArrowUp')
    show(100, pose(0, change))
    await vi.advanceTimersByTimeAsync(250)
    expect(sent.at(-1)).toBe('sim-0 stop')
    expect(room.blocked.value).toBe(reason)
    expect(room.hold('key:x', 'forward')).toBe(false)
  })

  it('says what the robot refused', async () => {
    const { room } = setUp({ status: 'rejected', reason: 'no_clock', completed: 0, expected: 1 })
    room.select('sim-0')
    key('keydown', 'ArrowUp')
    await vi.advanceTimersByTimeAsync(900)
    expect(room.driveError.value).toContain('its clock is not set yet')
    expect(room.log.value[0]).toMatchObject({ level: 'warn', robot: 'sim-0' })
  })
})

describe('a stop pressed elsewhere', () => {
  it('is taken over when all reachable robots report ERROR for a while', async () => {
    const { room, sent, pose, show } = setUp()
    show(100, pose(0, { state: 'ERROR' }))
    await vi.advanceTimersByTimeAsync(3_000)
    expect(room.stopState.value).toBe('armed')
    show(200, pose(1, { state: 'ERROR' }))
    await vi.advanceTimersByTimeAsync(1_000)
    expect(room.stopState.value).toBe('armed')
    await vi.advanceTimersByTimeAsync(1_000)
    expect(room.stopState.value).toBe('stopped')
    expect(sent).toEqual([])
  })
})

describe('the log', () => {
  it('is bounded, newest first', async () => {
    const { room } = setUp()
    for (let i = 0; i < MOST_LOG_ENTRIES + 40; i++) room.note('info', null, String(i))
    await vi.advanceTimersByTimeAsync(200)
    for (let i = MOST_LOG_ENTRIES + 40; i < MOST_LOG_ENTRIES + 50; i++) {
      room.note('info', null, String(i))
    }
    await vi.advanceTimersByTimeAsync(200)
    expect(room.log.value).toHaveLength(MOST_LOG_ENTRIES)
    expect(room.log.value[0]?.text).toBe(String(MOST_LOG_ENTRIES + 49))
  })
})

describe('frames that cannot be read', () => {
  it('are counted', () => {
    const { room, receive } = setUp()
    receive(new Uint8Array([2, 0, 9]).buffer)
    receive(new Uint8Array([77]).buffer)
    expect(room.ignored.value).toBe(2)
  })
})

describe('another arena on the same socket', () => {
  const arena = { width: 4, height: 3, obstacles: [{ shape: 'circle', x: 1, y: 0, r: 0.2 }] }
  const hello = (time: number, of: unknown) =>
    jsonFrame('hello', { protocol: 2, fleet: 'swarm', time, arena: of })
  const roster = (index: number) =>
    jsonFrame('roster', {
      removed: [],
      robots: [
        {
          index,
          id: `sim-${String(index)}`,
          kind: 'simulated',
          online: 'online',
          firmware: '',
          board: '',
        },
      ],
    })

  it('is shown, and takes nobody away', () => {
    const { room, receive, pose, show } = setUp()
    receive(hello(T0 + 100, arena))
    expect(room.arena.value).toMatchObject({ width: 4, obstacles: [{ r: 0.2 }] })
    // A robot that is added then is one more, not the only one.
    receive(roster(2))
    expect([...room.fleet.all()].map(({ id }) => id)).toEqual(['sim-0', 'sim-1', 'sim-2'])
    show(200, pose(0, { x: 1.5 }))
    expect(room.fleet.get('sim-0')?.x).toBeCloseTo(1.5)
    receive(hello(T0 + 300, null))
    expect(room.arena.value).toBe(null)
    expect(room.status.value.state).toBe('live')
    expect(room.log.value.filter(({ level }) => level === 'error')).toEqual([])
  })

  it('keeps what drives driving', () => {
    const { room, sent, receive } = setUp()
    room.select('sim-0')
    key('keydown', 'ArrowUp')
    receive(hello(T0 + 100, arena))
    expect(room.driving.value).toBe(true)
    expect(sent).toEqual(['sim-0 drive'])
  })

  it('is another matter on a new socket: the next roster is everybody', async () => {
    const { room, receive, sockets } = setUp()
    sockets[0]?.onclose?.()
    await vi.advanceTimersByTimeAsync(1_000)
    expect(sockets).toHaveLength(2)
    receive(hello(T0 + 2_000, arena))
    receive(roster(1))
    expect([...room.fleet.all()].map(({ id }) => id)).toEqual(['sim-1'])
  })
})

describe('a feed of another version', () => {
  it('is named', () => {
    const { room, receive } = setUp()
    receive(jsonFrame('hello', { protocol: 3, fleet: 'swarm', time: T0, arena: null }))
    expect(room.mismatch.value).toBe(3)
  })
})
