// Stand-in for the server in tests of the page: the live feed, the few HTTP
// calls the page makes, and the built page itself.

import { readFile } from 'node:fs/promises'
import { createServer } from 'node:http'
import { extname, join, normalize } from 'node:path'
import { fileURLToPath } from 'node:url'
import { WebSocketServer } from 'ws'
import { Refusal, createAccounts } from './accounts.mjs'
import { jsonFrame, posesFrame } from './encode.mjs'
import { createCounterfactuals } from './counterfactuals.mjs'
import { createExperiments } from './experiments.mjs'
import { createFences } from './fences.mjs'
import { createMaps } from './maps.mjs'
import { createFleet } from './fleet.mjs'
import { createRecord } from './record.mjs'
import { createReleases } from './releases.mjs'
import { createRollouts } from './rollouts.mjs'
import { createTwins } from './twins.mjs'
import { createWorld } from './world.mjs'

const DIST = fileURLToPath(new URL('../../dist/', import.meta.url))
const TYPES = {
  '.html': 'text/html; charset=utf-8',
  '.js': 'text/javascript',
  '.css': 'text/css',
  '.svg': 'image/svg+xml',
}
const STEP_MS = 20
const FEED_EVERY_MS = 100
const LARGEST_BODY = 4_096
/** As strict as a server may be: the page must work under it. */
const POLICY =
  "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; " +
  "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"

