import { describe, expect, it } from 'vitest'
import type {
  Release,
  RobotBody,
  Rollout,
  RolloutCounts,
  RolloutPhaseCounts,
} from '../../src/api-types'
import { rolloutsApi } from '../../src/pages/updates/rollouts-api'
import { because, codeOf, one, phaseOf, titleOf, wrongWords } from '../../src/strings-rollouts'
import { boardsOf, quoted, signCommand, wayBack } from '../../src/updates/back'
import { choose, countBuilds, releaseOf, runningOf } from '../../src/updates/builds'
import type { Draft } from '../../src/updates/plan'
import {
  backPlan,
  bodyOf,
  check,
  firstWrong,
  names,
  newPhase,
  offsetMinutes,
  seconds,
  usual,
} from '../../src/updates/plan'
import {
  GROUPS,
  Meter,
  UPDATE_STATES,
  acts,
  byGroup,
  ended,
  failuresBy,
  groupOf,
  isActive,
  isOver,
  members,
  phaseName,
  reasonOf,
  robotActs,
  selection,
  soakLeft,
  timeLeft,
} from '../../src/updates/rollouts'

type Robots = Record<string, number>

function phase(robots: Robots, more: Partial<RolloutPhaseCounts> = {}): RolloutPhaseCounts {
  return {
    state: { active: { since_ms: 0 } },
    robots,
    failures: 0,
    most_failures: 2,
    ended_per_hour: 0,
    left_s: null,
    ...more,
  }
}

function rollout(phases: RolloutPhaseCounts[], more: Partial<Rollout> = {}): Rollout {
  const counts: RolloutCounts = {
    state: 'running',
    phase: 0,
    phases,
    robots: {},
    bytes: 0,
    elapsed_s: 100,
  }
  return {
    id: '1',
    by: 'ada',
    made: 0,
    server: 'a',
    state: 'running',
    phase: 1,
    plan: {
      releases: [],
      phases: phases.map(() => ({ select: { share: 100 }, soak_s: 60 })),
    },
    counts,
    ...more,
  }
}

describe('robots by state', () => {
  it('each have one group, and those that it is not for have none', () => {
    for (const state of UPDATE_STATES) {
      const group = groupOf(state)
      expect(group === null).toBe(state === 'not_applicable')
      if (group !== null) expect(GROUPS).toContain(group)
    }
    expect(groupOf('pondering')).toBeNull()
  })

  it('are summed', () => {
    const robots = { waiting: 2, deferred: 1, receiving: 4, trial: 1, confirmed: 5, failed: 1 }
    const more = { ...robots, rolled_back: 2, superseded: 1, not_applicable: 9, pondering: 7 }
    expect(byGroup(more)).toEqual({
      waiting: 3,
      working: 4,
      trial: 1,
      confirmed: 5,
      failed: 3,
      left: 1,
    })
    expect(members(more)).toBe(17)
    expect(ended(more)).toBe(8)
  })
})

describe('what can be done', () => {
  it('follows the state of the rollout', () => {
    const of = (state: string) => acts({ state })
    expect(of('running')).toEqual(['pause', 'abort'])
    expect(of('paused')).toEqual(['resume', 'abort'])
    for (const state of ['aborting', 'aborted', 'done', 'pondering']) expect(of(state)).toEqual([])
    expect(['done', 'aborted'].every((state) => isOver({ state }))).toBe(true)
    expect(['running', 'aborting'].every((state) => isActive({ state }))).toBe(true)
    expect(isActive({ state: 'paused' }) || isOver({ state: 'paused' })).toBe(false)
  })

  it('follows the state of the robot', () => {
    const may = (state: (typeof UPDATE_STATES)[number], of = 'running') =>
      robotActs({ state: of }, { state })
    for (const state of ['failed', 'rolled_back', 'skipped'] as const) {
      expect(may(state)).toEqual(['retry'])
      expect(may(state, 'aborting')).toEqual([])
      expect(may(state, 'done')).toEqual([])
    }
    for (const state of ['waiting', 'deferred', 'offered', 'receiving', 'staged'] as const) {
      expect(may(state, 'paused')).toEqual(['skip'])
    }
    for (const state of ['trial', 'confirmed', 'superseded', 'not_applicable'] as const) {
      expect(may(state)).toEqual([])
    }
  })
})

