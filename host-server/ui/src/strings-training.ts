/** Words of trainings among the experiments; loaded with them. */

import type { TrainingByNodes } from './api-types'
import type {
  Aggregation,
  Board,
  Column,
  NumberField,
  Together,
  TrainingWrong,
} from './experiments/training'
import { duration, signed } from './strings'

const number = (value: number): string => value.toLocaleString('en')
const percent = (share: number): string => `${signed(share * 100, 1)} %`

export const randomisations: Readonly<Record<string, string>> = {
  none: 'none',
  mild: 'mild',
  wild: 'wild',
}

export const aggregations: Readonly<Record<Aggregation, string>> = {
  mean: 'their mean',
  success: 'their mean, weighted by success',
  median: 'the median of each weight',
  'trimmed-mean': 'their mean without the extremes of each weight',
  'multi-krum': 'the mean of those that are closest to others (Multi-Krum)',
  'norm-clip': 'their mean, none longer than the median',
}

export const form = {
  title: 'New training',
  lead: 'Robots learn a policy in worlds of the server: how to get apart without touching anything.',
  labels: {
    steps: 'Decisions to learn from',
    seed: 'Seed',
    worlds: 'Worlds side by side',
    units: 'Units of each layer',
    nodes: 'Nodes',
  } satisfies Record<NumberField, string>,
  hints: {
    steps: 'Three million come to what robots have by default.',
    seed: 'The same seed and settings come to the same policy.',
    worlds: 'More of them learn more slowly and more surely.',
    units: 'Of both hidden layers of the network.',
    nodes:
      '0: the server learns. Else so many terracrawler learn-node do, each in that many worlds of its own.',
  } satisfies Record<NumberField, string>,
  name: 'Name',
  nameHint: (name: string) => `“${name}” when empty.`,
  usualName: (steps: string, seed: string) => `apart, ${steps} decisions, seed ${seed}`,
  randomisation: 'Randomisation',
  randomisationHint: 'How far robots differ from what they believe of themselves.',
  aggregation: 'What nodes learned becomes one by',
  aggregationHint:
    'The first two believe every node; the others bear some that are broken or hostile.',
  ownCritic: 'The critic sees no more than a robot',
  more: 'More choices',
  run: 'Train',
  making: 'Making it…',
  failed: (why: string) => `Not made: ${why}.`,
  wrong: (fields: number) =>
    fields === 1 ? 'One field is not right yet.' : `${String(fields)} fields are not right yet.`,
}

export function wrongWords(wrong: TrainingWrong): string {
  switch (wrong.why) {
    case 'whole':
      return wrong.most > 1e9
        ? `A whole number from ${number(wrong.least)}.`
        : `A whole number from ${number(wrong.least)} to ${number(wrong.most)}.`
    case 'rounds':
      return `More than ${number(wrong.most)} rounds: fewer decisions, or more worlds.`
    case 'long':
      return `Too long: ${number(wrong.most)} characters at most.`
  }
}

export const facts = {
  task: 'Task',
  algorithm: 'Algorithm',
  steps: 'Decisions to learn from',
  seed: 'Seed',
  worlds: 'Worlds side by side',
  units: 'Units of each layer',
  critic: 'The critic sees',
  own: 'what a robot sees',
  privileged: 'the whole world',
  randomisation: 'Randomisation',
  nodes: 'Nodes',
  federated: ({ count, quorum, deadline_s: seconds, aggregation }: TrainingByNodes) =>
    `${String(count)}, of which ${String(quorum)} have to answer; the others within ${String(seconds)} s; by ${aggregations[aggregation as Aggregation]}`,
}

