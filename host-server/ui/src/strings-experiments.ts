/** Words of the pages about experiments; loaded with them. */

import type { Setting, Standing } from './experiments/compare'
import type { Field, Wrong } from './experiments/draft'
import type { Act, Shown } from './experiments/shown'
import { duration, signed } from './strings'

const number = (value: number): string => value.toLocaleString('en')
const count = (value: number, one: string, many: string): string =>
  `${number(value)} ${value === 1 ? one : many}`

export const states: Readonly<Record<string, string>> = {
  created: 'Not started',
  waiting: 'Waits for its turn',
  running: 'Running',
  paused: 'Paused',
  stopped: 'Stopped',
  completed: 'Completed',
  failed: 'Failed',
}

export const shown: Record<Shown, string> = {
  all: 'All',
  active: 'Not over yet',
  completed: 'Completed',
  stopped: 'Stopped',
  failed: 'Failed',
}

export const acts: Record<Act, string> = {
  start: 'Start',
  pause: 'Pause',
  resume: 'Go on',
  stop: 'Stop',
}

export const settings: Record<Setting, string> = {
  scenario: 'Scenario',
  robots: 'Robots',
  seeds: 'Trials',
  first_seed: 'First seed',
  difficulty: 'Difficulty',
  randomisation: 'Randomisation',
  set: 'Other values',
  steps: 'Decisions to learn from',
  worlds: 'Worlds side by side',
  units: 'Units of each layer',
  own_critic: 'Critic sees no more than a robot',
}

const METRICS: Readonly<Record<string, string>> = {
  success: 'Success',
  reached: 'Goals reached',
  time_to_goal_s: 'Time to goal',
  path_optimality: 'Path optimality',
  energy_j: 'Energy per robot',
  collisions: 'Contacts per robot',
  min_clearance_m: 'Least clearance',
  recovery_s: 'Recovery after a fault',
  messages_per_task: 'Messages per task',
  uptime: 'Uptime',
  command_success: 'Commands completed',
  distance_m: 'Distance per robot',
  stranded: 'Robots stranded',
  dropouts: 'Dropouts in 100 robot-hours',
  contacts_per_minute: 'Contacts per robot and minute',
  order: 'Order of headings',
  clusters: 'Clusters',
  largest_cluster: 'Robots in the largest cluster',
  pair_distance_m: 'Least distance of two robots',
  coverage: 'Floor covered',
  evenness: 'Evenness of spread',
  lattice_degree: 'Neighbours in the lattice',
  spacing_error_m: 'Error of spacing',
  shape_error_m: 'Error of shape',
  settle_s: 'Time to settle',
  found: 'Things found',
  episode_length_s: 'Length of a trial',
}

/** Shares of one, which people read as percent. */
const SHARES = new Set(['success', 'reached', 'path_optimality', 'uptime', 'command_success'])

/** The name of such a metric says what is counted. */
const COUNTS = new Set([
  'contacts',
  'contacts/min',
  'messages',
  'robots',
  'dropouts',
  'clusters',
  'neighbours',
  'count',
  '1',
])

/** What nobody has words for is shown by its name, without the unit at its end. */
export function metricName(name: string): string {
  const known = METRICS[name]
  if (known !== undefined) return known
  const plain = name.replace(/_(s|m|j|mps)$/, '').replaceAll('_', ' ')
  return plain.charAt(0).toUpperCase() + plain.slice(1)
}

function isShare(metric: string, unit: string): boolean {
  return SHARES.has(metric) || unit === 'share'
}

/** What stands at the axis of a chart and in the head of a column. */
export function unitOf(metric: string, unit: string): string {
  if (isShare(metric, unit)) return '%'
  return COUNTS.has(unit) ? '' : unit
}

/** As drawn: shares in percent, everything else in its unit. */
export function scaled(metric: string, unit: string, value: number): number {
  return isShare(metric, unit) ? value * 100 : value
}

/** Three digits that matter; of shares one behind the point. */
export function figure(metric: string, unit: string, value: number): string {
  const drawn = scaled(metric, unit, value)
  if (drawn === 0) return '0'
  if (isShare(metric, unit)) return signed(drawn, 1)
  const size = Math.abs(drawn)
  if (size >= 1e6) return drawn.toExponential(2).replace('-', '−')
  return signed(drawn, size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3)
}

export function withUnit(metric: string, unit: string, value: number): string {
  const of = unitOf(metric, unit)
  return `${figure(metric, unit, value)}${of === '' ? '' : ` ${of}`}`
}

