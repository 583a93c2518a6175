/** Trainings: the form of a new one, how one has gone, and what becomes of its policy. */

import type { Experiment, NewTraining, Release, TrainingCurve, TrainingPoint } from '../api-types'
import { facts as say, randomisations } from '../strings-training'
import { downsample } from './downsample'
import type { Curve } from './trials'

/** Numbers of the form, in its order. */
export const NUMBERS = ['steps', 'seed', 'worlds', 'units', 'nodes'] as const
export type NumberField = (typeof NUMBERS)[number]
export type TrainingField = NumberField | 'name' | 'randomisation' | 'aggregation'

/** How what nodes learned becomes one, the usual way first. */
export const AGGREGATIONS = [
  'mean',
  'success',
  'median',
  'trimmed-mean',
  'multi-krum',
  'norm-clip',
] as const
export type Aggregation = (typeof AGGREGATIONS)[number]

export const BOUNDS: Readonly<Record<NumberField, readonly [number, number]>> = {
  steps: [1, 1_000_000_000],
  seed: [0, Number.MAX_SAFE_INTEGER],
  worlds: [1, 256],
  units: [4, 64],
  nodes: [0, 64],
}
const MOST_ROUNDS = 10_000
/** Decisions of a world in a round: three robots, 128 each. */
const ROUND = 3 * 128
export const LONGEST_NAME = 64

export type TrainingDraft = Record<TrainingField, string> & { ownCritic: boolean }

/** A policy that is worth something in a few minutes. */
export function usualTraining(): TrainingDraft {
  return {
    name: '',
    steps: '1000000',
    seed: '1',
    worlds: '64',
    units: '64',
    nodes: '0',
    aggregation: 'mean',
    randomisation: 'none',
    ownCritic: false,
  }
}

export type TrainingWrong =
  | { why: 'whole'; least: number; most: number }
  | { why: 'rounds'; most: number }
  | { why: 'long'; most: number }

export function checkTraining(draft: TrainingDraft): Partial<Record<TrainingField, TrainingWrong>> {
  const wrongs: Partial<Record<TrainingField, TrainingWrong>> = {}
  for (const field of NUMBERS) {
    const [least, most] = BOUNDS[field]
    const text = draft[field].trim()
    const value = /^\d{1,16}$/.test(text) ? Number(text) : Number.NaN
    if (!(value >= least && value <= most)) wrongs[field] = { why: 'whole', least, most }
  }
  // Worlds are those of each node, where nodes learn.
  const worlds = Number(draft.worlds) * Math.max(Number(draft.nodes), 1)
  const rounds = Math.ceil(Number(draft.steps) / (ROUND * worlds))
  if (wrongs.steps === undefined && wrongs.worlds === undefined && rounds > MOST_ROUNDS) {
    wrongs.steps = { why: 'rounds', most: MOST_ROUNDS }
  }
  if (draft.name.trim().length > LONGEST_NAME) wrongs.name = { why: 'long', most: LONGEST_NAME }
  return wrongs
}

/** What is sent; only of a draft with nothing wrong. `name` is for one without. */
export function trainingOf(draft: TrainingDraft, name: string): NewTraining {
  return {
    kind: 'training',
    name: draft.name.trim() || name.slice(0, LONGEST_NAME),
    steps: Number(draft.steps),
    seed: Number(draft.seed),
    worlds: Number(draft.worlds),
    units: Number(draft.units),
    randomisation: draft.randomisation,
    own_critic: draft.ownCritic,
    ...(Number(draft.nodes) > 0
      ? { nodes: Number(draft.nodes), aggregation: draft.aggregation }
      : {}),
  }
}

/** The field that the pointer `/steps` is about; `null` for one not in the form. */
export function trainingFieldOf(pointer: string): TrainingField | null {
  const name = /^\/([^/]+)/.exec(pointer)?.[1]
  const all: readonly TrainingField[] = ['name', ...NUMBERS, 'randomisation', 'aggregation']
  return all.find((field) => field === name) ?? null
}

/** The same once more. */
export function repeatTraining({
  name,
  first_seed: seed,
  randomisation,
  training,
}: Experiment): NewTraining {
  const { steps, worlds, units, own_critic, federated } = training ?? {}
  const { count, ...nodes } = federated ?? {}
  return {
    kind: 'training',
    name,
    seed,
    randomisation: randomisation ?? null,
    steps: steps ?? null,
    worlds: worlds ?? null,
    units: units ?? null,
    own_critic: own_critic ?? null,
    ...(count === undefined ? {} : { nodes: count, ...nodes }),
  }
}

/** What is trained, term by term. */
export function factsOf(one: Experiment): (readonly [string, string])[] {
  const { training } = one
  if (training == null) return []
  const number = (value: number): string => value.toLocaleString('en')
  const { randomisation } = one
  return [
    [say.task, one.scenario],
    [say.algorithm, training.algorithm.toUpperCase()],
    [say.steps, number(training.steps)],
    [say.seed, String(one.first_seed)],
    [say.worlds, number(training.worlds)],
    [say.units, number(training.units)],
    [say.critic, training.own_critic ? say.own : say.privileged],
    [say.randomisation, randomisations[randomisation ?? ''] ?? randomisation ?? ''],
    ...(training.federated == null
      ? []
      : [[say.nodes, say.federated(training.federated)] as const]),
  ]
}

