import { describe, expect, it } from 'vitest'
import type { Experiment, ExperimentMetrics } from '../../src/api-types'
import { compared, differing, rows, toggled } from '../../src/experiments/compare'
import { downsample } from '../../src/experiments/downsample'
import type { Draft } from '../../src/experiments/draft'
import {
  bodyOf,
  check,
  draftOf,
  fieldOf,
  firstWrong,
  repeat,
  usual,
} from '../../src/experiments/draft'
import {
  acts,
  isActive,
  passes,
  replayCommand,
  stateOf,
  usualCurves,
} from '../../src/experiments/shown'
import { overlap, wilson } from '../../src/experiments/statistics'
import { MOST_FAILURES, SUCCESS, Trials } from '../../src/experiments/trials'
import { figure, metricName, withUnit, wrongWords } from '../../src/strings-experiments'

const experiment = (change: Partial<Experiment> = {}): Experiment => ({
  id: '7',
  kind: 'evaluation',
  name: 'A first try',
  scenario: 'simple-navigation',
  robots: 1,
  seeds: 20,
  first_seed: 1,
  difficulty: null,
  randomisation: null,
  set: [],
  thresholds: ['success>=0.9'],
  by: 'ada',
  created_at: 1_000,
  started_at: 1_000,
  ended_at: null,
  state: 'running',
  reason: null,
  done: 0,
  summary: [],
  build: '0.1.0 (0123456789ab-cdef01234567)',
  workers: [],
  command: 'terracrawler evaluate --scenario simple-navigation',
  verdict: null,
  ...change,
})

/** Trials from `from` on; `of` gives success and the time, or no time. */
function page(
  from: number,
  to: number,
  of: (at: number) => [boolean, number | null],
): ExperimentMetrics {
  return {
    metrics: [
      { name: 'time', unit: 's', better: 'less' },
      { name: 'success', unit: '', better: 'more' },
    ],
    trials: Array.from({ length: to - from }, (_, at) => {
      const [success, time] = of(from + at)
      const reason = success ? null : 'late'
      const number = from + at
      return { number, seed: 100 + number, success, reason, values: [time, Number(success)] }
    }),
    next: null,
  }
}

describe('fewer points', () => {
  it('are all of them where there are few', () => {
    expect(downsample(0, () => 1, 10)).toEqual([])
    expect(downsample(3, (at) => at, 10)).toEqual([0, 1, 2])
    expect(downsample(2, (at) => at, 1)).toEqual([0, 1])
  })

  it('keep both ends, the order, every peak, and no more than asked', () => {
    const count = 100_000
    const peak = 61_803
    const value = (at: number): number => (at === peak ? 9 : Math.sin(at / 5_000))
    const kept = downsample(count, value, 800)
    expect(kept.length).toBeLessThanOrEqual(800)
    expect(kept.length).toBeGreaterThan(600)
    expect(kept[0]).toBe(0)
    expect(kept.at(-1)).toBe(count - 1)
    expect(kept).toContain(peak)
    expect(kept.every((at, place) => place === 0 || at > (kept[place - 1] ?? at))).toBe(true)
  })

  it('keep a gap', () => {
    const kept = downsample(1_000, (at) => (at > 400 && at < 700 ? null : at), 50)
    expect(kept.some((at) => at > 400 && at < 700)).toBe(true)
  })
})

describe('intervals', () => {
  it('are those of Wilson', () => {
    // 8 of 10: 0.4902 to 0.9433, as in any table of it.
    const { low, high } = wilson(8, 10)
    expect(low).toBeCloseTo(0.4902, 3)
    expect(high).toBeCloseTo(0.9433, 3)
    expect(wilson(0, 0)).toEqual({ low: 0, high: 1 })
    expect(wilson(20, 20).high).toBe(1)
    expect(wilson(20, 20).low).toBeGreaterThan(0.8)
  })

  it('overlap where they touch', () => {
    expect(overlap({ low: 0, high: 1 }, { low: 1, high: 2 })).toBe(true)
    expect(overlap({ low: 0, high: 1 }, { low: 1.1, high: 2 })).toBe(false)
    expect(overlap({ low: 0, high: 9 }, { low: 1, high: 2 })).toBe(true)
  })
})

