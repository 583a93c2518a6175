// Rollouts of the mock: one that runs, one that has stopped by itself, one that is done.

import { Refusal } from './accounts.mjs'

const MINUTE_MS = 60_000

export function createRollouts({ clock, releases, robots }) {
  const now = clock()
  const planned = (release) => {
    const { id, board, build, version, sequence, size } = release
    return { release: id, board, build, version, sequence, bytes: size }
  }
  const phase = (share) => ({
    select: { share },
    soak_s: 600,
    success_percent: 95,
    min_count: 1,
    stop_percent: 5,
    stop_min_count: 1,
  })
  const plan = (release, more = {}) => ({
    releases: [planned(release)],
    phases: [phase(10), phase(100)],
    limits: { parallel: 50 },
    ...more,
  })
  const log = (began, ...whats) =>
    whats.map(([what, more = {}], place) => ({ at: began + place * MINUTE_MS, what, ...more }))

  function row(n, state, more = {}) {
    const name = robots[n % robots.length].id
    const received = { receiving: 250_000, confirmed: 608_100, rolled_back: 608_100 }[state] ?? 0
    return {
      robot: name,
      state,
      reason: null,
      release: releases[0].id,
      phase: n < 2 ? 1 : 2,
      attempts: 0,
      offers: 1,
      received,
      bytes: 608_100,
      since: now - (20 - n) * 7_000,
      ...more,
    }
  }

  const rollouts = [
    {
      id: '3',
      by: 'ada',
      made: now - 20 * MINUTE_MS,
      ended: null,
      server: 'a1',
      state: 'running',
      reason: null,
      phase: 2,
      plan: plan(releases[0], { window: { from: '22:00', to: '05:00', offset_minutes: 60 } }),
      log: log(
        now - 20 * MINUTE_MS,
        ['started'],
        ['phase_began', { phase: 1 }],
        ['phase_soaks', { phase: 1 }],
        ['phase_passed', { phase: 1 }],
        ['phase_began', { phase: 2 }],
      ),
      rows: [
        row(0, 'confirmed'),
        row(1, 'confirmed'),
        row(2, 'confirmed'),
        row(3, 'trial'),
        row(4, 'receiving'),
        row(5, 'receiving', { received: 610_000 / 2 }),
        row(6, 'deferred', { reason: { told: 'driving' } }),
        row(7, 'waiting'),
        row(8, 'waiting'),
        row(9, 'skipped', { reason: 'left_out' }),
      ],
    },
    {
      id: '2',
      by: 'ada',
      made: now - 300 * MINUTE_MS,
      ended: null,
      server: 'a1',
      state: 'paused',
      reason: 'failures',
      phase: 1,
      plan: plan(releases[2]),
      log: log(
        now - 300 * MINUTE_MS,
        ['started'],
        ['phase_began', { phase: 1 }],
        ['paused', { reason: 'failures' }],
      ),
      rows: [
        row(0, 'rolled_back', { reason: { told: 'panic' }, attempts: 1 }),
        row(1, 'rolled_back', { reason: { told: 'no_link' }, attempts: 1 }),
        row(2, 'failed', { reason: { timed_out: 'trial' }, attempts: 3 }),
        row(3, 'waiting'),
        row(4, 'waiting'),
      ],
    },
    {
      id: '1',
      by: 'eve',
      made: now - 3_000 * MINUTE_MS,
      ended: now - 2_900 * MINUTE_MS,
      server: 'a1',
      state: 'done',
      reason: null,
      phase: 2,
      plan: plan(releases[4]),
      log: log(now - 3_000 * MINUTE_MS, ['started'], ['done']),
      rows: robots.slice(0, 8).map((_, n) => row(n, 'confirmed')),
    },
  ]

  const tally = (rows) => {
    const counted = {}
    for (const { state } of rows) counted[state] = (counted[state] ?? 0) + 1
    return counted
  }

  function whole(rollout) {
    const { rows, ...shown } = rollout
    const elapsed = clock() - rollout.made
    const phases = rollout.plan.phases.map((_, at) => {
      const own = rows.filter((one) => one.phase === at + 1)
      const failures = own.filter(({ state }) => ['failed', 'rolled_back'].includes(state)).length
      const active = at + 1 === rollout.phase && rollout.state !== 'done'
      return {
        state: active
          ? { active: { since_ms: 0 } }
          : at + 1 < rollout.phase || rollout.state === 'done'
            ? { passed: { since_ms: 0, at_ms: 1_000 } }
            : 'pending',
        robots: tally(own),
        failures,
        most_failures: 2,
        ended_per_hour: active ? 90 : 0,
        left_s: active ? 160 : null,
      }
    })
    const counts = {
      state: rollout.state === 'paused' ? { paused: rollout.reason } : rollout.state,
      phase: rollout.phase - 1,
      phases,
      robots: { ...tally(rows), not_applicable: 2 },
      // As if robots got 400 kB a second.
      bytes: Math.round(rollout.state === 'running' ? elapsed * 400 : 1e6),
      elapsed_s: Math.round(elapsed / 1_000),
    }
    return { ...shown, counts }
  }

  function begin(body, by) {
    const asked = body.releases.map(({ release }) => releases.find(({ id }) => id === release))
    const expired = asked.find((release) => release.expires_at !== null && release.expires_at < now)
    if (asked.includes(undefined) || expired !== undefined || body.limits?.parallel === 13) {
      throw new Refusal(422, 'invalid_rollout', 'limits.parallel: robots do not like 13')
    }
    const rollout = {
      id: String(rollouts.length + 1),
      by,
      made: clock(),
      ended: null,
      server: 'a1',
      state: 'running',
      reason: null,
      phase: 1,
      plan: { ...body, releases: asked.map(planned) },
      log: [{ at: clock(), what: 'started' }],
      rows: robots.slice(0, 10).map((_, n) => row(n, n < 2 ? 'offered' : 'waiting')),
    }
    rollouts.unshift(rollout)
    return { status: 201, body: whole(rollout) }
  }

  const NEXT = { pause: 'paused', resume: 'running', abort: 'aborted' }

  function act(rollout, name) {
    rollout.state = NEXT[name]
    rollout.reason = name === 'pause' ? 'person' : null
    if (name === 'abort') rollout.ended = clock()
    rollout.log.push({
      at: clock(),
      what: { pause: 'paused', resume: 'resumed', abort: 'aborted' }[name],
      reason: rollout.reason,
    })
  }

  function steps({ state, reason, since }) {
    const way = ['offered', 'preparing', 'receiving', 'verifying', 'staged', 'trial']
    const before = way.includes(state) ? way.slice(0, way.indexOf(state)) : way
    const lines = before.map((one, n) => ({
      at: since - (before.length - n) * 9_000,
      state: one,
      reason: null,
    }))
    return [...lines, { at: since, state, reason }]
  }

  /** Status and body of an answer; `null` for what is about something else. */
  function answer(method, parts, url, body, by) {
    if (parts[0] !== 'rollouts') return null
    if (parts.length === 1) {
      if (method === 'POST') return begin(body, by)
      const shown = rollouts.map((one) => ({ ...one, rows: undefined, log: undefined }))
      return { status: 200, body: { rollouts: shown, next: null } }
    }
    const rollout = rollouts.find(({ id }) => id === parts[1])
    if (rollout === undefined) {
      throw new Refusal(404, 'unknown_rollout', 'there is no rollout of that id')
    }
    if (parts[2] !== 'robots') {
      if (method === 'POST') act(rollout, parts[2])
      return { status: 200, body: whole(rollout) }
    }
    if (parts.length === 3) {
      const state = url.searchParams.get('state')
      const found = rollout.rows.filter((one) => state === null || one.state === state)
      return { status: 200, body: { robots: found, next: null } }
    }
    const found = rollout.rows.find(({ robot }) => robot === parts[3])
    if (found === undefined) throw new Refusal(404, 'unknown_robot', 'there is no such robot in it')
    if (parts.length === 4) return { status: 200, body: { ...found, log: steps(found) } }
    Object.assign(found, {
      state: parts[4] === 'retry' ? 'waiting' : 'skipped',
      reason: parts[4] === 'retry' ? 'retried' : 'left_out',
      since: clock(),
    })
    return { status: 200, body: whole(rollout) }
  }

  return { answer, rollouts }
}