describe('a phase', () => {
  it('has a name for where it stands', () => {
    expect(phaseName({ state: 'pending' })).toBe('pending')
    expect(phaseName({ state: { active: { since_ms: 1 } } })).toBe('active')
    expect(phaseName({ state: { soaking: { since_ms: 1, until_ms: 2 } } })).toBe('soaking')
    expect(phaseName({ state: { passed: { since_ms: 1, at_ms: 2 } } })).toBe('passed')
  })

  it('is watched until its time is over', () => {
    const soaking = phase({}, { state: { soaking: { since_ms: 0, until_ms: 130_000 } } })
    const counts = rollout([soaking]).counts as RolloutCounts
    expect(soakLeft(soaking, counts)).toBe(30)
    expect(soakLeft(soaking, { ...counts, elapsed_s: 500 })).toBe(0)
    expect(soakLeft(phase({}), counts)).toBeNull()
  })

  it('selects robots in one of four ways', () => {
    expect(selection({ select: { share: 5 } })).toEqual({ by: 'share', percent: 5 })
    expect(phaseOf({ select: { share: 5 } })).toBe('5 % of the robots')
    expect(phaseOf({ select: { group: ['a', 'b', 'c'] } })).toBe('a, b, c')
    expect(phaseOf({ select: { group: ['a', 'b', 'c', 'd'] } })).toBe('a, b and 2 more')
    expect(phaseOf({ select: { board: 'virt' } })).toBe('robots on virt')
    expect(phaseOf({ select: { kind: 'emulated' } })).toBe('emulated robots')
  })
})

describe('the time that is left', () => {
  it('is what the phase takes, and the later ones at its pace, and every soak', () => {
    const now = phase({ receiving: 2, confirmed: 2 }, { ended_per_hour: 120, left_s: 60 })
    const later = phase({ waiting: 20 }, { state: 'pending' })
    expect(timeLeft(rollout([now]))).toEqual({ seconds: 120 })
    expect(timeLeft(rollout([now, later]))).toEqual({ seconds: 120 + 600 + 60 })
  })

  it('counts what is left of a soak', () => {
    const soaking = phase(
      { confirmed: 2 },
      { state: { soaking: { since_ms: 0, until_ms: 130_000 } }, ended_per_hour: 360 },
    )
    const later = phase({ waiting: 10 }, { state: 'pending' })
    expect(timeLeft(rollout([soaking, later]))).toEqual({ seconds: 30 + 100 + 60 })
    expect(timeLeft(rollout([soaking]))).toEqual({ seconds: 30 })
  })

  it('goes by the pace of an earlier phase where this one has none yet', () => {
    const first = phase(
      { confirmed: 2 },
      { state: { passed: { since_ms: 0, at_ms: 1 } }, ended_per_hour: 60 },
    )
    const second = phase({ confirmed: 1 })
    const third = phase({ waiting: 2 }, { state: 'pending' })
    const at = rollout([first, second, third], { phase: 2 })
    expect(timeLeft(at)).toEqual({ seconds: 60 + 120 + 60 })
  })

  it('is unknown where nothing was measured, and says why', () => {
    const why = (...of: Parameters<typeof rollout>) => timeLeft(rollout(...of))
    expect(why([phase({ receiving: 1 })])).toEqual({ unknown: 'nobody-done' })
    expect(why([phase({ waiting: 1 })])).toEqual({ unknown: 'nobody-done' })
    expect(why([phase({ waiting: 1, confirmed: 3 })])).toEqual({ unknown: 'away' })
    expect(why([phase({})], { state: 'paused' })).toEqual({ unknown: 'stands' })
    expect(why([phase({})], { counts: null })).toEqual({ unknown: 'no-counts' })
    expect(why([phase({})], { phase: 9 })).toEqual({ unknown: 'no-counts' })
    const later = phase({ waiting: 2 }, { state: 'pending' })
    expect(why([phase({ confirmed: 1 }), later])).toEqual({ unknown: 'nobody-done' })
    for (const unknown of ['stands', 'nobody-done', 'away', 'no-counts'] as const) {
      expect(one.notKnown(unknown)).toMatch(/^unknown/)
    }
  })
})