export const page = {
  none: 'This server runs no experiments.',
  noneMore: 'It may be older than this page. Evaluate a scenario at a console:',
  noneCommand: 'terracrawler evaluate --scenario simple-navigation',
  search: 'Search experiments',
  show: 'Show',
  count: (shown: number, all: number) =>
    shown === all
      ? count(all, 'experiment', 'experiments')
      : `${number(shown)} of ${count(all, 'experiment', 'experiments')}`,
  empty: 'No experiment yet.',
  emptyMore:
    'An experiment runs a scenario on many seeds in the server, as fast as it can, and tells how often it succeeds. Press Run to make the first one.',
  noMatch: 'No experiment matches.',
  showAll: 'Show all experiments',
  older: 'Older experiments',
  columns: ['Compare', 'Experiment', 'State', 'Success', 'Made'],
  progress: (done: number, all: number) => `${number(done)} of ${count(all, 'trial', 'trials')}`,
  rounds: (done: number, all: number) => `${number(done)} of ${count(all, 'round', 'rounds')}`,
  progressOf: (name: string) => `Progress of ${name}`,
  interval: (low: string, high: string) => `${low} to ${high}`,
  noShare: 'nothing yet',
  by: (when: string, who: string) => (who === '' ? when : `${when} by ${who}`),
  pick: (name: string) => `Compare ${name}`,
  pickMost: 'Four can be compared at a time.',
  picked: (ids: number) => `${String(ids)} chosen`,
  pickNone: 'Choose none',
  compare: 'Compare',
  pickMore: 'Choose another one to compare.',
}

export const form = {
  title: 'New experiment',
  again: (name: string) => `New experiment, like “${name}”`,
  lead: 'A scenario on many seeds: how often does it succeed?',
  more: 'More choices',
  labels: {
    scenario: 'Scenario',
    seeds: 'Trials',
    name: 'Name',
    robots: 'Robots',
    first_seed: 'First seed',
    difficulty: 'Difficulty',
    randomisation: 'Randomisation',
    thresholds: 'Thresholds',
    set: 'Other values',
  } satisfies Record<Field, string>,
  hints: {
    scenario: '',
    seeds: 'One seed each, up to 100,000.',
    name: '',
    robots: 'Those of the scenario when empty.',
    first_seed: 'The trials take this seed and those after it.',
    difficulty: 'From 0 to 1, or a level like hard; the scenario’s own when empty.',
    randomisation: 'How far robots differ from what they believe of themselves.',
    thresholds: 'One a line, like success>=0.9 or collisions<=1.',
    set: 'One a line, a key of the scenario and its value, like duration_s=60.',
  } satisfies Record<Field, string>,
  noList: 'The server does not list its scenarios: type the name of one.',
  nameHint: (name: string) => `“${name}” when empty.`,
  usualName: (scenario: string, seeds: string) => `${scenario}, ${seeds} trials`,
  robotsHint: (robots: number) => `The scenario has ${number(robots)}.`,
  randomisations: {
    '': 'as the scenario says',
    none: 'none',
    mild: 'mild',
    wild: 'wild',
  } as Readonly<Record<string, string>>,
  start: 'Start at once',
  run: 'Run',
  make: 'Make',
  making: 'Making it…',
  drop: 'Back to the usual values',
  failed: (why: string) => `Not made: ${why}.`,
  wrong: (fields: number) =>
    fields === 1 ? 'One field is not right yet.' : `${String(fields)} fields are not right yet.`,
  made: (name: string) => `${name} is made.`,
}

export function wrongWords(wrong: Wrong): string {
  switch (wrong.why) {
    case 'missing':
      return 'Choose a scenario.'
    case 'long':
      return `Too long: ${number(wrong.most)} characters at most.`
    case 'whole':
      return wrong.most > 1e9
        ? `A whole number from ${number(wrong.least)}.`
        : `A whole number from ${number(wrong.least)} to ${number(wrong.most)}.`
    case 'difficulty':
      return 'A number from 0 to 1, or the name of a level.'
    case 'lines':
      return `Too many lines: ${number(wrong.most)} at most.`
    case 'threshold':
      return `Line ${number(wrong.line)} is not like success>=0.9 or collisions<=2.`
    case 'setting':
      return `Line ${number(wrong.line)} is not like key=value.`
  }
}

