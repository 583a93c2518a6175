/** Words of the part of the page about updates that is about rollouts; loaded with it. */

import type { Release, Rollout, RolloutLogLine, UpdateReason, UpdateState } from './api-types'
import { duration } from './strings'
import type { Wrong } from './updates/plan'
import type { Acts, Group, PhaseName, RobotActs, Unknown } from './updates/rollouts'
import { reasonOf, selection } from './updates/rollouts'

const number = (value: number): string => value.toLocaleString('en')
const robots = (count: number): string => (count === 1 ? '1 robot' : `${number(count)} robots`)

export const tabs = {
  label: 'Parts of this page',
  releases: 'Releases',
  rollouts: 'Rollouts',
  robots: 'What robots run',
  back: 'Back to an earlier version',
} as const

export const rolloutStates: Readonly<Record<string, string>> = {
  running: 'Running',
  paused: 'Paused',
  aborting: 'Aborting',
  aborted: 'Aborted',
  done: 'Done',
}

export const pauses: Readonly<Record<string, string>> = {
  person: 'Somebody has paused it.',
  failures: 'It has stopped by itself: too many robots failed.',
  threshold: 'It has stopped by itself: too few robots are confirmed.',
}

export const states: Readonly<Record<UpdateState, string>> = {
  waiting: 'Waiting',
  deferred: 'Deferred',
  offered: 'Offered',
  preparing: 'Preparing',
  receiving: 'Receiving',
  verifying: 'Verifying',
  staged: 'Staged',
  trial: 'On trial',
  confirmed: 'Confirmed',
  rolled_back: 'Rolled back',
  failed: 'Failed',
  skipped: 'Left out',
  superseded: 'In a newer rollout',
  not_applicable: 'Not for it',
}

export const groups: Record<Group, string> = {
  waiting: 'waiting',
  working: 'at work',
  trial: 'on trial',
  confirmed: 'confirmed',
  failed: 'failed',
  left: 'left out',
}

export const phaseStates: Record<PhaseName, string> = {
  pending: 'To come',
  active: 'Served now',
  soaking: 'Being watched',
  passed: 'Passed',
}

/** Where a phase stands whose rollout does not run. */
export const phaseStands: Readonly<Record<string, string>> = {
  paused: 'Stands here',
  aborting: 'Ends here',
  aborted: 'Ended here',
}

/** What robots say, besides the code. */
const CODES: Readonly<Record<string, string>> = {
  panic: 'the new program panicked',
  watchdog: 'the new program hung, and the watchdog ended it',
  power_cycles: 'it lost its supply again and again in the trial',
  restarts: 'the new program restarted again and again',
  timeout: 'the trial took too long',
  no_link: 'the new program found no link that carries both ways',
  self_test: 'the new program failed its self-test',
  unhealthy_sensors: 'sensors that worked before do not work',
  control_missed: 'control missed its period',
  bad_image: 'the image does not start',
  too_slow: 'the new model takes too long for a picture',
  interrupted: 'it was called to something else',
  malformed: 'the manifest cannot be read',
  unknown_format: 'it does not know this format',
  unknown_key: 'it does not know the key',
  bad_signature: 'the signature is wrong',
  wrong_release: 'what came is another release',
  wrong_kind: 'it is not for this kind of robot',
  wrong_board: 'it is for another board',
  wrong_chip: 'it is for another chip',
  too_large: 'it is too large',
  expired: 'it has expired',
  same_build: 'the robot has this build',
  downgrade: 'the robot has a higher sequence',
  below_floor: 'it is below the floor of the robot',
  requires: 'another release comes first',
  bad_block: 'a block came wrong three times',
  bad_hash: 'the image is not what was signed',
  bad_model: 'it is no model that its program can run',
  bad_policy: 'it is no policy',
  other_observation:
    'its program observes, acts or shields otherwise than what the policy was trained with',
  flash_failed: 'its flash fails',
  initializing: 'it starts',
  driving: 'it drives',
  fault: 'it has a fault',
  estopped: 'it stands in an emergency stop',
  low_battery: 'its battery is low',
  battery_unknown: 'it does not know its battery',
  trial: 'it is on trial',
  busy: 'it has another release at hand',
  no_data: 'it has asked for two minutes and got nothing',
  unsaid: 'it does not say why',
}

/** A state within a sentence. */
function stateWords(state: string): string {
  return ((states as Readonly<Record<string, string>>)[state] ?? state).toLowerCase()
}