describe('the rate', () => {
  it('is measured over the last answers', () => {
    const meter = new Meter()
    expect(meter.rate()).toBeNull()
    meter.add({ at: 0, bytes: 1_000 })
    meter.add({ at: 1_000, bytes: 2_000 })
    expect(meter.rate()).toBeNull()
    meter.add({ at: 2_000, bytes: 5_000 })
    expect(meter.rate()).toBe(2_000)
    // An answer that was overtaken.
    meter.add({ at: 1_500, bytes: 9_000 })
    expect(meter.rate()).toBe(2_000)
    for (let at = 3_000; at <= 60_000; at += 1_000) meter.add({ at, bytes: 5_000 })
    expect(meter.rate()).toBe(0)
    meter.clear()
    expect(meter.rate()).toBeNull()
  })

  it('is never below nothing: a robot that begins anew has less', () => {
    const meter = new Meter()
    meter.add({ at: 0, bytes: 9_000 })
    meter.add({ at: 2_000, bytes: 1_000 })
    meter.add({ at: 4_000, bytes: 5_000 })
    expect(meter.rate()).toBe(1_000)
  })

  it('is told in units that fit', () => {
    expect(one.perSecond(0)).toBe('0 B/s')
    expect(one.perSecond(900 * 1_024)).toBe('900 KiB/s')
    expect(one.perSecond(20 * 1_048_576)).toBe('20.0 MiB/s')
    expect(one.perMinute(90)).toBe('1.5 per min')
    expect(one.perMinute(60_000)).toBe('1,000 per min')
  })
})

describe('reasons', () => {
  it('have a word, and what was told with it', () => {
    expect(reasonOf(null)).toBeNull()
    expect(reasonOf('left_out')).toEqual({ word: 'left_out', told: null })
    expect(reasonOf({ told: 'panic' })).toEqual({ word: 'told', told: 'panic' })
    expect(because(undefined)).toBe('')
    expect(because('interrupted')).toBe('it went offline on the way')
    expect(because({ told: 'panic' })).toBe('the new program panicked')
    expect(because('no_vision')).toContain('it does not see')
    expect(because('no_policies')).toContain('no room')
    expect(because({ told: 'gremlins' })).toBe('it says gremlins')
    expect(because({ timed_out: 'trial' })).toBe('it took too long while on trial')
    expect(because({ wrong_build: 'b7' })).toContain('b7')
    expect(codeOf({ told: 'panic' })).toBe('panic')
    expect(codeOf('old_build')).toBe('old_build')
    expect(codeOf(null)).toBeNull()
  })

  it('are counted, the most frequent first', () => {
    const panic = { told: 'panic' }
    const found = failuresBy([
      { state: 'failed', reason: { timed_out: 'offered' } },
      { state: 'rolled_back', reason: panic },
      { state: 'rolled_back', reason: panic },
      { state: 'failed' },
    ])
    expect(found.map(({ count, reason }) => [count, reason])).toEqual([
      [2, panic],
      [1, { timed_out: 'offered' }],
      [1, null],
    ])
  })
})