/** Starts a mock; resolves with its address and what tests may do to it. */
export async function startMock({ robots = 50, seed = 1, port = 0, ...options } = {}) {
  const accounts = createAccounts(options)
  const world = createWorld({ robots, seed })
  const commands = []
  const faults = []
  const counts = { sent: 0, answered: 0, frames: 0 }
  const shown = new Map()
  const started = Date.now()
  const clock = () => started + Math.round(performance.now() - origin)
  const origin = performance.now()
  const hello = () =>
    jsonFrame('hello', { protocol: 2, fleet: 'swarm', time: clock(), arena: world.arena })
  /** How many robots answer a command that takes them long. */
  const answering = { most: Number.POSITIVE_INFINITY }
  const fleet = createFleet({
    world,
    commands,
    clock,
    greet: () => broadcast(hello()),
    answering,
  })
  const experiments = createExperiments({ clock })
  const fences = createFences({ world, clock, crossed })
  const maps = createMaps({ find: (id) => fleet.find(id), clock })
  const twins = createTwins({ find: (id) => fleet.find(id), list: () => world.robots, clock })
  const releases = createReleases({ clock })
  const rollouts = createRollouts({ clock, releases: releases.releases, robots: world.robots })
  const record = createRecord({ world, clock, robots, seed })
  const counterfactuals = createCounterfactuals({ record, clock })
  const ready = { ready: true, broker: true, simulation: true }
  let refuse = false
  let down = false

  const server = createServer((request, response) => {
    handle(request, response).catch((error) => {
      if (error instanceof Refusal) {
        const { status, code, message, headers } = error
        return problem(response, status, 'Refused', message, code, headers)
      }
      problem(response, 500, 'Internal error', 'the mock failed')
    })
  })
  const sockets = new WebSocketServer({ noServer: true })
  server.on('upgrade', (request, socket, head) => {
    const url = new URL(request.url, 'http://mock')
    const admitted = accounts.admits(url.searchParams.get('ticket'))
    if (refuse || url.pathname !== '/api/v1/live' || !admitted) return socket.destroy()
    sockets.handleUpgrade(request, socket, head, greet)
  })

  function greet(socket) {
    socket.send(hello())
    socket.send(jsonFrame('roster', { robots: world.robots.map(entry), removed: [] }))
    socket.send(poses(world.robots, true))
  }

  function entry({ index, id, kind, presence, firmware, board, fence }) {
    const line = { index, id, kind, online: presence, firmware, board }
    return (fence ?? null) === null ? line : { ...line, fence }
  }

  function crossed(robot, fence, back) {
    broadcast(jsonFrame('roster', { robots: [entry(robot)], removed: [] }))
    if (fence === null) return
    if (!back && fence.action === 'stop') world.obey(robot, { command: 'stop' }, clock())
    const deeds = fence.kind === 'keep_in' ? ['left', 'came back into'] : ['entered', 'came out of']
    const text = `${deeds[Number(back)]} fence ${fence.name}`
    const level = back ? 'info' : 'warn'
    broadcast(jsonFrame('event', { time: clock(), level, robot: robot.id, text }))
  }

  function poses(list, full) {
    const [x0, y0] = [-world.arena.width / 2 - 1, -world.arena.height / 2 - 1]
    const unit = (Math.max(world.arena.width, world.arena.height) + 2) / 65_000
    return posesFrame({ full, ms: clock(), x0, y0, unit, robots: list })
  }

  function broadcast(frame) {
    for (const socket of sockets.clients) if (socket.readyState === 1) socket.send(frame)
  }

  function tell(level, robot, text) {
    const time = clock()
    record.note(level, robot, text, time)
    broadcast(jsonFrame('event', { time, level, robot, text }))
  }

  function feed() {
    fences.watch()
    const changed = world.robots.filter((robot) => {
      const now = `${robot.x.toFixed(4)} ${robot.y.toFixed(4)} ${robot.heading.toFixed(3)} ${robot.state} ${robot.presence} ${robot.rangeMm}`
      if (shown.get(robot.index) === now) return false
      shown.set(robot.index, now)
      return true
    })
    counts.frames += changed.length
    if (changed.length > 0) broadcast(poses(changed, false))
  }

  function report() {
    const present = { online: 0, stale: 0, offline: 0 }
    const states = {}
    for (const robot of world.robots) {
      present[robot.presence] += 1
      states[robot.state] = (states[robot.state] ?? 0) + 1
    }
    const { sent, answered } = counts
    broadcast(
      jsonFrame('metrics', {
        robots: present,
        states,
        messages_per_s: present.online * 6,
        commands: { sent, answered },
        real_time_factor: 1,
      }),
    )
  }

  async function handle(request, response) {
    const url = new URL(request.url, 'http://mock')
    const path = url.pathname
    if (down && (path.startsWith('/api/') || path === '/readyz')) return request.socket.destroy()
    if (path === '/readyz') return json(response, ready.broker ? 200 : 503, ready)
    if (path === '/metrics') return plain(response, fleet.metrics(counts))
    if (!path.startsWith('/api/')) return page(path, response)
    const parts = path.split('/').slice(3)
    const body = request.method === 'GET' ? {} : await read(request)
    const found = accounts.answer(request, url, parts, body)
    if (found !== null) return json(response, found.status, found.body, found.headers)
    const { name } = accounts.caller(request, request.method === 'GET' ? 'viewer' : 'operator')
    const tried = experiments.answer(request.method, parts, url, body, name)
    if (tried !== null) return json(response, tried.status, tried.body)
    const fenced = fences.answer(request.method, parts, body, name)
    if (fenced !== null) return json(response, fenced.status, fenced.body)
    const mapped = maps.answer(request.method, parts)
    if (mapped !== null) return json(response, mapped.status, mapped.body)
    const followed = twins.answer(request.method, parts, url, body, name)
    if (followed !== null) return json(response, followed.status, followed.body)
    const released = releases.answer(request.method, parts, body, name)
    if (released !== null) return json(response, released.status, released.body)
    const supposed = counterfactuals.answer(request.method, parts, body, name)
    if (supposed !== null) return json(response, supposed.status, supposed.body, supposed.headers)
    const rolled = rollouts.answer(request.method, parts, url, body, name)
    if (rolled !== null) return json(response, rolled.status, rolled.body)
    if (request.method === 'GET' && parts[2] === 'image') {
      response.writeHead(200, { 'content-type': 'image/svg+xml' })
      return response.end(fleet.picture)
    }
    const told =
      request.method === 'GET' ? (record.read(parts, url) ?? fleet.read(parts, url)) : null
    if (told !== null) return json(response, 200, told)
    if (request.method === 'GET' && parts[0] === 'robots') {
      if (parts.length === 1) return json(response, 200, { robots: world.robots.map(state) })
      const robot = world.robots.find(({ id }) => id === parts[1])
      if (robot === undefined) return problem(response, 404, 'Not found', `no robot ${parts[1]}`)
      return json(response, 200, state(robot))
    }
    if (request.method === 'PUT' && parts[2] === 'parameters') {
      const command = { command: 'set', parameters: body }
      return accept(response, ['robots', parts[1], 'commands'], command, name)
    }
    if (parts[2] === 'faults') {
      fleet.find(parts[1])
      faults.push({ robot: parts[1], method: request.method, ...body })
      return json(response, 202, undefined)
    }
    if (request.method === 'POST' && parts[0] === 'simulator') {
      return json(response, 200, fleet.simulate(body))
    }
    if (request.method === 'POST' && parts.at(-1) === 'commands') {
      return accept(response, parts, body, name)
    }
    return problem(response, 404, 'Not found', `nothing at ${path}`)
  }

  function accept(response, parts, command, who) {
    const all = parts[0] === 'swarm'
    const targets = all ? world.robots : world.robots.filter(({ id }) => id === parts[1])
    if (targets.length === 0) return problem(response, 404, 'Not found', `no robot ${parts[1]}`)
    const outcomes = []
    for (const { presence, id } of targets) {
      if (presence !== 'online' && all) continue
      const robot = fleet.find(id)
      const outcome = { robot: id }
      const done = (status, reason) => Object.assign(outcome, { status, reason })
      Object.assign(
        outcome,
        presence === 'offline'
          ? { status: 'expired', reason: null }
          : command.command === 'set'
            ? fleet.set(id, command.parameters)
            : world.obey(robot, command, clock(), done),
      )
      outcomes.push(outcome)
      counts.sent += 1
      counts.answered += 1
    }
    if (command.command !== 'drive') accounts.audit(who, command.command, parts.at(-2))
    const record = {
      ...command,
      id: String(commands.length),
      to: all ? 'swarm' : parts[1],
      source: `operator:${who}`,
      timestamp: clock(),
      slow: all && command.command === 'behave',
      outcomes,
    }
    commands.push(record)
    if (command.command !== 'drive') {
      const level = command.command === 'estop' ? 'warn' : 'info'
      tell(level, all ? null : parts[1], `command ${command.command} from ${who}`)
    }
    return json(response, 202, { ...fleet.view(record), ...(all ? { outcomes: [] } : {}) })
  }

  function state(robot) {
    return {
      id: robot.id,
      kind: robot.kind,
      presence: robot.presence,
      duplicate: false,
      state: robot.state,
      behaviour: robot.behaviour,
      battery: { mv: 6_400 + 20 * robot.battery, percent: robot.battery },
      temperature_c: 22.5,
      rssi_dbm: -58,
      fence: robot.fence ?? null,
      ...fleet.details(robot),
    }
  }

  const timers = [
    setInterval(() => world.step(STEP_MS / 1_000, clock()), STEP_MS),
    setInterval(feed, FEED_EVERY_MS),
    setInterval(report, 1_000),
  ]
  await new Promise((resolve, reject) => {
    server.once('error', reject)
    server.listen(port, '127.0.0.1', resolve)
  })
  return {
    url: `http://127.0.0.1:${server.address().port}`,
    world,
    commands,
    faults,
    answering,
    fences: fences.fences,
    maps,
    twins,
    accounts,
    counterfactuals,
    experiments,
    releases: releases.releases,
    rollouts: rollouts.rollouts,
    /** What `/readyz` says. */
    ready,
    /** Answers no call and keeps no feed, as a server that is being restarted. */
    setDown(now) {
      down = now
      this.setFeed(!now)
    },
    /** Cuts all feeds and refuses new ones, or lets them in again. */
    setFeed(open) {
      refuse = !open
      if (refuse) for (const socket of sockets.clients) socket.terminate()
    },
    broadcast,
    broadcastEvent: tell,
    record,
    sockets: () => sockets.clients,
    close() {
      for (const timer of timers) clearInterval(timer)
      record.close()
      for (const socket of sockets.clients) socket.terminate()
      server.closeAllConnections()
      return new Promise((resolve) => server.close(resolve))
    },
  }
}