/** Why a robot stands where it does; empty where nobody says. */
export function because(reason: UpdateReason | null | undefined): string {
  const parts = reasonOf(reason)
  if (parts === null) return ''
  const { word, told } = parts
  switch (word) {
    case 'told':
      return CODES[told ?? ''] ?? `it says ${told ?? 'nothing'}`
    case 'timed_out':
      return `it took too long while ${stateWords(told ?? '')}`
    case 'wrong_build':
      return `it has confirmed another build, ${told ?? ''}`
    default:
      return WORDS[word] ?? word
  }
}

const WORDS: Readonly<Record<string, string>> = {
  old_build: 'it is back on another build',
  already_there: 'it ran this build before',
  no_release: 'no release is for its board',
  no_vision: 'it does not see, and a model is for robots that do',
  no_policies: 'it has no room for a policy',
  not_selected: 'no phase selects it',
  interrupted: 'it went offline on the way',
  withdrawn: 'it gave the offer up, as it was told',
  paused: 'the rollout was paused',
  aborted: 'the rollout was aborted',
  left_out: 'somebody has left it out',
  retried: 'somebody has asked for another attempt',
  newer_rollout: 'a newer rollout has it',
  never_reached: 'it did not come before the rollout ended',
}

/** The code that a robot has given, for those who look it up. */
export function codeOf(reason: UpdateReason | null | undefined): string | null {
  const parts = reasonOf(reason)
  return parts === null ? null : (parts.told ?? parts.word)
}

/** A program by its version, a model by its name as well. */
function called(model: string | null | undefined, version: string): string {
  return model == null ? version : `model ${model} ${version}`
}

/** What a rollout brings, as it is called. */
export function titleOf({ plan }: Pick<Rollout, 'plan'>): string {
  const names = plan.releases.map(({ version, board, kind, model }) => {
    const what = called(model, version)
    return kind == null ? `${what} for ${board}` : `${what} for ${kind} ${board}`
  })
  return names.join(', ')
}

export function phaseOf(phase: Rollout['plan']['phases'][number]): string {
  const chosen = selection(phase)
  switch (chosen.by) {
    case 'share':
      return `${String(chosen.percent)} % of the robots`
    case 'group':
      return chosen.robots.length <= 3
        ? chosen.robots.join(', ')
        : `${chosen.robots.slice(0, 2).join(', ')} and ${number(chosen.robots.length - 2)} more`
    case 'board':
      return `robots on ${chosen.name}`
    case 'kind':
      return `${chosen.name} robots`
  }
}

export const list = {
  title: 'Rollouts',
  lead: 'A rollout brings releases to robots, phase by phase. It stops by itself when too many fail.',
  columns: ['Rollout', 'State', 'Phase', 'Begun', 'Ended'],
  empty: 'No rollout yet.',
  emptyMore: 'Add a release, and begin one with it.',
  number: (id: string) => `No. ${id}`,
  phase: (phase: number, of: number) => `${String(phase)} of ${String(of)}`,
  by: (when: string, who: string) => `${when} by ${who}`,
  open: '–',
  older: 'Older rollouts',
  admin: 'Beginning and steering rollouts needs the role admin.',
}

export const form = {
  title: 'Begin a rollout',
  open: 'Begin a rollout',
  lead: 'Robots of a phase are offered the release, try it, and keep it or go back by themselves. The next phase begins when enough have kept it for long enough.',
  releases: 'Releases, one for each board',
  release: ({
    name,
    version,
    board,
    sequence,
  }: Pick<Release, 'name' | 'version' | 'board' | 'sequence'>) =>
    `${called(name, version)} for ${board}, sequence ${String(sequence)}`,
  noReleases: 'There is nothing that robots could be given. Add a release first.',
  phase: (place: number) => `Phase ${String(place)}`,
  by: 'Robots',
  select: {
    share: 'a share of all',
    group: 'these robots',
    board: 'those on a board',
    kind: 'those of a kind',
  },
  of: { share: 'Percent', group: 'Names', board: 'Board', kind: 'Kind' },
  hint: {
    share: 'with those of phases before',
    group: 'with spaces or commas between them',
    board: '',
    kind: '',
  },
  soak: 'Watch for',
  soakHint: 'like 30 s, 10 min, 2 h',
  success: 'Confirmed to pass, %',
  stop: 'Failures that stop, %',
  stopHint: 'and at least two',
  least: 'Robots that must be done',
  leastHint: 'before it passes or stops',
  addPhase: 'Add a phase',
  dropPhase: (place: number) => `Remove phase ${String(place)}`,
  drop: 'Remove',
  limits: 'Limits and hours',
  parallel: 'Robots at once',
  rate: 'KiB per second, all together',
  rateHint: 'empty: no limit',
  wait: 'Wait for robots that are away',
  waitHint: 'like 8 h, 7 d; empty: for good',
  from: 'Only from',
  to: 'until',
  hoursHint: (offset: number) =>
    `by a clock that is ${String(offset / 60)} h ahead of UTC all year; empty: at any time`,
  gate: 'Why without a gate that has passed',
  gateHint: 'for everybody who looks, and the audit log; empty: only releases that have passed',
  submit: 'Begin',
  busy: 'Beginning…',
  cancel: 'Cancel',
  refused: (why: string) => `The server does not begin it: ${why}`,
  failed: (why: string) => `It has not begun: ${why}`,
  begun: (id: string) => `Rollout ${id} has begun.`,
  wrong: (count: number) =>
    count === 1 ? 'One field is wrong.' : `${String(count)} fields are wrong.`,
}

