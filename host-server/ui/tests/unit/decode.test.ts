import { describe, expect, it } from 'vitest'
import { jsonFrame, posesFrame } from '../mock/encode.mjs'
import { MAX_FRAME_BYTES, decodeFrame, expandTime } from '../../src/feed/decode'
import type { Refusal } from '../../src/feed/decode'

function reason(buffer: ArrayBuffer): Refusal | 'accepted' {
  const decoded = decodeFrame(buffer)
  return decoded.ok ? 'accepted' : decoded.reason
}

const robot = {
  index: 7,
  x: 1.25,
  y: -2.5,
  heading: Math.PI / 2,
  state: 'AVOIDING',
  presence: 'stale',
  rangeMm: 812,
  lowBattery: true,
}
const poses = () =>
  posesFrame({ full: true, ms: 1_700_000_000_123, x0: -5, y0: -5, unit: 0.001, robots: [robot] })

const hello = {
  protocol: 2,
  fleet: 'swarm',
  time: 1_700_000_000_000,
  arena: {
    width: 10,
    height: 8,
    obstacles: [
      { shape: 'circle', x: 1, y: 2, r: 0.3 },
      { shape: 'box', x: -1, y: 0, w: 0.5, h: 0.2, theta: 0.7 },
    ],
    movers: [{ body: { shape: 'circle', x: 2, y: 0, r: 0.1 }, path: [[2, 1]], speed: 0.2 }],
    patches: [{ x: 0, y: 3, w: 1, h: 2, theta: 0, grip: 0.4 }],
    objects: [{ shape: 'cone', x: 3, y: 3, size: 0.2, colour: 'orange' }],
  },
}
const roster = {
  robots: [
    {
      index: 0,
      id: 'sim-0001',
      kind: 'simulated',
      online: 'online',
      firmware: '0.1.0',
      board: 'sim',
    },
  ],
  removed: [3],
}
const event = { time: 5, level: 'warn', robot: null, text: 'something' }
const metrics = {
  robots: { online: 2, stale: 1, offline: 0 },
  states: { IDLE: 2, MOVING: 1 },
  messages_per_s: 12.5,
  commands: { sent: 4, answered: 3 },
  real_time_factor: null,
}

describe('poses', () => {
  it('reads every field of a pose', () => {
    const decoded = decodeFrame(poses())
    if (!decoded.ok || decoded.frame.kind !== 'poses') throw new Error('not poses')
    const { frame } = decoded
    expect(frame).toMatchObject({ full: true, count: 1, ms: 1_700_000_000_123 % 2 ** 32 })
    expect([...frame.index]).toEqual([7])
    expect(frame.x[0]).toBeCloseTo(1.25, 4)
    expect(frame.y[0]).toBeCloseTo(-2.5, 4)
    expect(frame.heading[0]).toBeCloseTo(Math.PI / 2, 3)
    expect([frame.state[0], frame.presence[0]]).toEqual([5, 1])
    expect([frame.range[0], frame.lowBattery[0]]).toEqual([812, 1])
  })

  it('tells a missing range from a range of zero', () => {
    const without = decodeFrame(posesFrame({ ms: 0, robots: [{ ...robot, y: 0, rangeMm: null }] }))
    const zero = decodeFrame(posesFrame({ ms: 0, robots: [{ ...robot, y: 0, rangeMm: 0 }] }))
    if (!without.ok || without.frame.kind !== 'poses') throw new Error('not poses')
    if (!zero.ok || zero.frame.kind !== 'poses') throw new Error('not poses')
    expect([without.frame.range[0], zero.frame.range[0]]).toEqual([-1, 0])
  })

  it.each([true, false])('reads indices, as a bitmap: %s', (bitmap) => {
    const robots = [3, 4, 11, 19, 40].map((index) => ({ ...robot, index, x: index, y: 0 }))
    const decoded = decodeFrame(posesFrame({ ms: 0, robots, bitmap }))
    if (!decoded.ok || decoded.frame.kind !== 'poses') throw new Error('not poses')
    expect([...decoded.frame.index]).toEqual([3, 4, 11, 19, 40])
    expect(decoded.frame.x[4]).toBeCloseTo(40, 3)
  })

  it('takes less than ten bytes for a robot', () => {
    const robots = Array.from({ length: 1_000 }, (_, index) => ({ ...robot, index, y: 0 }))
    expect(posesFrame({ ms: 0, robots }).byteLength / robots.length).toBeLessThan(8.2)
  })

  it('refuses a bitmap that does not match the count', () => {
    const buffer = posesFrame({ ms: 0, robots: [{ ...robot, y: 0 }], bitmap: true })
    for (const bits of [0, 3]) {
      new DataView(buffer).setUint8(24, bits)
      expect(reason(buffer)).toBe('bad-shape')
    }
  })

  it.each([true, false])('refuses every truncation, as a bitmap: %s', (bitmap) => {
    const whole = posesFrame({ ms: 5, robots: [{ ...robot, y: 0 }], bitmap })
    for (let length = 1; length < whole.byteLength; length++) {
      expect(reason(whole.slice(0, length)), `${String(length)} bytes`).toBe('truncated')
    }
    expect(reason(whole)).toBe('accepted')
  })

  it('refuses bytes after the last pose', () => {
    const longer = new Uint8Array(poses().byteLength + 1)
    longer.set(new Uint8Array(poses()))
    expect(reason(longer.buffer)).toBe('trailing-bytes')
  })

  it.each([['an unknown presence', 20 + 2 + 7, 0xc0]])('refuses %s', (_, at, value) => {
    const buffer = poses()
    new DataView(buffer).setUint8(at, value)
    expect(reason(buffer)).toBe('bad-shape')
  })

  it.each([
    ['an origin that is no number', 8, Number.NaN],
    ['an infinite origin', 12, Number.POSITIVE_INFINITY],
    ['a unit of zero', 16, 0],
    ['a negative unit', 16, -0.001],
  ])('refuses %s', (_, at, value) => {
    const buffer = poses()
    new DataView(buffer).setFloat32(at, value, true)
    expect(reason(buffer)).toBe('bad-shape')
  })

  it('never throws, whatever single byte is wrong', () => {
    const whole = new Uint8Array(poses())
    const told = new Set<boolean>()
    for (let at = 0; at < whole.length; at++) {
      for (let value = 0; value < 256; value++) {
        const bent = whole.slice()
        bent[at] = value
        // Whatever it throws fails the test; `expect` for each of them takes seconds.
        told.add(decodeFrame(bent.buffer).ok)
      }
    }
    expect(told).toEqual(new Set([true, false]))
  })
})

