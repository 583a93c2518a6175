/**
 * Decoding of the live feed (`GET /api/v1/live`): binary frames, little-endian,
 * the first byte names the kind. Nothing here throws: what cannot be read in
 * full is refused with a reason, so that one bad frame costs that frame only.
 */

import type { Arena } from './arena'
import { readArena } from './arena'
import type { Fields, Refusal } from './fields'
import { Refused, array, number, object, oneOf, slot, string } from './fields'
import type { PosesFrame, Presence, RobotState } from './poses'
import { PRESENCES, STATES, readPoses } from './poses'

export type { Arena, Obstacle } from './arena'
export type { Refusal } from './fields'
export type { PosesFrame, Presence, RobotState } from './poses'
export { PRESENCES, STATES } from './poses'

/** Protocol version in the hello frame that this page understands. */
export const FEED_PROTOCOL = 2
/** Frames above this size are refused unread: 65,536 poses are 533 kB. */
export const MAX_FRAME_BYTES = 8 * 1024 * 1024

export const KINDS = ['simulated', 'emulated', 'physical'] as const
export type Kind = (typeof KINDS)[number]

interface HelloFrame {
  kind: 'hello'
  protocol: number
  fleet: string
  /** Server clock, Unix milliseconds. */
  time: number
  arena: Arena | null
}

export interface RosterEntry {
  index: number
  id: string
  kind: Kind
  presence: Presence
  firmware: string
  board: string
  /** The fence that it is on the wrong side of, where there is one. */
  fence?: string
}

export interface RosterFrame {
  kind: 'roster'
  robots: RosterEntry[]
  removed: number[]
}

export type Level = 'info' | 'warn' | 'error'

interface EventFrame {
  kind: 'event'
  time: number
  level: Level
  robot: string | null
  text: string
}

export interface MetricsFrame {
  kind: 'metrics'
  robots: Record<Presence, number>
  states: Partial<Record<RobotState, number>>
  messagesPerSecond: number
  commands: { sent: number; answered: number }
  /** Simulated seconds per second; null without a simulation. */
  realTimeFactor: number | null
}

export type Frame = HelloFrame | RosterFrame | PosesFrame | EventFrame | MetricsFrame

type Decoded = { ok: true; frame: Frame } | { ok: false; reason: Refusal }

/** Reads one frame. Never throws. */
export function decodeFrame(buffer: ArrayBuffer): Decoded {
  try {
    return { ok: true, frame: readFrame(buffer) }
  } catch (error) {
    return { ok: false, reason: error instanceof Refused ? error.reason : 'bad-shape' }
  }
}

/**
 * Full Unix milliseconds from their low 32 bits: the instant nearest to
 * `reference`, which must be within 24 days of the truth.
 */
export function expandTime(low: number, reference: number): number {
  const span = 2 ** 32
  const candidate = Math.floor(reference / span) * span + low
  if (candidate - reference > span / 2) return candidate - span
  if (reference - candidate > span / 2) return candidate + span
  return candidate
}

function readFrame(buffer: ArrayBuffer): Frame {
  if (buffer.byteLength === 0) throw new Refused('empty')
  if (buffer.byteLength > MAX_FRAME_BYTES) throw new Refused('too-large')
  const view = new DataView(buffer)
  switch (view.getUint8(0)) {
    case 0:
      return readHello(readJson(buffer))
    case 1:
      return readRoster(readJson(buffer))
    case 2:
      return readPoses(view)
    case 3:
      return readEvent(readJson(buffer))
    case 4:
      return readMetrics(readJson(buffer))
    default:
      throw new Refused('unknown-kind')
  }
}

function readJson(buffer: ArrayBuffer): Fields {
  let text: string
  try {
    text = new TextDecoder('utf-8', { fatal: true }).decode(new Uint8Array(buffer, 1))
  } catch {
    throw new Refused('not-utf8')
  }
  let value: unknown
  try {
    value = JSON.parse(text)
  } catch {
    throw new Refused('not-json')
  }
  return object(value)
}

function readHello(body: Fields): HelloFrame {
  return {
    kind: 'hello',
    protocol: number(body['protocol']),
    fleet: string(body['fleet']),
    time: number(body['time']),
    arena: body['arena'] === null ? null : readArena(object(body['arena'])),
  }
}

function readRoster(body: Fields): RosterFrame {
  const robots = array(body['robots']).map((item): RosterEntry => {
    const entry = object(item)
    return {
      index: slot(entry['index']),
      id: string(entry['id']),
      kind: oneOf(KINDS, entry['kind']),
      presence: oneOf(PRESENCES, entry['online']),
      firmware: string(entry['firmware']),
      board: string(entry['board']),
      ...(entry['fence'] === undefined ? {} : { fence: string(entry['fence']) }),
    }
  })
  return { kind: 'roster', robots, removed: array(body['removed']).map(slot) }
}

function readEvent(body: Fields): EventFrame {
  return {
    kind: 'event',
    time: number(body['time']),
    level: oneOf(['info', 'warn', 'error'] as const, body['level']),
    robot: body['robot'] === null ? null : string(body['robot']),
    text: string(body['text']),
  }
}

function readMetrics(body: Fields): MetricsFrame {
  const robots = object(body['robots'])
  const commands = object(body['commands'])
  const counts = object(body['states'])
  const states: Partial<Record<RobotState, number>> = {}
  for (const state of STATES) {
    if (counts[state] !== undefined) states[state] = number(counts[state])
  }
  return {
    kind: 'metrics',
    robots: {
      online: number(robots['online']),
      stale: number(robots['stale']),
      offline: number(robots['offline']),
    },
    states,
    messagesPerSecond: number(body['messages_per_s']),
    commands: { sent: number(commands['sent']), answered: number(commands['answered']) },
    realTimeFactor: body['real_time_factor'] === null ? null : number(body['real_time_factor']),
  }
}