describe('a plan', () => {
  const offered = [
    { id: 'a', board: 'virt' },
    { id: 'b', board: 'virt' },
    { id: 'c', board: 'sim' },
  ]
  const wrongs = (change: Partial<Draft>) => check({ ...usual(['a']), ...change }, offered)

  it('is right as it stands when a release is chosen', () => {
    expect(check(usual(['a']), offered)).toEqual({})
    expect(check(usual(['a', 'c']), offered)).toEqual({})
    expect(check(usual(), offered)).toEqual({ releases: { why: 'none' } })
    expect(check(usual(['a', 'b']), offered)).toEqual({
      releases: { why: 'overlap', board: 'virt' },
    })
  })

  it('is sent as the server takes it', () => {
    const draft: Draft = {
      ...usual(['a']),
      phases: [
        { ...newPhase(1, 'r1, r2 r1'), by: 'group', soak: '90 s' },
        { ...newPhase(2, 'physical'), by: 'kind', success: '100', stop: '1', least: '3' },
        { ...newPhase(3, ' virt '), by: 'board' },
        newPhase(4, '100'),
      ],
      rate: '64',
      wait: '2 h',
      from: '22:00',
      to: '05:30',
      gate: ' it was tried by hand ',
    }
    expect(check(draft, offered)).toEqual({})
    const usually = { success_percent: 95, stop_percent: 5, min_count: 1, stop_min_count: 1 }
    expect(bodyOf(draft, -90)).toEqual({
      releases: [{ release: 'a' }],
      phases: [
        { select: { group: ['r1', 'r2'] }, soak_s: 90, ...usually },
        {
          select: { kind: 'physical' },
          soak_s: 600,
          success_percent: 100,
          stop_percent: 1,
          min_count: 3,
          stop_min_count: 3,
        },
        { select: { board: 'virt' }, soak_s: 600, ...usually },
        { select: { share: 100 }, soak_s: 600, ...usually },
      ],
      limits: { parallel: 50, bytes_per_second: 65_536, wait_s: 7_200 },
      window: { from: '22:00', to: '05:30', offset_minutes: -90 },
      override_gate: 'it was tried by hand',
    })
    expect(bodyOf(usual(['a']), 60)).not.toHaveProperty('window')
    expect(bodyOf(usual(['a']), 60).limits).toEqual({
      parallel: 50,
      bytes_per_second: null,
      wait_s: null,
    })
  })

  it('is wrong where the server would say so', () => {
    const one = (change: object) => wrongs({ phases: [{ ...newPhase(1, '100'), ...change }] })
    expect(one({ of: '0' })).toHaveProperty('phase-1-of.why', 'whole')
    expect(one({ of: '1.5' })).toHaveProperty('phase-1-of.why', 'whole')
    expect(one({ by: 'group', of: '' })).toHaveProperty('phase-1-of.why', 'robots')
    expect(one({ by: 'group', of: 'Robot!' })).toHaveProperty('phase-1-of.why', 'robots')
    expect(one({ by: 'board', of: ' ' })).toHaveProperty('phase-1-of.why', 'board')
    expect(one({ by: 'kind', of: 'x' })).toHaveProperty('phase-1-of.why', 'kind')
    expect(one({ soak: '10' })).toHaveProperty('phase-1-soak.why', 'duration')
    expect(one({ success: '101' })).toHaveProperty('phase-1-success.why', 'whole')
    expect(one({ stop: '0' })).toHaveProperty('phase-1-stop.why', 'whole')
    expect(one({ least: '' })).toHaveProperty('phase-1-least.why', 'whole')
    const shares = wrongs({ phases: [newPhase(1, '50'), newPhase(2, '50')] })
    expect(shares).toEqual({ 'phase-2-of': { why: 'share', above: 50 } })
    expect(wrongs({ phases: [] })).toEqual({ phases: { why: 'none' } })
    expect(wrongs({ parallel: '0' })).toHaveProperty('parallel')
    expect(wrongs({ rate: '15' })).toEqual({ rate: { why: 'whole', least: 16, most: 4_194_303 } })
    expect(wrongs({ wait: 'long' })).toEqual({ wait: { why: 'duration' } })
    expect(wrongs({ gate: 'x'.repeat(513) })).toEqual({ gate: { why: 'long' } })
    expect(wrongs({ from: '22:00' })).toEqual({ to: { why: 'half' } })
    expect(wrongs({ from: '24:00', to: '01:00' })).toEqual({ from: { why: 'time' } })
    expect(wrongs({ from: '01:00', to: '01:00' })).toEqual({ to: { why: 'never' } })
  })

  it('has its first mistake where the form comes to it first', () => {
    const draft = usual()
    draft.phases = [newPhase(7, '0'), newPhase(3, '100')]
    draft.parallel = ''
    expect(firstWrong(draft, check(draft, []))).toBe('releases')
    draft.releases = ['a']
    expect(firstWrong(draft, check(draft, offered))).toBe('phase-7-of')
    draft.phases = [newPhase(3, '100')]
    expect(firstWrong(draft, check(draft, offered))).toBe('parallel')
    expect(firstWrong(usual(['a']), {})).toBeNull()
  })

  it('says every mistake in words', () => {
    const all = [
      ...([
        'none',
        'duration',
        'time',
        'half',
        'never',
        'robots',
        'board',
        'kind',
        'many',
        'long',
      ] as const),
    ].map((why) => wrongWords({ why }))
    expect(new Set(all).size).toBe(all.length)
    expect(wrongWords({ why: 'whole', least: 1, most: 20_000 })).toContain('20,000')
    expect(wrongWords({ why: 'overlap', board: 'virt' })).toContain('virt')
    expect(wrongWords({ why: 'share', above: 50 })).toContain('50')
  })

  it('has times with a unit', () => {
    expect(['90 s', '10min', ' 2 h', '1 d', '0 s'].map(seconds)).toEqual([
      90, 600, 7_200, 86_400, 0,
    ])
    for (const text of ['', '10', '-1 s', '1.5 h', '91 d', '99999999 d', 'ten min', '1 w']) {
      expect(seconds(text)).toBeNull()
    }
    expect(names(' a,b;c\n d ')).toEqual(['a', 'b', 'c', 'd'])
    expect(offsetMinutes(new Date(0))).toBe(0 - new Date(0).getTimezoneOffset())
  })

  it('goes back to an earlier program a tenth first', () => {
    expect(backPlan('x')).toEqual({
      releases: [{ release: 'x' }],
      phases: [
        { select: { share: 10 }, soak_s: 60 },
        { select: { share: 100 }, soak_s: 60 },
      ],
    })
  })
})

