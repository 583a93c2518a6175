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

/** A frame of poses; robots carry index, x, y, heading, state, presence, rangeMm, lowBattery. */
export function posesFrame({ full = false, ms, x0 = 0, y0 = 0, unit = 0.001, robots }) {
  const buffer = new ArrayBuffer(20 + 12 * robots.length)
  const view = new DataView(buffer)
  view.setUint8(0, 2)
  view.setUint8(1, full ? 1 : 0)
  view.setUint16(2, robots.length, true)
  view.setUint32(4, ms % 2 ** 32, true)
  view.setFloat32(8, x0, true)
  view.setFloat32(12, y0, true)
  view.setFloat32(16, unit, true)
  robots.forEach((robot, row) => {
    const at = 20 + 12 * row
    const turn = (((robot.heading / (2 * Math.PI)) % 1) + 1) % 1
    view.setUint16(at, robot.index, true)
    view.setUint16(at + 2, Math.round((robot.x - x0) / unit), true)
    view.setUint16(at + 4, Math.round((robot.y - y0) / unit), true)
    view.setUint16(at + 6, Math.floor(turn * 65_536), true)
    view.setUint8(at + 8, STATES.indexOf(robot.state))
    const range = robot.rangeMm ?? null
    view.setUint8(
      at + 9,
      PRESENCES.indexOf(robot.presence) | (range === null ? 0 : 4) | (robot.lowBattery ? 8 : 0),
    )
    view.setUint16(at + 10, range ?? 0, true)
  })
  return buffer
}
