// Experiments of the mock: trials are not run but drawn from their seeds, as fast as the mock is told.

import { Refusal } from './accounts.mjs'

const MOST_AT_ONCE = 4
const MOST_PAGE = 5_000
const METRICS = [
  ['success', 'share', 'more'],
  ['reached', 'share', 'more'],
  ['time_to_goal_s', 's', 'less'],
  ['energy_j', 'J', 'less'],
  ['collisions', 'contacts', 'less'],
  ['distance_m', 'm', 'neither'],
].map(([name, unit, better]) => ({ name, unit, better }))
/** Robots of the scenarios that are told of by the mock of the simulator. */
const ROBOTS = { 'simple-navigation': 1, 'dynamic-environment': 2, resilience: 4, search: 1 }
/** How likely a trial succeeds. */
const CHANCES = { 'simple-navigation': 0.96, 'dynamic-environment': 0.85, resilience: 0.6 }

/** Decisions of a world in a round of a training. */
const ROUND = 384
const FILES_SO_FAR = ['so-far.tcpo', 'curve.csv']
const FILES = ['policy.tcpo', 'policy', 'curve.csv', 'run.json']
/** SHA-256 of every policy of the mock. */
export const POLICY = 'ab'.repeat(32)

/** What nobody is told. */
const INSIDE = { sums: undefined, exact: undefined, looked: undefined }

/** A number from 0 to 1 that is always the same for the same seed (splitmix32). */
function drawn(seed, which) {
  let z = (seed * 16 + which + 0x9e3779b9) | 0
  z = Math.imul(z ^ (z >>> 16), 0x85ebca6b)
  z = Math.imul(z ^ (z >>> 13), 0xc2b2ae35)
  return ((z ^ (z >>> 16)) >>> 0) / 2 ** 32
}