export function wrongWords(wrong: Wrong): string {
  switch (wrong.why) {
    case 'none':
      return 'Choose at least one.'
    case 'many':
      return 'At most 32.'
    case 'long':
      return 'At most 512 bytes.'
    case 'duration':
      return 'A number and a unit, s, min, h or d: 10 min. At most 90 d.'
    case 'time':
      return 'A time of day from 00:00 to 23:59.'
    case 'half':
      return 'Both times, or none.'
    case 'never':
      return 'It would never be open.'
    case 'robots':
      return 'Names of robots: small letters, digits and dashes.'
    case 'board':
      return 'Choose a board.'
    case 'kind':
      return 'Choose a kind.'
    case 'whole':
      return `A whole number from ${number(wrong.least)} to ${number(wrong.most)}.`
    case 'overlap':
      return `Two are for ${wrong.board}: leave one out.`
    case 'share':
      return `More than ${String(wrong.above)}: shares count those of phases before.`
  }
}

const UNKNOWN: Record<Unknown, string> = {
  stands: 'unknown: it stands',
  'nobody-done': 'unknown: no robot is done yet',
  away: 'unknown: it waits for robots that are away or cannot now',
  'no-counts': 'unknown',
}

export const one = {
  back: 'All rollouts',
  unknown: 'There is no rollout of this number.',
  made: (when: string, who: string) => `begun ${when} by ${who}`,
  ended: (when: string) => `ended ${when}`,
  server: (name: string) => `carried out by server ${name}`,
  window: (from: string, to: string, hours: number) =>
    `offers only from ${from} to ${to} (UTC${hours < 0 ? '−' : '+'}${String(Math.abs(hours))})`,
  figures: 'How far it is',
  done: 'confirmed',
  doneOf: (done: number, all: number) => `${number(done)} of ${number(all)}`,
  failed: 'failed',
  rate: 'images',
  pace: 'robots done',
  left: 'time left',
  measuring: 'measuring…',
  perSecond: (bytes: number) =>
    bytes < 10_240
      ? `${number(Math.round(bytes))} B/s`
      : bytes < 10_485_760
        ? `${number(Math.round(bytes / 1_024))} KiB/s`
        : `${(bytes / 1_048_576).toFixed(1)} MiB/s`,
  perMinute: (hourly: number) =>
    `${hourly >= 600 ? number(Math.round(hourly / 60)) : (hourly / 60).toFixed(1)} per min`,
  noPace: 'none yet',
  about: (seconds: number) => `about ${duration(seconds)}`,
  notKnown: (why: Unknown) => UNKNOWN[why],
  over: 'none, it is over',
  phases: 'Phases',
  phase: (place: number) => `Phase ${String(place)}`,
  soaks: (left: number) => `watched for ${duration(left)} more`,
  phaseLeft: (seconds: number) => `about ${duration(seconds)} left`,
  failures: (count: number, most: number) => `${number(count)} failed, stops at ${number(most)}`,
  rule: (success: number, soak: number) =>
    `passes at ${String(success)} % confirmed, watched for ${duration(soak)}`,
  noRobots: 'no robots',
  failuresTitle: 'Failures',
  kind: (count: number, state: string, why: string) =>
    `${number(count)} × ${state}${why === '' ? '' : `: ${why}`}`,
  more: (count: number) => `and ${robots(count)} more: choose the state below`,
  log: 'What has happened',
  notFor: (count: number) => `It is not for ${robots(count)} of the fleet.`,
}

export const happened: Readonly<Record<string, (line: RolloutLogLine) => string>> = {
  started: () => 'It has begun.',
  taken_over: () => 'Another server has taken it over.',
  phase_began: ({ phase }) => `Phase ${String(phase ?? '')} begins.`,
  phase_soaks: ({ phase }) => `Robots of phase ${String(phase ?? '')} are done, and watched.`,
  phase_passed: ({ phase }) => `Phase ${String(phase ?? '')} has passed.`,
  paused: ({ reason }) => pauses[reason ?? ''] ?? 'It is paused.',
  resumed: () => 'It goes on.',
  aborted: () => 'It was aborted.',
  done: () => 'It is done.',
}