describe('trials', () => {
  it('come to a share and to means, so far and of the last', () => {
    const trials = new Trials()
    expect(trials.append(page(0, 4, (at) => [at !== 1, at * 10]))).toBe(4)
    expect(trials.curve(SUCCESS, null, 100)).toEqual({ x: [1, 2, 3, 4], y: [1, 0.5, 2 / 3, 0.75] })
    expect(trials.curve('time', null, 100).y).toEqual([0, 5, 10, 15])
    expect(trials.curve('time', 2, 100).y).toEqual([0, 5, 15, 25])
    expect(trials.curve('nothing', null, 100)).toEqual({ x: [], y: [] })
    expect(trials.metrics.map(({ name }) => name)).toEqual(['success', 'time'])
    const { low, high } = trials.band([4])
    expect(low[0]).toBeLessThan(0.75)
    expect(high[0]).toBeGreaterThan(0.75)
  })

  it('are counted once, whatever a page repeats', () => {
    const trials = new Trials()
    trials.append(page(0, 3, () => [true, 1]))
    expect(trials.append(page(2, 5, () => [false, 2]))).toBe(2)
    expect(trials.append(page(0, 5, () => [false, 2]))).toBe(0)
    expect([trials.count, trials.failed, trials.last]).toEqual([5, 2, 4])
    expect(trials.failures.map(({ seed, reason }) => [seed, reason])).toEqual([
      [103, 'late'],
      [104, 'late'],
    ])
  })

  it('leave out what was not measured', () => {
    const trials = new Trials()
    trials.append(page(0, 3, (at) => [true, at === 1 ? 8 : null]))
    expect(trials.curve('time', null, 100).y).toEqual([null, 8, 8])
    expect(trials.curve('time', 1, 100).y).toEqual([null, 8, null])
  })

  it('take a metric that comes later', () => {
    const trials = new Trials()
    trials.append(page(0, 2, () => [true, 1]))
    const later = page(2, 3, () => [true, 1])
    later.metrics.push({ name: 'reward', unit: '', better: 'more' })
    later.trials[0]?.values.push(5)
    trials.append(later)
    expect(trials.curve('reward', null, 100).y).toEqual([null, null, 5])
    expect(trials.metrics.map(({ name }) => name)).toEqual(['success', 'time', 'reward'])
  })

  it('may be a hundred thousand', () => {
    const trials = new Trials()
    for (let from = 0; from < 100_000; from += 5_000) {
      trials.append(page(from, from + 5_000, (at) => [at % 4 !== 0, at]))
    }
    const curve = trials.curve(SUCCESS, null, 800)
    expect(curve.x.length).toBeLessThanOrEqual(800)
    expect(curve.x.at(-1)).toBe(100_000)
    expect(curve.y.at(-1)).toBeCloseTo(0.75, 6)
    expect(trials.failed).toBe(25_000)
    expect(trials.failures.length).toBe(MOST_FAILURES)
  })
})

