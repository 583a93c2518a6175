// The record of the mock: ten minutes before it started, as if a server had run, and what
// happens from then on. In between is a gap, in which the server was away.

import { Refusal } from './accounts.mjs'
import { createWorld } from './world.mjs'
import { withExtremes } from './extremes.mjs'

const EVERY_MS = 200
const BEFORE_MS = 600_000
const AWAY_MS = 20_000
const STEP_MS = 100
/** Points of a robot that are kept. */
const MOST = 6_000
const MOST_POINTS = 600
const MOST_ALL = 600_000
const LEVELS = ['info', 'warn', 'error']
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
/** Robots that were silent, by number, in milliseconds before the mock started. */
const SILENT = [
  { index: 4, from: 300_000, to: 255_000 },
  { index: 9, from: 130_000, to: 118_000 },
  { index: 11, from: 90_000, to: 0 },
  { index: 12, from: 400_000, to: 0 },
]
const TROUBLES = [
  ['info', 'command behave from ada'],
  ['info', 'reached its goal'],
  ['warn', 'battery below 20 %'],
  ['info', 'command identify from ada'],
  ['warn', 'range sensor is noisy'],
  ['info', 'avoided an obstacle'],
  ['info', 'scan done'],
  ['error', 'wheel blocked: current limit reached'],
]

export function createRecord({ world, clock, robots, seed }) {
  const started = clock()
  const tracks = new Map()
  const arenas = [{ at: started, arena: copy(world.arena) }]
  const events = []
  let filled = false
  let empty = false
  let failing = null

  function point(robot, at, battery) {
    let track = tracks.get(robot.id)
    if (track === undefined) {
      track = { robot: robot.id, kind: robot.kind, points: [] }
      tracks.set(robot.id, track)
    }
    track.points.push({
      at,
      x: round(robot.x),
      y: round(robot.y),
      theta: round(Math.atan2(Math.sin(robot.heading), Math.cos(robot.heading))),
      state: robot.state,
      range_mm: robot.rangeMm,
      battery_percent: Math.min(100, battery),
    })
    if (track.points.length > MOST) track.points.splice(0, 1_000)
  }

  /** What happened before: made when somebody asks first, so that nobody else waits for it. */
  function fill() {
    if (filled) return
    filled = true
    const since = [...tracks.values()].map((track) => ({ ...track }))
    tracks.clear()
    const past = createWorld({ robots, seed })
    for (const robot of past.robots) robot.presence = 'online'
    const begin = started - BEFORE_MS
    arenas.unshift({ at: begin, arena: copy(past.arena) })
    for (let at = begin; at < started - AWAY_MS; at += STEP_MS) {
      past.step(STEP_MS / 1_000, at)
      if (at === begin + 360_000) change(past, at, [...past.arena.obstacles, free(past)])
      if (at === begin + 540_000) change(past, at, past.arena.obstacles.slice(0, -1))
      if ((at - begin) % EVERY_MS !== 0) continue
      for (const robot of past.robots) {
        const ago = started - at
        const silent = SILENT.some(({ index, from, to }) => {
          return index === robot.index && ago <= from && ago > to
        })
        if (!silent) point(robot, at, robot.battery + Math.round(ago / 120_000))
      }
    }
    for (const { robot, points } of since) tracks.get(robot)?.points.push(...points)
    const old = events.splice(0)
    for (let i = 0, at = begin + 1_500; at < started - AWAY_MS; i++, at += 1_700 + (i % 7) * 260) {
      const [level, text] = TROUBLES[(i * 5 + Math.floor(i / 8)) % TROUBLES.length]
      const rare = level !== 'info' && i % 3 !== 0
      const robot = past.robots[(i * 17) % past.robots.length].id
      note(rare ? 'info' : level, robot, rare ? 'all is well' : text, at)
    }
    note('error', null, 'Connection to the broker lost', started - AWAY_MS + 500)
    note('info', null, 'The server has started', started)
    for (const { time, level, robot, text } of old) note(level, robot, text, time)
    events.sort((a, b) => a.time - b.time)
  }

  function change(past, at, obstacles) {
    past.arena.obstacles.splice(0, past.arena.obstacles.length, ...obstacles)
    arenas.splice(-1, 0, { at, arena: copy(past.arena) })
    note('info', null, 'The arena was changed', at)
  }

  function note(level, robot, text, time = clock()) {
    events.push({ id: `e${events.length + 1}`, time, level, robot, text })
  }

  function frames(url) {
    const { from, to, step } = stretch(url, 300)
    const ids = url.searchParams.get('robots')?.split(',')
    const wanted = [...tracks.values()].filter(({ robot }) => ids?.includes(robot) ?? true)
    const points = (to - from) / step
    if (points > MOST_POINTS || points * wanted.length > MOST_ALL || step < 100) {
      throw new Refusal(400, 'too_much', `at most ${MOST_POINTS} points of a robot`)
    }
    const before = arenas.filter(({ at }) => at <= from).at(-1)
    return {
      from,
      to,
      step,
      arena: before?.arena ?? null,
      arenas: arenas.filter(({ at }) => at > from && at < to),
      states: STATES,
      robots: wanted.flatMap(({ robot, kind, points }) => {
        const all = condense(points, from, to, step)
        if (all.length === 0) return []
        const column = (name) => all.map((one) => one[name])
        return [
          {
            robot,
            kind,
            at: column('at'),
            x: column('x'),
            y: column('y'),
            theta: column('theta'),
            state: all.map(({ state }) => STATES.indexOf(state)),
            range_mm: column('range_mm'),
            battery_percent: column('battery_percent'),
          },
        ]
      }),
    }
  }

  function telemetry(robot, url) {
    const { from, to, step } = stretch(url, 360)
    const points = condense(tracks.get(robot)?.points ?? [], from, to, step).map((one) =>
      withExtremes({
        ...one,
        count: Math.max(1, Math.round(step / EVERY_MS)),
        battery_mv: 6_400 + 20 * one.battery_percent,
        rssi_dbm: Math.round(-58 + 6 * Math.sin(one.at / 11_000)),
        left: one.state === 'AVOIDING' ? -0.3 : one.state === 'MOVING' ? 0.5 : 0,
        right: one.state === 'AVOIDING' ? 0.3 : one.state === 'MOVING' ? 0.48 : 0,
      }),
    )
    return { robot, from, to, step, points }
  }

  function listed(url) {
    const { from, to } = stretch(url, 1)
    const of = (name) => url.searchParams.get(name)
    const least = LEVELS.indexOf(of('level') ?? 'info')
    const limit = Number(of('limit') ?? 200)
    if (least < 0 || !(limit >= 1 && limit <= 1_000)) {
      throw new Refusal(400, 'bad_query', 'no such events')
    }
    const before = of('before') === null ? Number.POSITIVE_INFINITY : Number(of('before'))
    const fits = events
      .map((event, place) => ({ ...event, place }))
      .filter(({ time, level, robot, place }) => {
        return (
          time >= from &&
          time <= to &&
          place < before &&
          LEVELS.indexOf(level) >= least &&
          (of('robot') === null || of('robot') === robot)
        )
      })
      .reverse()
    const shown = fits.slice(0, limit)
    const next = fits.length > limit ? String(shown.at(-1).place) : null
    return {
      events: shown.map(({ id, time, level, robot, text }) => ({ id, time, level, robot, text })),
      next,
    }
  }

  const timer = setInterval(() => {
    const at = Math.floor(clock() / EVERY_MS) * EVERY_MS
    for (const robot of world.robots) {
      if (robot.presence === 'online') point(robot, at, robot.battery)
    }
  }, EVERY_MS)

  return {
    note,
    close: () => clearInterval(timer),
    /** Nothing was ever recorded, or it is so again. */
    setEmpty(now) {
      empty = now
    },
    /** The next answers are this status, until it is `null`. */
    setFailing(status) {
      failing = status
    },
    /** What a GET of this path gives; `null` for paths of others. */
    read(parts, url) {
      const path = parts.join('/')
      const mine = ['history', 'history/frames', 'events'].includes(path)
      const own = parts[0] === 'robots' && parts[2] === 'telemetry'
      if (!mine && !(own && tracks.has(parts[1]))) return null
      fill()
      if (path === 'history') {
        if (empty) return { from: null, to: null, robots: 0 }
        const ends = [...tracks.values()].map(({ points }) => points.at(-1).at)
        return { from: started - BEFORE_MS, to: Math.max(...ends), robots: tracks.size }
      }
      if (failing !== null) {
        // Whoever reads it again before that was told to by somebody.
        throw new Refusal(failing, 'internal', 'the record is broken', { 'retry-after': '3600' })
      }
      if (path === 'history/frames') return frames(url)
      return path === 'events' ? listed(url) : telemetry(parts[1], url)
    },
  }
}