/** What is drawn of each round. `share` is of one. */
export const COLUMNS = [
  { name: 'success', share: true },
  { name: 'reward', share: false },
  { name: 'entropy', share: false },
  { name: 'vetoes', share: true },
  { name: 'length_s', share: false },
  { name: 'loss', share: false },
  { name: 'critic', share: false },
  { name: 'divergence', share: false },
  { name: 'clipped', share: true },
] as const
export type Column = (typeof COLUMNS)[number]['name']

/** The rounds of a training, as they come in. */
export class Rounds {
  readonly points: TrainingPoint[] = []

  /** The last round that is here. */
  get last(): number {
    return this.points.at(-1)?.round ?? 0
  }

  /** Takes in a page, and leaves out what is known already. Gives how many were new. */
  append({ points }: TrainingCurve): number {
    const before = this.points.length
    for (const point of points) if (point.round > this.last) this.points.push(point)
    return this.points.length - before
  }

  /** A column over the decisions that were learned from, drawn by `most` points; shares in percent. */
  curve({ name, share }: (typeof COLUMNS)[number], most: number): Curve {
    const value = (at: number): number | null => {
      const told = this.points[at]?.[name] ?? null
      return told === null || !share ? told : told * 100
    }
    const shown = downsample(this.points.length, value, most)
    return { x: shown.map((at) => this.points[at]?.steps ?? 0), y: shown.map(value) }
  }
}

/** A name that robots and their releases can have, made of that of a training. */
export function policyName(name: string): string {
  const plain = name
    .toLowerCase()
    .replace(/[^a-z0-9]+/g, '-')
    .slice(0, 16)
    .replace(/^-|-$/g, '')
  // That one comes with the program.
  return plain === '' || plain === 'spread' ? 'mine' : plain
}

export const BOARDS = ['sim', 'virt', 'xiao-s3-sense'] as const
export type Board = (typeof BOARDS)[number]

/** What signs a policy for a board, as the next release for it. */
export function signCommand(name: string, board: Board, releases: readonly Release[]): string {
  const sequences = releases
    .filter((one) => one.kind === 'policy' && one.board === board)
    .map(({ sequence }) => sequence)
  const sequence = Math.max(0, ...sequences) + 1
  const called = policyName(name)
  return (
    'terracrawler release sign --key keys/release-key.pem --image policy.tcpo --kind policy ' +
    `--name ${called} --board ${board} --version ${String(sequence)} --sequence ${String(sequence)} ` +
    `--out ${called}-${board}.release`
  )
}

/** The releases that have exactly that policy: their build is half of the hash. */
export function releasesOf(sha256: string, releases: readonly Release[]): Release[] {
  const half = sha256.slice(0, sha256.length / 2)
  return releases.filter(({ kind, build }) => kind === 'policy' && half !== '' && build === half)
}

export interface Together {
  runs: number
  mean: number
  low: number
  high: number
}

const RESAMPLES = 2_000

/** The interquartile mean: without a quarter of the values, rounded down, at each end. */
export function interquartileMean(values: readonly number[]): number {
  const sorted = [...values].sort((a, b) => a - b)
  const cut = Math.floor(sorted.length / 4)
  const middle = sorted.slice(cut, sorted.length - cut)
  return middle.reduce((sum, value) => sum + value, 0) / middle.length
}

/**
 * What runs that are over come to together: the interquartile mean of their shares, and its 95 % interval by the
 * bootstrap. Runs that differ in more than their seed are strata of their own. `null` with fewer than two.
 */
export function runsTogether(trainings: readonly Experiment[]): Together | null {
  const strata = new Map<string, number[]>()
  for (const one of trainings) {
    const score = one.training?.score ?? null
    if (score === null) continue
    const { steps, worlds, units, own_critic } = one.training ?? {}
    const settings = [one.scenario, one.randomisation, steps, worlds, units, own_critic].join()
    strata.set(settings, [...(strata.get(settings) ?? []), score.success])
  }
  const all = [...strata.values()].flat()
  if (all.length < 2) return null
  const random = drawn()
  const means = Array.from({ length: RESAMPLES }, () =>
    interquartileMean(
      [...strata.values()].flatMap((runs) =>
        runs.map(() => runs[Math.floor(random() * runs.length)] ?? 0),
      ),
    ),
  ).sort((a, b) => a - b)
  const at = (part: number): number => means[Math.round(part * (RESAMPLES - 1))] ?? 0
  return { runs: all.length, mean: interquartileMean(all), low: at(0.025), high: at(0.975) }
}

/** Numbers from 0 to 1, the same ones every time (mulberry32). */
function drawn(): () => number {
  let state = 1
  return () => {
    state = (state + 0x6d2b79f5) | 0
    let z = Math.imul(state ^ (state >>> 15), 1 | state)
    z = (z + Math.imul(z ^ (z >>> 7), 61 | z)) ^ z
    return ((z ^ (z >>> 14)) >>> 0) / 2 ** 32
  }
}