export const one = {
  back: 'All experiments',
  unknown: 'There is no such experiment.',
  unknownMore: 'It may have been removed.',
  made: (when: string, who: string) => `Made ${when}${who === '' ? '' : ` by ${who}`}`,
  took: (from: number, to: number) => `took ${duration((to - from) / 1_000)}`,
  since: (seconds: number) => `for ${duration(seconds)}`,
  left: (seconds: number) => `about ${duration(seconds)} to go`,
  facts: 'What is run',
  robots: 'Robots',
  seeds: 'Seeds',
  seedRange: (from: number, to: number) =>
    from === to ? number(from) : `${number(from)} to ${number(to)}`,
  asScenario: 'as the scenario says',
  nothing: 'none',
  build: 'Build',
  workers: 'At work',
  atWork: (workers: readonly { name: string; seeds: number }[]) =>
    workers.map(({ name, seeds }) => `${name} (${count(seeds, 'seed', 'seeds')})`).join(', '),
  needOperator: 'Only operators start, pause, stop or remove experiments.',
  offline: 'No connection to the server: nothing can be changed now.',
  doing: 'Asking the server…',
  failed: (why: string) => `Not done: ${why}.`,
  told: {
    start: 'Started.',
    pause: 'Paused: trials under way are finished.',
    resume: 'Goes on.',
    stop: 'Stopped.',
  } satisfies Record<Act, string>,
  again: 'Run again',
  duplicate: 'Duplicate with changes',
  compare: 'Compare with others',
  remove: 'Remove',
  sureRemove: (name: string) => `Remove “${name}” and all it has measured for good?`,
  sureStop: (left: number) =>
    `Stop it for good? ${count(left, 'trial is', 'trials are')} not done yet.`,
  sureStopTraining: (left: number) =>
    `Stop it for good? ${count(left, 'round is', 'rounds are')} not learned yet, and nothing is judged.`,
  reason: (why: string) => `The server says: ${why}`,
  verdict: 'Verdict',
  verdictLater: 'Judged when all trials are done.',
  verdictNever: 'It ended before all trials were done: nothing is judged.',
  noThresholds: 'No thresholds were asked for, so there is nothing to judge.',
  allMet: (all: number) =>
    all === 1 ? 'What was asked for is met.' : `All ${String(all)} thresholds are met.`,
  notMet: (failed: number, all: number) =>
    all === 1
      ? 'What was asked for is not met.'
      : `${String(failed)} of ${String(all)} thresholds ${failed === 1 ? 'is' : 'are'} not met.`,
  met: 'met',
  missed: 'not met',
  measured: (value: string) => `measured ${value}`,
  unmeasured: 'nothing was measured',
  summary: 'Results',
  summarySoFar: 'Results so far',
  summaryColumns: ['Metric', 'Mean', '95 % interval', 'Trials'],
  noSummary: 'No trial is done yet.',
  failures: 'Failed seeds',
  noFailures: 'No trial has failed.',
  noFailuresYet: 'No trial has failed so far.',
  failed_of: (failed: number, all: number) =>
    `${number(failed)} of ${count(all, 'trial', 'trials')} failed.`,
  seed: (seed: number) => `Seed ${number(seed).replaceAll(',', '')}`,
  noReason: 'without a reason',
  reproduce: (seed: number) => `To see seed ${String(seed)} again, at a console`,
  command: 'All of it once more, at a console',
  moreFailures: (more: number) => `Show ${number(more)} more`,
  notKept: (kept: number) => `Only the first ${number(kept)} are kept here.`,
}

export const curves = {
  title: 'Curves',
  choose: 'Which curves',
  over: 'Mean of',
  overs: { all: 'all trials so far', '10': 'the last 10', '100': 'the last 100' } as const,
  none: 'Nothing to draw before the first trial is done.',
  noneChosen: 'Choose at least one curve.',
  loading: (loaded: number, all: number) =>
    `${number(loaded)} of ${count(all, 'trial', 'trials')} loaded`,
  axis: 'trials',
  noValue: 'not measured so far',
  now: (value: string, after: number) => `${value} after ${count(after, 'trial', 'trials')}`,
  range: (low: string, high: string) => `between ${low} and ${high} on the way`,
  band: 'The thin lines hold the share with 95 % confidence.',
}

/** Lines of a comparison have a letter, a colour and a pattern each. */
export const LETTERS = ['A', 'B', 'C', 'D'] as const

export const comparison = {
  title: 'Comparison',
  back: 'All experiments',
  few: 'Choose two to four experiments to compare.',
  missing: (count: number) =>
    count === 1
      ? 'One of them is not there any more.'
      : `${String(count)} of them are not there any more.`,
  legend: 'Which line is which',
  differing: 'In what they differ',
  nothingDiffers: 'They run the same scenario with the same settings.',
  results: 'Results beside each other',
  columns: (letter: string, name: string) => `${letter}: ${name}`,
  metric: 'Metric',
  points: 'points',
  setting: 'Setting',
  difference: (value: string, letter: string) => `${value} to ${letter}`,
  standing: {
    same: 'intervals overlap: no difference shown',
    better: 'better: intervals do not overlap',
    worse: 'worse: intervals do not overlap',
    other: 'differs: intervals do not overlap',
  } satisfies Record<Standing, string>,
  notMeasured: 'not measured',
  running: 'Still running: figures change.',
}

export const tile = {
  title: 'Experiments',
  none: 'None is running.',
  last: (name: string) => `The last one: ${name}`,
  more: (count: number) => `and ${String(count)} more`,
}
