// Writes the frames of the live feed, for tests of the page that reads them.

const STATES = [
  'INITIALIZING',
  'IDLE',
  'MOVING',
  'SCANNING',
  'CAUTION',
  'AVOIDING',
  'UPDATING',
  'ERROR',
]
const PRESENCES = ['online', 'stale', 'offline']
const KINDS = { hello: 0, roster: 1, event: 3, metrics: 4 }

/** A JSON frame; `kind` is hello, roster, event or metrics. */
export function jsonFrame(kind, body) {
  const text = new TextEncoder().encode(JSON.stringify(body))
  const frame = new Uint8Array(1 + text.length)
  frame[0] = KINDS[kind]
  frame.set(text, 1)
  return frame.buffer
}

const HEADER = 20
const NO_RANGE = 0x3fff

/**
 * A frame of poses; robots carry index, x, y, heading, state, presence, rangeMm, lowBattery.
 * Indices are told as a bitmap where that is shorter and they ascend, or as `bitmap` says.
 */
export function posesFrame({ full = false, ms, x0 = 0, y0 = 0, unit = 0.001, robots, bitmap }) {
  const [first, last] = [robots[0]?.index ?? 0, robots.at(-1)?.index ?? 0]
  const length = Math.floor((last - first) / 8) + 1
  const ascending = robots.every(({ index }, row) => row === 0 || robots[row - 1].index < index)
  const bits = bitmap ?? (ascending && 4 + length < 2 * robots.length)
  const body = HEADER + (bits ? 4 + length : 2 * robots.length)
  const buffer = new ArrayBuffer(body + 8 * robots.length)
  const view = new DataView(buffer)
  view.setUint8(0, 2)
  view.setUint8(1, (full ? 1 : 0) | (bits ? 2 : 0))
  view.setUint16(2, robots.length, true)
  view.setUint32(4, ms % 2 ** 32, true)
  view.setFloat32(8, x0, true)
  view.setFloat32(12, y0, true)
  view.setFloat32(16, unit, true)
  if (bits) {
    view.setUint16(HEADER, first, true)
    view.setUint16(HEADER + 2, length, true)
  }
  for (let row = 0; row < robots.length; row++) {
    const robot = robots[row]
    if (bits) {
      const at = HEADER + 4 + ((robot.index - first) >> 3)
      view.setUint8(at, view.getUint8(at) | (1 << ((robot.index - first) & 7)))
    } else {
      view.setUint16(HEADER + 2 * row, robot.index, true)
    }
    const at = body + 8 * row
    const turn = (((robot.heading / (2 * Math.PI)) % 1) + 1) % 1
    const range = robot.rangeMm ?? null
    view.setUint16(at, Math.round((robot.x - x0) / unit), true)
    view.setUint16(at + 2, Math.round((robot.y - y0) / unit), true)
    view.setUint16(
      at + 4,
      (Math.round(turn * 4_096) & 0xfff) |
        (STATES.indexOf(robot.state) << 12) |
        (robot.lowBattery ? 1 << 15 : 0),
      true,
    )
    view.setUint16(
      at + 6,
      (range === null ? NO_RANGE : Math.min(range, NO_RANGE - 1)) |
        (PRESENCES.indexOf(robot.presence) << 14),
      true,
    )
  }
  return buffer
}