describe('JSON frames', () => {
  it.each([
    ['hello', hello],
    ['roster', roster],
    ['event', event],
    ['metrics', metrics],
  ] as const)('reads %s', (kind, body) => {
    const decoded = decodeFrame(jsonFrame(kind, body))
    expect(decoded.ok && decoded.frame.kind).toBe(kind)
    expect(decoded).toMatchSnapshot()
  })

  it('takes a hello without an arena', () => {
    expect(reason(jsonFrame('hello', { ...hello, arena: null }))).toBe('accepted')
  })

  it.each([
    ['hello', { ...hello, arena: { ...hello.arena, width: 0 } }],
    ['hello', { ...hello, arena: { ...hello.arena, obstacles: [{ shape: 'star', x: 0, y: 0 }] } }],
    ['hello', { ...hello, arena: { ...hello.arena, objects: [{ shape: 'cone', x: 0, y: 0 }] } }],
    ['hello', { ...hello, arena: { ...hello.arena, movers: [{ path: [] }] } }],
    ['hello', { ...hello, time: '5' }],
    ['roster', { robots: [{ ...roster.robots[0], index: 65_536 }], removed: [] }],
    ['roster', { robots: [{ ...roster.robots[0], index: 1.5 }], removed: [] }],
    ['roster', { robots: [{ ...roster.robots[0], kind: 'imagined' }], removed: [] }],
    ['roster', { robots: [{ ...roster.robots[0], fence: 7 }], removed: [] }],
    ['roster', { robots: [] }],
    ['event', { ...event, level: 'panic' }],
    ['event', { ...event, text: null }],
    ['metrics', { ...metrics, commands: { sent: 1 } }],
    ['metrics', []],
    ['metrics', null],
  ] as const)('refuses a %s of another shape: %j', (kind, body) => {
    expect(reason(jsonFrame(kind, body))).toBe('bad-shape')
  })

  it('reads the fence of a robot that is beyond one', () => {
    const robots = [{ ...roster.robots[0], fence: 'yard' }, roster.robots[0]]
    const decoded = decodeFrame(jsonFrame('roster', { robots, removed: [] }))
    if (!decoded.ok || decoded.frame.kind !== 'roster') throw new Error('not read')
    expect(decoded.frame.robots.map(({ fence }) => fence)).toEqual(['yard', undefined])
  })

  it('refuses every truncation of a roster', () => {
    const whole = jsonFrame('roster', roster)
    for (let length = 1; length < whole.byteLength; length++) {
      expect(reason(whole.slice(0, length))).toBe('not-json')
    }
  })
})

describe('frames that are none', () => {
  it.each([
    ['empty', []],
    ['unknown-kind', [5, 1, 2, 3]],
    ['unknown-kind', [255]],
    ['not-json', [3, 0x7b]],
    ['not-utf8', [3, 0xff, 0xfe]],
  ] as const)('are refused as %s', (expected, bytes) => {
    expect(reason(new Uint8Array(bytes).buffer)).toBe(expected)
  })

  it('are refused unread when too large', () => {
    expect(reason(new ArrayBuffer(MAX_FRAME_BYTES + 1))).toBe('too-large')
  })
})

describe('expandTime', () => {
  const span = 2 ** 32
  it.each([
    [1_700_000_000_123, 1_700_000_000_000],
    [400 * span + 5, 400 * span - 5],
    [400 * span - 5, 400 * span + 5],
  ])('finds %d near %d', (truth, reference) => {
    expect(expandTime(truth % span, reference)).toBe(truth)
  })
})