describe('the form', () => {
  const draft = (change: Partial<Draft> = {}): Draft => ({ ...usual(), ...change })

  it('can be sent as it stands', () => {
    expect(check(usual())).toEqual({})
    expect(check(usual(['arena', 'simple-navigation']))).toEqual({})
    expect(usual(['arena']).scenario).toBe('arena')
    expect(bodyOf(usual(), 'twenty of it')).toEqual({
      name: 'twenty of it',
      scenario: 'simple-navigation',
      seeds: 20,
      first_seed: 1,
      set: [],
      thresholds: ['success>=0.9'],
      start: true,
    })
  })

  it('says what is wrong, in its order', () => {
    const wrongs = check(
      draft({
        scenario: ' ',
        seeds: '1.5',
        robots: '0',
        first_seed: '-1',
        difficulty: '2',
        name: 'x'.repeat(65),
        thresholds: 'success>=0.9\n\ncollisions<2',
        set: 'duration_s',
      }),
    )
    expect(Object.keys(wrongs)).toHaveLength(8)
    expect(firstWrong(wrongs)).toBe('scenario')
    expect(wrongs.thresholds).toEqual({ why: 'threshold', line: 3 })
    expect(wrongs.set).toEqual({ why: 'setting', line: 1 })
    expect(firstWrong({ set: 1, robots: 1 })).toBe('robots')
    for (const wrong of Object.values(wrongs)) expect(wrongWords(wrong)).toMatch(/\.$/)
  })

  it('takes what the server may take', () => {
    for (const difficulty of ['', '0', '0.5', '1', 'hard']) {
      expect(check(draft({ difficulty }))).toEqual({})
    }
    const thresholds = ' success >= 0.9 \ncollisions<=2\ntime_to_goal_s <= 1e2'
    expect(check(draft({ thresholds, set: 'link.loss=0.05\nspawn.poses[0].x = 1' }))).toEqual({})
    expect(check(draft({ seeds: '100001' })).seeds?.why).toBe('whole')
    const many = Array.from({ length: 17 }, () => 'success>=0.1').join('\n')
    expect(check(draft({ thresholds: many })).thresholds).toEqual({ why: 'lines', most: 16 })
  })

  it('is filled in from an experiment, which can be repeated', () => {
    const given = experiment({ difficulty: 'hard', set: ['a=1', 'b=2'], robots: 3 })
    const filled = draftOf(given, given.name)
    expect(filled.set).toBe('a=1\nb=2')
    expect(check(filled)).toEqual({})
    expect(repeat(given)).toEqual({
      name: 'A first try',
      scenario: 'simple-navigation',
      seeds: 20,
      robots: 3,
      first_seed: 1,
      difficulty: 'hard',
      set: ['a=1', 'b=2'],
      thresholds: ['success>=0.9'],
      start: true,
    })
  })

  it('finds the field that the server means', () => {
    expect(['/set/3', '/set', '/first_seed'].map(fieldOf)).toEqual(['set', 'set', 'first_seed'])
    expect(['/weather', '/sets', 'set', '', '/'].map(fieldOf)).toEqual([
      null,
      null,
      null,
      null,
      null,
    ])
  })
})

describe('an experiment', () => {
  it('can be told what its state allows', () => {
    expect(acts(experiment({ state: 'created' }))).toEqual(['start'])
    expect(acts(experiment({ state: 'running' }))).toEqual(['pause', 'stop'])
    expect(acts(experiment({ state: 'paused' }))).toEqual(['resume', 'stop'])
    expect(acts(experiment({ state: 'completed' }))).toEqual([])
    expect(acts(experiment({ state: 'created', waiting: true }))).toEqual(['stop'])
  })

  it('is active while its server may change it', () => {
    expect(isActive(experiment({ state: 'running' }))).toBe(true)
    expect(isActive(experiment({ state: 'created', waiting: true }))).toBe(true)
    expect(isActive(experiment({ state: 'paused' }))).toBe(false)
    expect(stateOf(experiment({ waiting: true }))).toBe('waiting')
    expect(stateOf(experiment({ state: 'paused' }))).toBe('paused')
  })

  it('is found by name, scenario, maker and state', () => {
    expect(passes(experiment(), 'all', ' FIRST ')).toBe(true)
    expect(passes(experiment(), 'active', 'ada')).toBe(true)
    expect(passes(experiment({ state: 'paused' }), 'active', '')).toBe(true)
    expect(passes(experiment({ state: 'completed' }), 'active', '')).toBe(false)
    expect(passes(experiment({ state: 'failed' }), 'failed', 'navigation')).toBe(true)
    expect(passes(experiment(), 'all', 'zebra')).toBe(false)
  })

  it('names the command that shows a seed again, quoted for a shell', () => {
    expect(replayCommand(experiment(), 17)).toBe(
      'terracrawler replay --scenario simple-navigation --robots 1 --seed 17',
    )
    const odd = experiment({ scenario: "it's two rooms", set: ['a=1'], difficulty: '0.5' })
    expect(replayCommand(odd, 1)).toBe(
      String.raw`terracrawler replay --scenario 'it'\''s two rooms' --robots 1 --difficulty 0.5 --set a=1 --seed 1`,
    )
  })

  it('is drawn by success and time', () => {
    const metric = (name: string, unit = '') => ({ name, unit, better: 'neither' as const })
    expect(usualCurves([metric('success'), metric('collisions'), metric('t', 's')])).toEqual([
      'success',
      't',
    ])
    expect(usualCurves([metric('t', 's'), metric('episode_length', 's')])).toEqual([
      'success',
      'episode_length',
    ])
    expect(usualCurves([])).toEqual(['success'])
  })
})

