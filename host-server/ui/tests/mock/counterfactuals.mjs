// Counterfactuals of the mock: the record it has is what was, a little off, and what robots are told instead is drawn
// as straight ways. Every look at one that runs brings it further.

import { Refusal } from './accounts.mjs'

const MOST = 16
const STEP_MS = 250
/** The record is looked at this far before the moment, and at this distance between points. */
const BEFORE_MS = 2_000
const RECORD_STEP_MS = 200
const SPEED = 0.25
const NEAR = 0.05
/** One in so many robots was not where the simulation has it. */
const ASTRAY = 12
const LOOKS = 4

export function createCounterfactuals({ record, clock }) {
  const all = []
  let made = 0
  const hand = { held: false, fails: null, astray: ASTRAY }

  function check({ at, seconds, draws, robots = null, command }) {
    const whole = (value, low, high) => Number.isInteger(value) && value >= low && value <= high
    const bad = (why) => new Refusal(422, 'invalid_counterfactual', why)
    if (!whole(at, 0, Number.MAX_SAFE_INTEGER)) throw bad('`at` is no time')
    if (!whole(seconds, 1, 60)) throw bad('`seconds` must be from 1 to 60')
    if (!whole(draws, 2, 200)) throw bad('`draws` must be from 2 to 200')
    if (typeof command?.command !== 'string') throw bad('`command` is none')
    const known = framesAt(record, at, seconds).map(({ robot }) => robot)
    if (known.length === 0) throw new Refusal(404, 'not_recorded', 'nothing was recorded then')
    for (const robot of robots ?? []) {
      if (!known.includes(robot)) throw new Refusal(404, 'not_recorded', `nothing of ${robot}`)
    }
    return { at, seconds, draws, robots, command }
  }

  function find(id) {
    const found = all.find((one) => one.id === id)
    if (found === undefined) throw new Refusal(404, 'unknown_counterfactual', `there is no ${id}`)
    return found
  }

  function advance(one) {
    if (one.state !== 'running' || hand.held) return
    one.done = Math.min(one.draws, one.done + Math.ceil(one.draws / LOOKS))
    if (hand.fails !== null && one.done > one.draws / 2) {
      Object.assign(one, { state: 'failed', detail: hand.fails })
    } else if (one.done === one.draws) {
      Object.assign(one, { state: 'done', answer: work(record, one, hand.astray) })
    }
  }

  /** Status and body of an answer; `null` for what is about something else. */
  function answer(method, parts, body, by) {
    const [first, id] = parts
    if (first !== 'counterfactuals') return null
    if (method === 'POST') {
      const wanted = check(body)
      if (all.some(({ state }) => state === 'running')) {
        throw new Refusal(503, 'busy', 'another one is being worked out')
      }
      made += 1
      const so = { id: `c${made}`, asked: clock(), by, state: 'running', detail: null, done: 0 }
      const one = { ...so, ...wanted, answer: null }
      all.unshift(one)
      all.splice(MOST)
      const headers = { location: `/api/v1/counterfactuals/${one.id}` }
      return { status: 202, body: one, headers }
    }
    if (id === undefined) {
      const counterfactuals = all.map((one) => ({ ...one, answer: null }))
      return { status: 200, body: { counterfactuals } }
    }
    const one = find(id)
    if (method === 'DELETE') {
      all.splice(all.indexOf(one), 1)
      return { status: 204 }
    }
    advance(one)
    return { status: 200, body: one }
  }

  return { answer, all, hand }
}

/** What is recorded from a moment on, of robots that were there at the moment. */
function framesAt(record, at, seconds) {
  const query = `from=${Math.max(0, at - BEFORE_MS)}&to=${at + seconds * 1_000}&step=${RECORD_STEP_MS}`
  const url = new URL(`http://mock/?${query}`)
  const { robots, states, arena } = record.read(['history', 'frames'], url)
  const seen = robots.filter((track) => track.at[0] <= at)
  return Object.assign(seen, { states, arena })
}

