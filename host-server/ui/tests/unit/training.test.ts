import { describe, expect, it } from 'vitest'
import type { Experiment, Release, TrainingPoint } from '../../src/api-types'
import { differing } from '../../src/experiments/compare'
import { repeat } from '../../src/experiments/draft'
import type { TrainingDraft } from '../../src/experiments/training'
import {
  COLUMNS,
  Rounds,
  checkTraining,
  factsOf,
  interquartileMean,
  policyName,
  releasesOf,
  runsTogether,
  signCommand,
  trainingFieldOf,
  trainingOf,
  usualTraining,
} from '../../src/experiments/training'
import { comparison, wrongWords } from '../../src/strings-training'

const SHA = `${'0123456789abcdef'.repeat(2)}${'f'.repeat(32)}`

function training(success: number | null, change: Partial<Experiment> = {}): Experiment {
  return {
    id: '3',
    kind: 'training',
    name: 'Apart',
    scenario: 'spread',
    robots: 3,
    seeds: 41,
    first_seed: 7,
    difficulty: null,
    randomisation: 'mild',
    set: [],
    thresholds: [],
    by: 'ada',
    created_at: 1_000,
    started_at: 1_000,
    ended_at: null,
    state: success === null ? 'running' : 'completed',
    reason: null,
    done: 3,
    summary: [],
    build: '',
    workers: [],
    command: '',
    verdict: null,
    training: {
      algorithm: 'ppo',
      steps: 1_000_000,
      worlds: 64,
      units: 32,
      own_critic: true,
      judging: false,
      files: [],
      score:
        success === null
          ? null
          : {
              episodes: 300,
              success,
              low: 0,
              high: 1,
              length_s: 15,
              floats: success,
              bytes: 8_552,
              sha256: SHA,
            },
    },
    ...change,
  }
}

const point = (round: number, success: number | null): TrainingPoint => ({
  round,
  steps: round * 384,
  episodes: success === null ? 0 : 4,
  reward: success,
  success,
  length_s: null,
  entropy: 1.9,
  divergence: 0,
  clipped: 0.5,
  critic: 0.1,
  loss: -0.01,
  vetoes: null,
})

describe('the form of a training', () => {
  const draft = (change: Partial<TrainingDraft> = {}): TrainingDraft => ({
    ...usualTraining(),
    ...change,
  })

  it('can be sent as it stands', () => {
    expect(checkTraining(usualTraining())).toEqual({})
    expect(trainingOf(usualTraining(), 'first')).toEqual({
      kind: 'training',
      name: 'first',
      steps: 1_000_000,
      seed: 1,
      worlds: 64,
      units: 64,
      randomisation: 'none',
      own_critic: false,
    })
  })

  it('says what is wrong', () => {
    const wrongs = checkTraining(
      draft({ steps: '0', seed: '-1', worlds: '257', units: 'many', name: 'x'.repeat(65) }),
    )
    expect(Object.keys(wrongs)).toEqual(['steps', 'seed', 'worlds', 'units', 'name'])
    for (const wrong of Object.values(wrongs)) expect(wrongWords(wrong)).toMatch(/\.$/)
    // One round more than there may be.
    expect(checkTraining(draft({ worlds: '1', steps: '3840000' }))).toEqual({})
    const many = checkTraining(draft({ worlds: '1', steps: '3840001' }))
    expect(many).toEqual({ steps: { why: 'rounds', most: 10_000 } })
    expect(wrongWords({ why: 'rounds', most: 10_000 })).toContain('10,000')
  })

  it('finds the field that the server means', () => {
    expect(['/steps', '/name', '/randomisation', '/own_critic', ''].map(trainingFieldOf)).toEqual([
      'steps',
      'name',
      'randomisation',
      null,
      null,
    ])
  })

  it('is filled in from a training that is done again', () => {
    expect(repeat(training(0.9))).toEqual({
      kind: 'training',
      name: 'Apart',
      seed: 7,
      steps: 1_000_000,
      worlds: 64,
      units: 32,
      own_critic: true,
      randomisation: 'mild',
    })
    expect(new Map(factsOf(training(0.9))).get('Units of each layer')).toBe('32')
  })
})