export const act = {
  names: { pause: 'Pause', resume: 'Resume', abort: 'Abort' } satisfies Record<Acts, string>,
  sure: {
    pause: 'Pause it? Robots that have not started the new program give it up until it goes on.',
    resume: 'Let it go on? Failures that stopped it do not count any more.',
    abort: 'Abort it for good? Robots that have not started the new program keep the old one.',
  } satisfies Record<Acts, string>,
  done: {
    pause: 'It is paused.',
    resume: 'It goes on.',
    abort: 'It is being aborted.',
  } satisfies Record<Acts, string>,
  robot: { retry: 'Retry', skip: 'Leave out' } satisfies Record<RobotActs, string>,
  robotOf: { retry: (id: string) => `Retry ${id}`, skip: (id: string) => `Leave ${id} out` },
  robotSure: {
    retry: (id: string) => `Offer the release to ${id} again?`,
    skip: (id: string) => `Leave ${id} out of this rollout?`,
  },
  robotDone: {
    retry: (id: string) => `${id} is offered it again.`,
    skip: (id: string) => `${id} is left out.`,
  },
  failed: (why: string) => `Not done: ${why}.`,
  doing: 'Telling the server…',
}

export const rows = {
  title: 'Robots',
  columns: ['Robot', 'State', 'Phase', 'Image', 'Since', 'Actions'],
  show: 'Show robots',
  all: (count: number) => `All states (${number(count)})`,
  option: (name: string, count: number) => `${name} (${number(count)})`,
  none: 'No robot is in this state.',
  image: (received: number, bytes: number) =>
    `${number(Math.floor((received / Math.max(1, bytes)) * 100))} %`,
  attempts: (count: number) =>
    count === 1 ? '1 failed attempt' : `${number(count)} failed attempts`,
  phase: (phase: number | null) => (phase === null ? '–' : String(phase)),
  more: 'More robots',
  log: 'Log',
  logOf: (id: string) => `Log of ${id}`,
  steps: 'Steps',
  noSteps: 'Nothing yet.',
  said: 'What it logged meanwhile',
  nothingSaid: 'Nothing that the server still has.',
  whole: 'Its whole log',
}

export const builds = {
  title: 'Builds',
  lead: 'A robot is proven to run a build only when it says so itself, in its status.',
  columns: ['Build', 'Board', 'Version', 'Robots'],
  noBuild: 'Does not say',
  noBuildMore: 'a program from before updates',
  unknownRelease: (firmware: string) =>
    firmware === '' ? '–' : `${firmware}, no release of it here`,
  sequence: (sequence: number) => `sequence ${String(sequence)}`,
  show: (count: number) => robots(count),
  table: 'Robots',
  search: 'Search by name',
  build: 'Show builds',
  all: 'All builds',
  rows: ['Robot', 'Board', 'Version', 'Build', 'Presence', 'Models'],
  count: (shown: number, all: number) =>
    shown === all ? robots(all) : `${number(shown)} of ${robots(all)}`,
  none: 'No robot has told yet what it runs.',
  noMatch: 'No robot matches.',
  noModels: 'none',
  more: 'Show more',
  back: 'Back to an earlier version',
}

export const back = {
  lead: 'Robots never take a sequence that is not above what they run. So the way back goes forward: the earlier program is signed once more, under a higher sequence, and rolled out like any other. The server holds no private key; whoever signs does that.',
  noBoards: 'There are no programs among the releases yet.',
  board: (board: string) => `Board ${board}`,
  newest: (build: string, sequence: number) =>
    `Rolled out last: build ${build}, sequence ${String(sequence)}.`,
  never: 'Nothing was rolled out for it yet, so there is nothing to go back from.',
  none: 'No earlier program is among the releases.',
  earlier: ({ version, build }: Pick<Release, 'version' | 'build'>) =>
    `${version} · build ${build}`,
  was: (sequence: number) => `last signed under sequence ${String(sequence)}`,
  ready: (sequence: number) =>
    `A release of it with sequence ${String(sequence)} is here: it can go out at once.`,
  press: (version: string) => `Go back to ${version}`,
  sure: (version: string, board: string) =>
    `Roll ${version} out to all robots on ${board} now? A tenth of them first, watched for a minute, then all.`,
  prepare: (version: string) => `Prepare going back to ${version}`,
  sign: 'Sign it where the private key is. IMAGE is the file that was signed before',
  size: (bytes: number) => `${number(bytes)} bytes`,
  byForm: 'Begin it by the form',
  then: (file: string) =>
    `Then add ${file} under Releases, and come back here: one press brings it to the robots.`,
}