export const nodes = {
  title: 'Nodes',
  waits: (answered: readonly string[], expected: number) =>
    answered.length === 0
      ? `None of ${String(expected)} has answered this round yet.`
      : `${answered.join(', ')}: ${String(answered.length)} of ${String(expected)} have answered this round.`,
  how: 'A node is a machine with worlds of its own. Start it there, with the address of the broker:',
  start: 'Start a node',
  caption: 'What nodes said of the last round',
  node: 'Node',
  decisions: 'Decisions',
  success: 'Success',
  reward: 'Reward',
  step: 'Step',
  share: (share: number | null | undefined) => (share == null ? '–' : percent(share)),
  rewardOf: (value: number | null | undefined) => (value == null ? '–' : signed(value, 1)),
  counts: (taken: number, doubled: number, late: number, refused: number) =>
    `Updates: ${number(taken)} taken, ${number(doubled)} came twice, ${number(late)} late, ${number(refused)} refused.`,
}

export const columns: Record<Column, string> = {
  success: 'Success in training',
  reward: 'Reward of an episode',
  entropy: 'Entropy',
  vetoes: 'Shield vetoes',
  length_s: 'Length of an episode',
  loss: 'Loss of the policy',
  critic: 'Loss of the critic',
  divergence: 'Divergence in a round',
  clipped: 'Clipped samples',
}

export const units: Record<Column, string> = {
  success: '%',
  reward: '',
  entropy: 'nats',
  vetoes: '% of decisions',
  length_s: 's',
  loss: '',
  critic: '',
  divergence: 'nats',
  clipped: '%',
}

export const live = {
  title: 'How it goes',
  before: 'Nothing is learned yet.',
  judging: 'All is learned: the policy is being judged.',
  decisions: 'Decisions so far',
  rate: 'Decisions per second',
  left: 'To go',
  about: (seconds: number) => `about ${duration(seconds)}`,
  stands: 'stands',
  curves: 'Curves',
  none: 'Nothing to draw before the first round.',
  axis: 'decisions learned from',
  now: (value: string, round: number) => `${value} in round ${number(round)}`,
  noValue: 'no episode has ended yet',
  failed: (why: string) => `The curves are not complete: ${why}.`,
}

export const policy = {
  title: 'Policy',
  score: (share: number, low: number, high: number, worlds: number) =>
    `Apart without touching anything in ${percent(share)} of ${number(worlds)} worlds that it did not learn from (95 %: ${percent(low)} to ${percent(high)}).`,
  lasts: (seconds: number, floats: number) =>
    `Its episodes last ${signed(seconds, 1)} s. In floats it came to ${percent(floats)}.`,
  none: 'It is judged in worlds that it did not learn from once all is learned.',
  never: 'It ended before all was learned: nothing is judged.',
  soFar: 'What was learned so far can be downloaded, and judged at a console:',
  evaluate: 'terracrawler evaluate --scenario spread --seeds 100 --seed 1001 --policy so-far.tcpo',
  evaluateLabel: 'Judge what was learned so far',
  files: 'Files',
  download: (name: string, bytes: number) => `${name} (${number(bytes)} bytes)`,
  failed: (why: string) => `Not downloaded: ${why}.`,
  robots: 'Put it on robots',
  how: 'Robots take only what is signed, and the server has no key to sign with: download policy.tcpo, sign it where your key is, and add the release.',
  board: 'Board',
  boards: {
    sim: 'simulated robots',
    virt: 'emulated board',
    'xiao-s3-sense': 'XIAO ESP32-S3 Sense',
  } satisfies Record<Board, string>,
  sign: 'Sign it, at a console',
  add: 'Add the release',
  signed: (version: string, board: string) => `Release ${version} for ${board} has this policy.`,
  rollOut: 'Roll it out to robots',
  look: 'Look at it',
  needAdmin: 'Only administrators roll it out.',
}

export const comparison = {
  together: ({ runs, mean, low, high }: Together) =>
    `${String(runs)} runs together: interquartile mean ${percent(mean)} ` +
    `(95 %: ${percent(low)} to ${percent(high)}, by the bootstrap over seeds).`,
}