describe('a comparison', () => {
  const line = (metric: string, mean: number, half: number) => {
    return { metric, unit: '', mean, low: mean - half, high: mean + half, count: 20 }
  }

  it('is of four at the most, each once, as the address has them', () => {
    expect(compared('1,2,,2,3,4,5')).toEqual(['1', '2', '3', '4'])
    expect(compared('')).toEqual([])
    expect(toggled(['1', '2'], '1')).toEqual(['2'])
    expect(toggled(['1'], '9')).toEqual(['1', '9'])
    expect(toggled(['1', '2', '3', '4'], '5')).toEqual(['1', '2', '3', '4'])
  })

  it('tells the difference, and whether it is one', () => {
    const found = rows(
      [
        { summary: [line('success', 0.9, 0.05), line('collisions', 1, 0.1)] },
        { summary: [line('success', 0.7, 0.05), line('collisions', 0.5, 0.1)] },
        { summary: [line('success', 0.88, 0.05), line('distance', 4, 1)] },
      ],
      new Map([
        ['success', 'more' as const],
        ['collisions', 'less' as const],
      ]),
    )
    expect(found.map(({ metric }) => metric)).toEqual(['success', 'collisions', 'distance'])
    const [success, collisions, distance] = found
    expect(success?.cells.map((cell) => cell?.standing)).toEqual([null, 'worse', 'same'])
    expect(success?.cells[1]?.difference).toBeCloseTo(-0.2)
    expect(collisions?.cells.map((cell) => cell?.standing)).toEqual([null, 'better', undefined])
    expect(distance?.cells[0]).toBe(null)
    // The first has no such metric: there is nothing to differ from.
    expect(distance?.cells[2]?.difference).toBe(null)
  })

  it('lists the settings that differ', () => {
    const [a, b] = [experiment(), experiment({ difficulty: 'hard', set: ['a=1', 'b=2'] })]
    expect(differing([a, a])).toEqual([])
    expect(differing([a, b])).toEqual([
      { setting: 'difficulty', values: [null, 'hard'] },
      { setting: 'set', values: [null, 'a=1, b=2'] },
    ])
  })
})

describe('figures', () => {
  it('are written for people', () => {
    expect(withUnit('success', '', 0.9634)).toBe('96.3 %')
    expect(withUnit('time_to_goal_s', 's', 23.456)).toBe('23.5 s')
    expect(withUnit('collisions', 'contacts', 0.5)).toBe('0.500')
    expect(figure('energy_j', 'J', 1_234)).toBe('1234')
    expect(figure('reward', '', -2.5)).toBe('−2.50')
  })

  it('have names', () => {
    expect(metricName('time_to_goal_s')).toBe('Time to goal')
    expect(metricName('value_loss')).toBe('Value loss')
    expect(metricName('stride_m')).toBe('Stride')
  })
})