function stretch(url, points) {
  const [from, to] = ['from', 'to'].map((name) => Number(url.searchParams.get(name)))
  if (!(from >= 0 && to > from)) throw new Refusal(400, 'bad_query', 'no such stretch')
  const step = Number(url.searchParams.get('step') ?? Math.ceil((to - from) / points))
  if (!(step > 0)) throw new Refusal(400, 'bad_query', 'no such step')
  return { from, to, step }
}

/** One point for each step: the mean of places, the last of everything else. */
function condense(points, from, to, step) {
  const found = []
  let low = 0
  let high = points.length
  while (low < high) {
    const middle = (low + high) >> 1
    if (points[middle].at < from) low = middle + 1
    else high = middle
  }
  for (let i = low; i < points.length && points[i].at < to;) {
    const at = Math.floor(points[i].at / step) * step
    let [x, y, count] = [0, 0, 0]
    for (; i < points.length && points[i].at < Math.min(to, at + step); i++, count++) {
      x += points[i].x
      y += points[i].y
    }
    found.push({ ...points[i - 1], at, x: round(x / count), y: round(y / count) })
  }
  return found
}

/** A place for an obstacle, away from all robots. */
function free(world) {
  const { width, height } = world.arena
  for (let i = 0; ; i++) {
    const x = (((i * 0.618) % 1) - 0.5) * (width - 2)
    const y = (((i * 0.414) % 1) - 0.5) * (height - 2)
    const near = world.robots.some((robot) => Math.hypot(robot.x - x, robot.y - y) < 0.6)
    if (!near || i > 500) return { shape: 'circle', x: round(x), y: round(y), r: 0.4 }
  }
}

function copy(arena) {
  return JSON.parse(JSON.stringify(arena))
}

function round(value) {
  return Math.round(value * 1_000) / 1_000
}