describe('the way back', () => {
  const release = (id: string, sequence: number, more: Partial<Release> = {}): Release => ({
    id,
    kind: 'program',
    name: null,
    board: 'virt',
    version: `0.${sequence}.0`,
    build: `b${sequence}`,
    sequence,
    floor: 0,
    size: 9,
    by: 'ada',
    added_at: 0,
    expires_at: null,
    withdrawn: null,
    ...more,
  })
  const rolled = (...of: [string, number][]): Rollout[] =>
    of.map(([build, sequence]) => ({
      ...rollout([]),
      plan: {
        phases: [],
        releases: [{ release: 'x', board: 'virt', build, version: '1', sequence, bytes: 9 }],
      },
    }))

  it('leads to every other program of the board, the latest first', () => {
    const releases = [
      release('m', 9, { kind: 'model' }),
      release('o', 8, { board: 'sim' }),
      release('a', 1),
      release('b', 2),
      release('w', 3, { withdrawn: { by: 'ada', at: 1, reason: 'x' } }),
      release('d', 4),
      release('e', 5),
    ]
    expect(boardsOf(releases)).toEqual(['sim', 'virt'])
    const way = wayBack('virt', releases, rolled(['b1', 1], ['b4', 4]), 0)
    expect(way.earlier.map(({ release: { id }, ready }) => [id, ready])).toEqual([
      ['b', null],
      ['a', null],
    ])
    expect([way.newest, way.build, way.free]).toEqual([4, 'b4', 6])
    // Models are counted by themselves.
    const [seen] = rolled(['m', 9])
    if (seen?.plan.releases[0] === undefined) throw new Error('a rollout')
    seen.plan.releases[0].model = 'eyes'
    const beside = wayBack('virt', releases, [...rolled(['b1', 1], ['b4', 4]), seen], 0)
    expect(beside).toEqual(way)
    expect(titleOf(seen)).toBe('model eyes 1 for virt')
  })

  it('is open at once where the program is here under a sequence that is high enough', () => {
    const again = release('again', 6, { build: 'b1', version: '0.1.0' })
    const releases = [release('a', 1), release('d', 4), again]
    const ready = (more: Partial<Release>, at = 4) =>
      wayBack('virt', [release('a', 1), { ...again, ...more }], rolled(['b4', at]), 100).earlier[0]
    const way = wayBack('virt', releases, rolled(['b4', 4]), 0)
    expect(way.earlier).toHaveLength(1)
    expect(way.earlier[0]?.ready?.id).toBe('again')
    expect(way.free).toBe(7)
    expect(ready({ expires_at: 100 })?.ready).toBeNull()
    expect(ready({}, 6)?.ready).toBeNull()
    expect(ready({}, 5)?.ready?.id).toBe('again')
  })

  it('is none before anything was rolled out', () => {
    const way = wayBack('virt', [release('a', 1), release('b', 2)], [], 0)
    expect([way.build, way.newest, way.free, way.earlier]).toEqual([null, 0, 3, []])
  })

  it('is prepared by one command', () => {
    const command = signCommand(release('a', 1, { version: '0.1.0' }), 7)
    expect(command).toBe(
      'terracrawler release sign --key keys/release-key.pem --image IMAGE --board virt ' +
        '--version 0.1.0 --build b1 --sequence 7 --out virt-7.release',
    )
    const expires = signCommand(release('a', 1, { expires_at: 5 }), 7)
    expect(expires).toContain(' --expires 365 ')
    expect(quoted("it's; rm")).toBe("'it'\\''s; rm'")
    expect(quoted('')).toBe("''")
    expect(signCommand(release('a', 1, { version: '1 $(x)' }), 7)).toContain("'1 $(x)'")
  })
})