function work(record, { at, seconds, robots: asked, command }, astray) {
  const frames = framesAt(record, at, seconds)
  const points = (seconds * 1_000) / STEP_MS + 1
  const times = Array.from({ length: points }, (_, place) => (place * STEP_MS) / 1_000)
  const idle = frames.states.indexOf('IDLE')
  const moving = frames.states.indexOf('MOVING')
  const robots = frames.map((track, number) => {
    const recorded = times.map((t) => pointAt(track, at + 1_000 * t))
    const is = (asked ?? [track.robot]).includes(track.robot)
    const off = number % astray === astray - 1 ? 0.08 : 0.004
    let last = recorded[0] ?? { x: track.x[0], y: track.y[0], theta: track.theta[0] }
    const was = recorded.map((point, place) => {
      if (point !== null) last = point
      const far = off * times[place]
      const away = { x: last.x + far * Math.cos(number), y: last.y + far * Math.sin(number) }
      return { ...last, ...away, state: moving }
    })
    const told = was.map((_, place) => obeyed(was[0], command, times[place], { idle, moving }))
    const would = is ? told : was
    const distances = would.map(({ x, y }, place) => Math.hypot(x - was[place].x, y - was[place].y))
    const parted = distances.findIndex((distance) => distance > NEAR)
    const within = times.map((t) => round(0.01 + 0.012 * t))
    const ends = recorded.at(-1)
    return {
      robot: track.robot,
      kind: track.kind,
      body: ['certificate', 'record', 'make'][number % 3],
      certificate: number % 3 === 0 ? '0123456789abcdef' : null,
      command: number % 5 === 4 ? null : 'wander',
      supposed: number % 5 === 3,
      recorded: columns(recorded, ['x', 'y', 'theta']),
      was: { ...columns(was, ['x', 'y', 'theta', 'state']), within },
      would: { ...columns(would, ['x', 'y', 'theta', 'state']), within },
      inside: ends === null ? null : off * seconds <= within.at(-1),
      parted_s: parted < 0 ? null : times[parted],
      apart: round(distances.at(-1)),
      contacts: is ? [0.4, 0.1] : [0.1, 0.1],
    }
  })
  const compared = robots.filter(({ inside }) => inside !== null)
  return {
    step: STEP_MS,
    states: frames.states,
    arena: frames.arena,
    null_test: { robots: compared.length, inside: compared.filter(({ inside }) => inside).length },
    measures: measuresOf(robots),
    robots,
  }
}

/** Where a robot is so many seconds after it was told something, by the simplest of bodies. */
function obeyed({ x, y, theta }, { command, parameters = {} }, t, { idle, moving }) {
  if (command === 'stop') return { x, y, theta, state: idle }
  const way = SPEED * t
  if (command === 'goto') {
    const [dx, dy] = [parameters.x - x, parameters.y - y]
    const far = Math.hypot(dx, dy)
    const share = far === 0 ? 0 : Math.min(1, way / far)
    const state = share === 1 ? idle : moving
    return { x: x + share * dx, y: y + share * dy, theta: Math.atan2(dy, dx), state }
  }
  const turned = theta + 0.15 * t
  return {
    x: x + way * Math.cos(turned),
    y: y + way * Math.sin(turned),
    theta: turned,
    state: moving,
  }
}

function measuresOf(robots) {
  const mean = (of) => robots.reduce((sum, robot) => sum + of(robot), 0) / robots.length
  const way = ({ x, y }) =>
    x.reduce(
      (sum, _, at) => (at === 0 ? 0 : sum + Math.hypot(x[at] - x[at - 1], y[at] - y[at - 1])),
      0,
    )
  const row = (name, unit, was, would, sure) => {
    const middle = round(would - was)
    const difference = { mean: middle, low: round(middle - sure), high: round(middle + sure) }
    return { name, unit, was: round(was), would: round(would), difference }
  }
  return [
    row(
      'contacts',
      '',
      mean(({ contacts }) => contacts[0]),
      mean(({ contacts }) => contacts[1]),
      0.3,
    ),
    row(
      'way_m',
      'm',
      mean(({ was }) => way(was)),
      mean(({ would }) => way(would)),
      0.01,
    ),
    row('nearest_m', 'm', 0.31, 0.33, 0.06),
  ]
}

/** `null` where nothing was recorded near this time. */
function pointAt(track, time) {
  const before = track.at.findLastIndex((at) => at <= time)
  if (before < 0 || time - track.at[before] > 1_000) return null
  const [x, y, theta] = ['x', 'y', 'theta'].map((name) => track[name][before])
  return { x, y, theta }
}

function columns(points, names) {
  return Object.fromEntries(
    names.map((name) => [
      name,
      points.map((point) => (point === null ? null : round(point[name]))),
    ]),
  )
}

function round(value) {
  return Math.round(value * 1_000) / 1_000
}
