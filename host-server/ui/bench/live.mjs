// A live server for measuring the page: a fleet of any size that never rests, told at a steady
// rate in frames made beforehand, so that the server costs next to nothing. Runs in a process of
// its own: `fork` it with {robots, rate}; it answers {url} and then, when asked, what it received.

import { readFile } from 'node:fs/promises'
import { createServer } from 'node:http'
import { extname, join, normalize } from 'node:path'
import { fileURLToPath } from 'node:url'
import { WebSocketServer } from 'ws'
import { jsonFrame, posesFrame } from '../tests/mock/encode.mjs'

const DIST = fileURLToPath(new URL('../dist/', import.meta.url))
const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css' }
const STATES = ['MOVING', 'MOVING', 'MOVING', 'MOVING', 'CAUTION', 'AVOIDING', 'SCANNING']
/** Seconds after which robots are where they began: each goes round in a circle. */
const ROUND_S = 8

const { robots: count, rate } = JSON.parse(process.argv[2])
const side = Math.max(4, Math.sqrt(2 * count))
const arena = { width: side * 1.25, height: side * 0.8, obstacles: [] }
const fleet = Array.from({ length: count }, (_, index) => ({
  index,
  id: `sim-${String(index + 1).padStart(5, '0')}`,
  x: (((index * 0.618034) % 1) - 0.5) * (arena.width - 2),
  y: (((index * 0.754878) % 1) - 0.5) * (arena.height - 2),
  r: 0.2 + (index % 7) / 20,
  phase: index * 2.4,
}))

function frame(step, full) {
  const turn = (2 * Math.PI * step) / (ROUND_S * rate)
  const robots = fleet.map(({ index, x, y, r, phase }) => ({
    index,
    x: x + r * Math.cos(turn + phase),
    y: y + r * Math.sin(turn + phase),
    heading: turn + phase + Math.PI / 2,
    state: STATES[Math.floor(index + step / (2 * rate)) % STATES.length],
    presence: 'online',
    rangeMm: 300 + ((index * 37 + step * 5) % 3_000),
    lowBattery: index % 50 === 0,
  }))
  const [x0, y0] = [-arena.width / 2 - 1, -arena.height / 2 - 1]
  const unit = (arena.width + 4) / 65_000
  return Buffer.from(posesFrame({ full, ms: 0, x0, y0, unit, robots }))
}

const frames = Array.from({ length: ROUND_S * rate }, (_, step) => frame(step, false))
const first = frame(0, true)
const received = []
let sent = { frames: 0, bytes: 0 }

const server = createServer(async (request, response) => {
  // The same clock as in the page, finer than a millisecond.
  const at = performance.timeOrigin + performance.now()
  const path = new URL(request.url, 'http://bench').pathname
  if (!path.startsWith('/api/')) {
    const file = normalize(join(DIST, path === '/' ? 'index.html' : path))
    const body = file.startsWith(DIST) ? await readFile(file).catch(() => null) : null
    response.writeHead(body === null ? 404 : 200, {
      'content-type': TYPES[extname(file)] ?? 'image/svg+xml',
    })
    return response.end(body)
  }
  let body = ''
  for await (const chunk of request) body += chunk
  response.setHeader('content-type', 'application/json')
  if (path === '/api/v1/session') {
    return response.end(JSON.stringify({ open: true, user: null, role: 'admin' }))
  }
  if (request.method === 'POST' && path.endsWith('/commands')) {
    received.push({ at, command: JSON.parse(body).command })
    response.statusCode = 202
    return response.end(JSON.stringify({ id: String(received.length) }))
  }
  if (path.startsWith('/api/v1/commands')) {
    return response.end(JSON.stringify({ status: 'completed', counts: { completed: 1 } }))
  }
  if (path === '/api/v1/robots') {
    const list = fleet.map(({ id }) => ({ id, battery: { percent: 70, mv: 7_600 } }))
    return response.end(JSON.stringify({ robots: list }))
  }
  response.statusCode = 404
  response.end('{}')
})

const sockets = new WebSocketServer({ server, path: '/api/v1/live' })
sockets.on('connection', (socket) => {
  const time = Date.now()
  socket.send(jsonFrame('hello', { protocol: 2, fleet: 'bench', time, arena }))
  const line = { kind: 'simulated', online: 'online', firmware: '0.1.0', board: 'sim' }
  const kinds = { 3: 'physical', 7: 'emulated' }
  const robots = fleet.map(({ index, id }) => ({
    ...line,
    index,
    id,
    kind: kinds[index % 100] ?? line.kind,
  }))
  socket.send(jsonFrame('roster', { robots, removed: [] }))
  socket.send(stamped(first))
})

function stamped(poses) {
  poses.writeUInt32LE(Date.now() % 2 ** 32, 4)
  return poses
}

let step = 0
setInterval(() => {
  const poses = stamped(frames[step++ % frames.length])
  for (const socket of sockets.clients) {
    socket.send(poses)
    sent = { frames: sent.frames + 1, bytes: sent.bytes + poses.length }
  }
}, 1_000 / rate)
setInterval(() => {
  const metrics = {
    robots: { online: count, stale: 0, offline: 0 },
    states: { MOVING: count },
    messages_per_s: count * 6,
    commands: { sent: received.length, answered: received.length },
    real_time_factor: 1,
  }
  for (const socket of sockets.clients) socket.send(jsonFrame('metrics', metrics))
}, 1_000)

process.on('message', () => process.send({ received: received.splice(0), sent }))
process.on('disconnect', () => process.exit(0))
server.listen(0, '127.0.0.1', () => {
  process.send({ url: `http://127.0.0.1:${server.address().port}`, robots: count })
})