describe('what robots run', () => {
  const robot = (id: string, board: string | null, build: string | null, firmware: string | null) =>
    ({
      id,
      board,
      build,
      firmware,
      kind: 'simulated',
      presence: 'online',
      models: { eyes: 'e1' },
    }) as unknown as RobotBody
  const running = runningOf([
    robot('a', 'virt', 'b1', '0.1.0'),
    robot('b', 'virt', 'b2', '0.2.0'),
    robot('c', 'virt', 'b2', '0.2.1'),
    robot('d', 'sim', null, null),
    robot('e', null, 'b2', '0.2.0'),
  ])

  it('is counted by board and build', () => {
    expect(countBuilds(running).map(({ key, robots }) => [key, robots])).toEqual([
      [':b2', 1],
      ['sim:', 1],
      ['virt:b2', 2],
      ['virt:b1', 1],
    ])
    expect(countBuilds(running)[2]?.firmware).toEqual(['0.2.0', '0.2.1'])
    expect(running[0]?.models).toEqual([['eyes', 'e1']])
  })

  it('has the newest release of the build, if the server has one', () => {
    const known = (
      id: string,
      board: string,
      build: string,
      sequence: number,
      kind = 'program',
    ) => ({
      id,
      board,
      build,
      sequence,
      kind,
      version: '1',
    })
    const releases = [
      known('x', 'virt', 'b1', 1),
      known('y', 'virt', 'b1', 3),
      known('m', 'virt', 'b1', 9, 'model'),
      known('z', 'sim', 'b1', 8),
    ]
    expect(releaseOf({ board: 'virt', build: 'b1' }, releases)?.id).toBe('y')
    expect(releaseOf({ board: 'virt', build: 'b2' }, releases)).toBeNull()
    expect(releaseOf({ board: 'virt', build: null }, releases)).toBeNull()
  })

  it('is looked through by build and by name', () => {
    const ids = (build: string, search: string) =>
      choose(running, { build, search }).map(({ robot: id }) => id)
    expect(ids('', '')).toHaveLength(5)
    expect(ids('virt:b2', '')).toEqual(['b', 'c'])
    expect(ids('virt:b2', ' C ')).toEqual(['c'])
    expect(ids('sim:', '')).toEqual(['d'])
  })
})

describe('calls', () => {
  /** Answers in this order, and what was asked for. */
  function serve(...answers: readonly (object | readonly [number, object])[]) {
    const asked: string[] = []
    const send = ((address: string, init: RequestInit) => {
      const answer = answers[asked.length] ?? {}
      asked.push(`${init.method ?? ''} ${address}`)
      const [status, body] = Array.isArray(answer) ? (answer as [number, object]) : [200, answer]
      return Promise.resolve(Response.json(body, { status }))
    }) as unknown as typeof fetch
    return { api: rolloutsApi(send), asked }
  }

  it('ask for rollouts and robots page by page', async () => {
    const { api, asked } = serve(
      { rollouts: [{ id: '9' }], next: '9' },
      { rollouts: [{ id: '8' }], next: null },
      { robots: [{ robot: 'a' }], next: 'a' },
      { robots: [{ robot: 'b' }], next: 'b' },
    )
    expect((await api.all()).map(({ id }) => id)).toEqual(['9', '8'])
    const { robots, more } = await api.robots('9', 'failed', 2)
    expect([robots.map(({ robot }) => robot), more]).toEqual([['a', 'b'], true])
    expect(asked).toEqual([
      'GET /api/v1/rollouts?limit=50',
      'GET /api/v1/rollouts?limit=50&before=9',
      'GET /api/v1/rollouts/9/robots?limit=200&state=failed',
      'GET /api/v1/rollouts/9/robots?limit=200&state=failed&after=a',
    ])
  })

  it('know a rollout that is none from a server that fails', async () => {
    const problem = (code: string) => ({ title: 'x', status: 404, code })
    const { api } = serve([404, problem('unknown_rollout')], [500, problem('internal')])
    expect(await api.one('7')).toBeNull()
    await expect(api.one('7')).rejects.toThrow('x')
  })

  it('go to the rollout, or to one of its robots', async () => {
    const { api, asked } = serve({ id: '7' }, { id: '7' }, { robot: 'r1', log: [] }, { id: '8' })
    await api.act('7', 'pause')
    await api.actOn('7', 'r1', 'retry')
    await api.robot('7', 'r1')
    await api.begin(backPlan('x'))
    expect(asked).toEqual([
      'POST /api/v1/rollouts/7/pause',
      'POST /api/v1/rollouts/7/robots/r1/retry',
      'GET /api/v1/rollouts/7/robots/r1',
      'POST /api/v1/rollouts',
    ])
  })

  it('ask for every release', async () => {
    const page = (id: string, next: string | null) => ({ releases: [{ id }], next, can_add: true })
    const { api, asked } = serve(page('a', 'a'), page('b', null))
    expect((await api.releases()).map(({ id }) => id)).toEqual(['a', 'b'])
    expect(asked[1]).toBe('GET /api/v1/releases?limit=50&before=a')
  })
})