async function page(path, response) {
  const file = normalize(join(DIST, path === '/' ? 'index.html' : path))
  const body = file.startsWith(DIST) ? await readFile(file).catch(() => null) : null
  if (body === null) return problem(response, 404, 'Not found', `no page ${path}`)
  response.writeHead(200, {
    'content-type': TYPES[extname(file)] ?? 'application/octet-stream',
    'content-security-policy': POLICY,
  })
  response.end(body)
}

async function read(request) {
  if (request.headers['content-type'] === 'application/octet-stream') {
    request.resume()
    return {}
  }
  let body = ''
  for await (const chunk of request) {
    body += chunk
    if (body.length > LARGEST_BODY) throw new Refusal(413, 'too_large', 'the body is too large')
  }
  try {
    return body === '' ? {} : JSON.parse(body)
  } catch {
    throw new Refusal(400, 'malformed', 'the body is not JSON')
  }
}

function json(response, status, body, headers = {}) {
  response.writeHead(status, { 'content-type': 'application/json', ...headers })
  response.end(body === undefined ? undefined : JSON.stringify(body))
}

function plain(response, text) {
  response.writeHead(200, { 'content-type': 'application/openmetrics-text; version=1.0.0' })
  response.end(text)
}

function problem(response, status, title, detail, code = 'refused', headers = {}) {
  response.writeHead(status, { 'content-type': 'application/problem+json', ...headers })
  response.end(JSON.stringify({ type: 'about:blank', title, status, detail, code }))
}