export function createExperiments({ clock, perSecond = 12 }) {
  const all = []
  const settings = { perSecond, exists: true, listsScenarios: true }

  function trial(experiment, number) {
    const seed = experiment.first_seed + number
    const chance = CHANCES[experiment.scenario] ?? 0.9
    const success = drawn(seed, 0) < chance - 0.2 * Number(experiment.difficulty === 'hard')
    const time = 18 + 14 * drawn(seed, 1) + (success ? 0 : 20)
    return {
      number,
      seed,
      success,
      reason: success ? null : `reach: ${String(1 + (seed % 2))} of 3 goals within 120 s`,
      values: [
        Number(success),
        success ? 1 : (1 + (seed % 2)) / 3,
        // Nothing to be measured where no goal was reached.
        drawn(seed, 2) < 0.05 ? null : time,
        time * 2.4,
        Math.floor(3 * drawn(seed, 3)),
        6 + 2 * drawn(seed, 4),
      ],
    }
  }

  /** What a running one has done since it was last looked at. */
  function advance() {
    const now = clock()
    for (const one of all) {
      const passed = (now - one.looked) / 1_000
      one.looked = now
      if (one.state !== 'running') continue
      one.waiting =
        all.filter((other) => other.state === 'running' && !other.waiting).length > MOST_AT_ONCE
      one.exact = Math.min(one.seeds, one.exact + passed * settings.perSecond)
      one.done = Math.floor(one.exact)
      if (one.done === one.seeds) Object.assign(one, { state: 'completed', ended_at: now })
    }
  }

  function summary({ values, count }) {
    return METRICS.flatMap(({ name, unit }, at) => {
      const { sum, squares, number } = values[at]
      if (number === 0) return []
      const mean = sum / number
      const spread = Math.sqrt(Math.max(0, squares / number - mean * mean))
      const half = (1.96 * spread) / Math.sqrt(number) + 0.5 / (count + 2)
      const share = at < 2
      const low = share ? Math.max(0, mean - half) : mean - half
      const high = share ? Math.min(1, mean + half) : mean + half
      return [{ metric: name, unit, mean, low, high, count: number }]
    })
  }

  /** Takes the trials that are new into the sums. */
  function summed(one) {
    for (; one.sums.count < one.done; one.sums.count++) {
      trial(one, one.sums.count).values.forEach((value, at) => {
        if (value === null) return
        const into = one.sums.values[at]
        into.sum += value
        into.squares += value * value
        into.number += 1
      })
    }
    return summary(one.sums)
  }

  function judged(one, lines) {
    return one.thresholds.map((threshold) => {
      const [, metric, way, least] = /^(\w+)\s*([<>])=\s*(.*)$/.exec(threshold)
      const value = lines.find((line) => line.metric === metric)?.mean ?? null
      const enough = way === '>' ? value >= Number(least) : value <= Number(least)
      return { threshold, met: value !== null && enough, value }
    })
  }

  /** What a round of a training came to: it rises, and trembles. */
  function point(one, round) {
    const part = round / one.seeds
    const shaken = 0.04 * drawn(one.first_seed, round) - 0.02
    return {
      round,
      steps: round * ROUND * one.training.worlds,
      episodes: 12,
      reward: -8 + 15 * Math.sqrt(part) + 10 * shaken,
      success: round === 1 ? null : Math.min(1, 0.25 + 0.65 * Math.sqrt(part) + shaken),
      length_s: 38 - 22 * part,
      entropy: 1.94 - 1.2 * part,
      divergence: 0.008 + shaken / 10,
      clipped: 0.1 + shaken,
      critic: 0.4 - 0.3 * part,
      loss: -0.01 - shaken / 10,
      vetoes: 0.3 - 0.2 * part,
    }
  }

  function training(one) {
    const learns = one.state === 'running' && !one.waiting
    const over = one.state === 'completed'
    const round = ROUND * one.training.worlds
    const rate = learns ? 60_000 : null
    const success = 0.85 + 0.1 * drawn(one.first_seed, 1)
    const score = {
      episodes: 300,
      success,
      low: success - 0.04,
      high: success + 0.03,
      length_s: 15,
      floats: success + 0.01,
      bytes: 8_552,
      sha256: POLICY,
    }
    const names = over ? FILES : one.done > 0 ? FILES_SO_FAR : []
    return {
      ...one.training,
      algorithm: 'ppo',
      steps_per_second: rate,
      left_s: learns ? ((one.seeds - one.done) * round) / rate : null,
      judging: false,
      last: one.done > 0 ? point(one, one.done) : null,
      score: over ? score : null,
      files: names.map((name) => ({ name, bytes: 8_552 })),
    }
  }

  function curve(one, url) {
    const after = Number(url.searchParams.get('after') ?? 0)
    const limit = Number(url.searchParams.get('limit') ?? 1_000)
    const to = Math.min(one.done, after + limit)
    const points = Array.from({ length: Math.max(0, to - after) }, (_, at) =>
      point(one, after + 1 + at),
    )
    return { points, next: to < one.done ? to : null }
  }

  function viewOfTraining(one) {
    const told = training(one)
    const command = `terracrawler train --out trained --seed ${one.first_seed} --steps ${told.steps}`
    const lines =
      told.score === null
        ? []
        : [
            {
              metric: 'success',
              unit: 'share',
              mean: told.score.success,
              low: told.score.low,
              high: told.score.high,
              count: 300,
            },
          ]
    const build = '0.1.0 (0123456789ab-cdef01234567-89abcdef0123)'
    return {
      ...one,
      ...INSIDE,
      training: told,
      summary: lines,
      verdict: null,
      command,
      workers: [],
      build,
    }
  }

  function view(one) {
    if (one.kind === 'training') return viewOfTraining(one)
    const lines = summed(one)
    const verdict = one.state === 'completed' ? judged(one, lines) : null
    const from = `--seeds ${one.seeds} --seed ${one.first_seed}`
    const command = `terracrawler evaluate --scenario ${one.scenario} ${from}`
    const workers = one.state === 'running' && !one.waiting ? [{ name: 'mock', seeds: 4 }] : []
    const build = '0.1.0 (0123456789ab-cdef01234567)'
    return { ...one, ...INSIDE, summary: lines, verdict, command, workers, build }
  }

  function wrong(body) {
    const errors = []
    const say = (field, message) => errors.push({ field, message })
    if (body.kind === 'training') {
      if (body.seed === 13) errors.push({ pointer: '/seed', detail: 'is unlucky' })
      return errors
    }
    const known = Object.keys(ROBOTS)
    if (!known.includes(body.scenario)) {
      say('scenario', `\`${body.scenario}\` is none of ${known.join(', ')}`)
    }
    if (!(body.seeds >= 1 && body.seeds <= 100_000)) say('seeds', 'must be 1 to 100000')
    if (body.difficulty === 'impossible') say('difficulty', '"impossible" is none of easy, hard')
    for (const [at, pair] of (body.set ?? []).entries()) {
      if (!pair.startsWith('duration_s')) say(`set[${at}]`, `${pair}: no such key`)
    }
    for (const [at, threshold] of (body.thresholds ?? []).entries()) {
      const [metric] = threshold.split(/\s*[<>]=/)
      if (!METRICS.some(({ name }) => name === metric)) {
        say(`thresholds[${at}]`, `\`${metric}\` is not a metric`)
      }
    }
    return errors
  }

  /** Puts one in; tests do it, too. */
  function create(body, by = 'ada') {
    const now = clock()
    const start = body.start ?? true
    const isTraining = body.kind === 'training'
    const asked = {
      steps: body.steps ?? 4_000_000,
      worlds: body.worlds ?? 64,
      units: body.units ?? 64,
      own_critic: body.own_critic ?? false,
    }
    const one = {
      kind: isTraining ? 'training' : 'evaluation',
      training: isTraining ? asked : null,
      id: String(all.length + 1),
      name: body.name,
      scenario: isTraining ? 'spread' : body.scenario,
      robots: isTraining ? 3 : (body.robots ?? ROBOTS[body.scenario] ?? 1),
      seeds: isTraining ? Math.ceil(asked.steps / (ROUND * asked.worlds)) : body.seeds,
      first_seed: (isTraining ? body.seed : body.first_seed) ?? 1,
      difficulty: body.difficulty ?? null,
      randomisation: body.randomisation ?? (isTraining ? 'none' : null),
      set: body.set ?? [],
      thresholds: body.thresholds ?? [],
      by,
      created_at: now,
      started_at: start ? now : null,
      ended_at: null,
      state: start ? 'running' : 'created',
      waiting: false,
      reason: null,
      done: 0,
      exact: 0,
      looked: now,
      sums: { count: 0, values: METRICS.map(() => ({ sum: 0, squares: 0, number: 0 })) },
    }
    all.push(one)
    return one
  }

  function find(id) {
    const one = all.find((known) => known.id === id)
    if (one === undefined) throw new Refusal(404, 'unknown_experiment', `no experiment ${id}`)
    return one
  }

  const NEXT = {
    start: [['created'], 'running'],
    pause: [['running'], 'paused'],
    resume: [['paused'], 'running'],
    stop: [['created', 'running', 'paused'], 'stopped'],
  }

  function act(one, verb) {
    const [from, to] = NEXT[verb]
    if (!from.includes(one.state)) throw new Refusal(409, 'wrong_state', `it is ${one.state}`)
    one.state = to
    if (verb === 'start') one.started_at = clock()
    if (verb === 'stop') one.ended_at = clock()
    return { status: 200, body: view(one) }
  }

  function metrics(one, url) {
    const limit = Math.min(MOST_PAGE, Number(url.searchParams.get('limit') ?? 1_000))
    const from = Number(url.searchParams.get('after') ?? -1) + 1
    const to = Math.min(one.done, from + limit)
    const trials = Array.from({ length: Math.max(0, to - from) }, (_, at) => trial(one, from + at))
    return { metrics: METRICS, trials, next: to < one.done ? to - 1 : null }
  }

  function listed(url) {
    const before = url.searchParams.get('before')
    const limit = Number(url.searchParams.get('limit') ?? 50)
    const older = before === null ? all : all.filter(({ id }) => Number(id) < Number(before))
    const page = older.toReversed().slice(0, limit)
    return {
      experiments: page.map(view),
      next: page.length < older.length ? page.at(-1).id : null,
    }
  }

  /** What a call of these paths gives; `null` for paths of others. */
  function answer(method, parts, url, body, who) {
    const [first, id, what] = parts
    // As a server without a list; the simulator gives it.
    if (first === 'simulator' && id === 'scenarios' && !settings.listsScenarios) {
      throw new Refusal(404, 'not_found', 'nothing there')
    }
    if (first !== 'experiments' || !settings.exists) return null
    advance()
    if (id === undefined && method === 'GET') return { status: 200, body: listed(url) }
    if (id === undefined && method === 'POST') {
      const errors = wrong(body)
      if (errors.length > 0) {
        const title = 'Unprocessable content'
        const detail = 'the experiment cannot be run'
        return { status: 422, body: { title, detail, code: 'invalid_experiment', errors } }
      }
      return { status: 201, body: view(create(body, who)) }
    }
    const one = find(id)
    if (what === 'curve') return { status: 200, body: curve(one, url) }
    if (what === 'files') return { status: 200, body: { policy: parts[3] } }
    if (what === 'metrics') return { status: 200, body: metrics(one, url) }
    if (what in NEXT && method === 'POST') return act(one, what)
    if (what === undefined && method === 'GET') return { status: 200, body: view(one) }
    if (what === undefined && method === 'DELETE') {
      if (one.state === 'running') throw new Refusal(409, 'wrong_state', 'it is running')
      all.splice(all.indexOf(one), 1)
      return { status: 204, body: undefined }
    }
    return null
  }

  return { answer, create, find, settings }
}
