/**
 * Decoding of the live feed (`GET /api/v1/live`): binary frames, little-endian,
 * the first byte names the kind. Nothing here throws: what cannot be read in
 * full is refused with a reason, so that one bad frame costs that frame only.
 */

/** Protocol version in the hello frame that this page understands. */
export const FEED_PROTOCOL = 1
/** Frames above this size are refused unread: 65,536 poses are 786 kB. */
export const MAX_FRAME_BYTES = 8 * 1024 * 1024

/** States as robots report them; the order is the code on the wire. */
export const STATES = [
  'INITIALIZING',
  'IDLE',
  'MOVING',
  'SCANNING',
  'CAUTION',
  'AVOIDING',
  'UPDATING',
  'ERROR',
] as const
export type RobotState = (typeof STATES)[number]

/** Presence of a robot; the order is the code on the wire. */
export const PRESENCES = ['online', 'stale', 'offline'] as const
export type Presence = (typeof PRESENCES)[number]

export const KINDS = ['simulated', 'emulated', 'physical'] as const
export type Kind = (typeof KINDS)[number]

export type Obstacle =
  | { shape: 'circle'; x: number; y: number; r: number }
  | { shape: 'box'; x: number; y: number; w: number; h: number; theta: number }

/** Arena centred on the origin, lengths in metres. */
export interface Arena {
  width: number
  height: number
  obstacles: Obstacle[]
}

export interface HelloFrame {
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
}

export interface RosterFrame {
  kind: 'roster'
  robots: RosterEntry[]
  removed: number[]
}

/** Columns rather than objects: a full snapshot may hold 10,000 robots. */
export interface PosesFrame {
  kind: 'poses'
  full: boolean
  count: number
  /** Low 32 bits of the server's Unix milliseconds; see {@link expandTime}. */
  ms: number
  index: Uint16Array
  /** Metres. */
  x: Float32Array
  y: Float32Array
  /** Radians, 0 ≤ heading < 2π. */
  heading: Float32Array
  /** Indices into {@link STATES}. */
  state: Uint8Array
  /** Indices into {@link PRESENCES}. */
  presence: Uint8Array
  /** Millimetres, or −1 when there is no reading. */
  range: Int32Array
  /** 1 when the battery is below 20 %. */
  lowBattery: Uint8Array
}

export type Level = 'info' | 'warn' | 'error'

export interface EventFrame {
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

/** Why a frame was refused. */
export type Refusal =
  | 'empty'
  | 'too-large'
  | 'unknown-kind'
  | 'truncated'
  | 'trailing-bytes'
  | 'not-utf8'
  | 'not-json'
  | 'bad-shape'

export type Decoded = { ok: true; frame: Frame } | { ok: false; reason: Refusal }

const POSES_HEADER_BYTES = 20
const POSE_BYTES = 12
const HEADING_TO_RADIANS = (2 * Math.PI) / 65_536

/** Carries a refusal out of nested readers; never leaves this module. */
class Refused extends Error {
  constructor(readonly reason: Refusal) {
    super(reason)
  }
}

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

function readPoses(view: DataView): PosesFrame {
  if (view.byteLength < POSES_HEADER_BYTES) throw new Refused('truncated')
  const count = view.getUint16(2, true)
  const expected = POSES_HEADER_BYTES + count * POSE_BYTES
  if (view.byteLength < expected) throw new Refused('truncated')
  if (view.byteLength > expected) throw new Refused('trailing-bytes')
  const x0 = finite(view.getFloat32(8, true))
  const y0 = finite(view.getFloat32(12, true))
  const unit = finite(view.getFloat32(16, true))
  // A unit of zero would put every robot on one spot.
  if (unit <= 0) throw new Refused('bad-shape')
  const frame: PosesFrame = {
    kind: 'poses',
    full: (view.getUint8(1) & 1) === 1,
    count,
    ms: view.getUint32(4, true),
    index: new Uint16Array(count),
    x: new Float32Array(count),
    y: new Float32Array(count),
    heading: new Float32Array(count),
    state: new Uint8Array(count),
    presence: new Uint8Array(count),
    range: new Int32Array(count),
    lowBattery: new Uint8Array(count),
  }
  for (let row = 0; row < count; row++) {
    const at = POSES_HEADER_BYTES + row * POSE_BYTES
    const state = view.getUint8(at + 8)
    const flags = view.getUint8(at + 9)
    const presence = flags & 0b11
    if (state >= STATES.length || presence >= PRESENCES.length) throw new Refused('bad-shape')
    frame.index[row] = view.getUint16(at, true)
    frame.x[row] = x0 + view.getUint16(at + 2, true) * unit
    frame.y[row] = y0 + view.getUint16(at + 4, true) * unit
    frame.heading[row] = view.getUint16(at + 6, true) * HEADING_TO_RADIANS
    frame.state[row] = state
    frame.presence[row] = presence
    frame.range[row] = flags & 0b100 ? view.getUint16(at + 10, true) : -1
    frame.lowBattery[row] = flags & 0b1000 ? 1 : 0
  }
  return frame
}

type Fields = Record<string, unknown>

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

function readArena(body: Fields): Arena {
  return {
    width: positive(body['width']),
    height: positive(body['height']),
    obstacles: array(body['obstacles']).map((item) => readObstacle(object(item))),
  }
}

function readObstacle(body: Fields): Obstacle {
  const x = number(body['x'])
  const y = number(body['y'])
  switch (body['shape']) {
    case 'circle':
      return { shape: 'circle', x, y, r: positive(body['r']) }
    case 'box':
      return {
        shape: 'box',
        x,
        y,
        w: positive(body['w']),
        h: positive(body['h']),
        theta: number(body['theta']),
      }
    default:
      throw new Refused('bad-shape')
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

function object(value: unknown): Fields {
  if (typeof value !== 'object' || value === null || Array.isArray(value)) {
    throw new Refused('bad-shape')
  }
  return value as Fields
}

function array(value: unknown): unknown[] {
  if (!Array.isArray(value)) throw new Refused('bad-shape')
  return value
}

function string(value: unknown): string {
  if (typeof value !== 'string') throw new Refused('bad-shape')
  return value
}

function number(value: unknown): number {
  if (typeof value !== 'number') throw new Refused('bad-shape')
  return finite(value)
}

function finite(value: number): number {
  if (!Number.isFinite(value)) throw new Refused('bad-shape')
  return value
}

function positive(value: unknown): number {
  const read = number(value)
  if (read <= 0) throw new Refused('bad-shape')
  return read
}

function slot(value: unknown): number {
  const read = number(value)
  if (!Number.isInteger(read) || read < 0 || read > 0xffff) throw new Refused('bad-shape')
  return read
}

function oneOf<const T extends readonly string[]>(allowed: T, value: unknown): T[number] {
  const found = allowed.find((item) => item === value)
  if (found === undefined) throw new Refused('bad-shape')
  return found
}
