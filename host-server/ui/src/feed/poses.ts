/** Frames of poses: which robots, then eight bytes for each of them. */

import { Refused, finite } from './fields'

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

/** Columns rather than objects: a full snapshot may hold 10,000 robots. */
export interface PosesFrame {
  kind: 'poses'
  full: boolean
  count: number
  /** Low 32 bits of the server's Unix milliseconds. */
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

const HEADER_BYTES = 20
const POSE_BYTES = 8
const FULL = 1
const BITMAP = 2
const HEADING_TO_RADIANS = (2 * Math.PI) / 4_096
const NO_RANGE = 0x3fff

export function readPoses(view: DataView): PosesFrame {
  if (view.byteLength < HEADER_BYTES) throw new Refused('truncated')
  const flags = view.getUint8(1)
  const count = view.getUint16(2, true)
  const x0 = finite(view.getFloat32(8, true))
  const y0 = finite(view.getFloat32(12, true))
  const unit = finite(view.getFloat32(16, true))
  // A unit of zero would put every robot on one spot.
  if (unit <= 0) throw new Refused('bad-shape')
  const index = new Uint16Array(count)
  const body = (flags & BITMAP) === 0 ? readList(view, index) : readBitmap(view, index)
  if (view.byteLength < body + count * POSE_BYTES) throw new Refused('truncated')
  if (view.byteLength > body + count * POSE_BYTES) throw new Refused('trailing-bytes')
  const frame: PosesFrame = {
    kind: 'poses',
    full: (flags & FULL) !== 0,
    count,
    ms: view.getUint32(4, true),
    index,
    x: new Float32Array(count),
    y: new Float32Array(count),
    heading: new Float32Array(count),
    state: new Uint8Array(count),
    presence: new Uint8Array(count),
    range: new Int32Array(count),
    lowBattery: new Uint8Array(count),
  }
  for (let row = 0; row < count; row++) {
    const at = body + row * POSE_BYTES
    const course = view.getUint16(at + 4, true)
    const reach = view.getUint16(at + 6, true)
    const presence = reach >> 14
    if (presence >= PRESENCES.length) throw new Refused('bad-shape')
    const range = reach & NO_RANGE
    frame.x[row] = x0 + view.getUint16(at, true) * unit
    frame.y[row] = y0 + view.getUint16(at + 2, true) * unit
    frame.heading[row] = (course & 0xfff) * HEADING_TO_RADIANS
    frame.state[row] = (course >> 12) & 7
    frame.presence[row] = presence
    frame.range[row] = range === NO_RANGE ? -1 : range
    frame.lowBattery[row] = course >> 15
  }
  return frame
}

/** Fills in the indices; the result is where the poses begin. */
function readList(view: DataView, index: Uint16Array): number {
  const end = HEADER_BYTES + 2 * index.length
  if (view.byteLength < end) throw new Refused('truncated')
  for (let row = 0; row < index.length; row++) {
    index[row] = view.getUint16(HEADER_BYTES + 2 * row, true)
  }
  return end
}

function readBitmap(view: DataView, index: Uint16Array): number {
  const start = HEADER_BYTES + 4
  if (view.byteLength < start) throw new Refused('truncated')
  const first = view.getUint16(HEADER_BYTES, true)
  const end = start + view.getUint16(HEADER_BYTES + 2, true)
  if (view.byteLength < end) throw new Refused('truncated')
  let row = 0
  for (let at = start; at < end; at++) {
    const byte = view.getUint8(at)
    for (let bit = 0; byte >> bit !== 0; bit++) {
      if (((byte >> bit) & 1) === 0) continue
      const slot = first + 8 * (at - start) + bit
      if (row >= index.length || slot > 0xffff) throw new Refused('bad-shape')
      index[row++] = slot
    }
  }
  if (row !== index.length) throw new Refused('bad-shape')
  return end
}