describe('a training that nodes learn', () => {
  const federated = {
    count: 8,
    quorum: 5,
    deadline_s: 60,
    aggregation: 'median',
    momentum: 0.7,
    proximal: 0,
  }
  const own = training(0.9)
  const one: Experiment = {
    ...own,
    training: own.training == null ? null : { ...own.training, federated },
  }

  it('is asked for by their number', () => {
    const asked = { ...usualTraining(), nodes: '8', worlds: '8', aggregation: 'median' }
    expect(checkTraining(asked)).toEqual({})
    expect(trainingOf(asked, 'first')).toMatchObject({ nodes: 8, worlds: 8, aggregation: 'median' })
    expect(Object.keys(checkTraining({ ...asked, nodes: '65' }))).toEqual(['nodes'])
    expect(trainingFieldOf('/nodes')).toBe('nodes')
    // Eight nodes come to an eighth of the rounds.
    const many = { ...asked, worlds: '1', steps: '3840001' }
    expect(checkTraining(many)).toEqual({})
    expect(Object.keys(checkTraining({ ...many, nodes: '0' }))).toEqual(['steps'])
  })

  it('is done again by as many, and says how', () => {
    const { count, ...rest } = federated
    expect(repeat(one)).toMatchObject({ nodes: count, ...rest })
    expect(new Map(factsOf(one)).get('Nodes')).toBe(
      '8, of which 5 have to answer; the others within 60 s; by the median of each weight',
    )
    expect(new Map(factsOf(own)).has('Nodes')).toBe(false)
  })
})

describe('rounds', () => {
  it('are taken in once each, and drawn over the decisions', () => {
    const rounds = new Rounds()
    expect(rounds.last).toBe(0)
    expect(rounds.append({ points: [point(1, null), point(2, 0.5)], next: 2 })).toBe(2)
    expect(rounds.append({ points: [point(2, 0.9), point(3, 0.75)], next: null })).toBe(1)
    expect(rounds.last).toBe(3)
    const [success, reward] = COLUMNS
    expect(rounds.curve(success, 10)).toEqual({ x: [384, 768, 1_152], y: [null, 50, 75] })
    expect(rounds.curve(reward, 10).y).toEqual([null, 0.5, 0.75])
    expect(rounds.curve(success, 2).x.length).toBeLessThanOrEqual(3)
  })
})

describe('a policy', () => {
  const release = (change: Partial<Release>): Release =>
    ({ kind: 'policy', board: 'sim', build: '', sequence: 1, ...change }) as Release

  it('gets a name that robots take', () => {
    expect(policyName('Apart, in wilder Worlds!')).toBe('apart-in-wilder')
    expect(policyName('spread')).toBe('mine')
    expect(policyName('äöü')).toBe('mine')
  })

  it('is signed as the next one for its board', () => {
    const there = [
      release({ sequence: 4 }),
      release({ sequence: 9, board: 'virt' }),
      release({ sequence: 30, kind: 'program' }),
    ]
    expect(signCommand('First', 'sim', there)).toContain(
      '--name first --board sim --version 5 --sequence 5 --out first-sim.release',
    )
    expect(signCommand('First', 'xiao-s3-sense', [])).toContain('--sequence 1 ')
  })

  it('is found among releases by half of its hash', () => {
    const mine = release({ build: SHA.slice(0, 32) })
    const others = [release({ build: 'f'.repeat(32) }), { ...mine, kind: 'program' }]
    expect(releasesOf(SHA, [...others, mine])).toEqual([mine])
    expect(releasesOf('', [release({})])).toEqual([])
  })
})

describe('several runs', () => {
  it('come to an interquartile mean', () => {
    expect(interquartileMean([9, 1, 2, 3])).toBe(2.5)
    expect(interquartileMean([4])).toBe(4)
  })

  it('come to an interval, the same one every time', () => {
    const runs = [0.8, 0.9, 0.91, 0.92, 0.93, 0.95].map((success) => training(success))
    const found = runsTogether(runs)
    expect(found).toEqual(runsTogether(runs))
    expect(found?.runs).toBe(6)
    expect(found?.mean).toBeCloseTo((0.9 + 0.91 + 0.92 + 0.93) / 4, 12)
    expect(found?.low).toBeGreaterThan(0.8)
    expect(found?.low).toBeLessThan(found?.mean ?? 0)
    expect(found?.high).toBeGreaterThan(found?.mean ?? 1)
    expect(comparison.together(found ?? { runs: 0, mean: 0, low: 0, high: 0 })).toContain('91.5 %')
    // Strata of one run each have no spread of their own.
    const apart = runsTogether([training(0.8), training(0.9, { randomisation: 'wild' })])
    expect([apart?.low, apart?.high]).toEqual([apart?.mean, apart?.mean])
    expect(runsTogether([training(0.9), training(null)])).toBeNull()
  })

  it('say in what they differ', () => {
    const other = training(0.9, { first_seed: 8 })
    if (other.training != null) other.training.units = 64
    expect(differing([training(0.9), other])).toEqual([
      { setting: 'first_seed', values: ['7', '8'] },
      { setting: 'units', values: ['32', '64'] },
    ])
  })
})
