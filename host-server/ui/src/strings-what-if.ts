/** Words of the page about what would have been, and of the form that asks for it; loaded with them. */

import type { RobotState } from './feed/decode'
import type { Replay } from './history/replay'
import type { World } from './what-if/answer'
import type { NullTest } from './what-if/rows'
import { exact, spoken } from './strings-history'
import { missions } from './strings-missions'
import { command as commands } from './strings-robot'
import { signed, states } from './strings'

const number = (value: number): string => value.toLocaleString('en')
const robots = (count: number): string => (count === 1 ? 'one robot' : `${number(count)} robots`)
const seconds = (value: number): string => `${value.toFixed(1)} s`

/** A command as it is asked for, and as the server tells it. */
interface Asked {
  command: string
  parameters?: unknown
}

const COMMANDS: Readonly<Record<string, string>> = {
  stop: 'Stop',
  identify: commands.identify,
  scan: commands.scan,
  reset: commands.reset,
  reboot: commands.reboot,
  estop: 'Emergency stop',
  move: 'Move',
  drive: 'Drive',
}

export function commandWords({ command, parameters }: Asked): string {
  const given = (parameters ?? {}) as Readonly<Record<string, unknown>>
  const text = (name: string): string => String(given[name] ?? '')
  if (command === 'goto') return `${commands.gotoTitle} ${text('x')}, ${text('y')}`
  if (command !== 'behave') return COMMANDS[command] ?? command
  const behaviour = text('behaviour')
  switch (behaviour) {
    case 'wander':
      return `${commands.behaviours['wander']?.[0] ?? behaviour}${given['speed'] === undefined ? '' : `, ${text('speed')} %`}`
    case 'policy':
      return `${commands.policyTitle} ${text('policy')}`
    case 'follow':
      return missions.following(text('leader'))
    case 'formation':
      return given['shape'] === undefined
        ? (commands.behaviours['formation']?.[0] ?? behaviour)
        : missions.forming(text('shape'))
    case 'patrol':
    case 'allocate':
    case 'cover':
    case 'consensus':
      return missions[behaviour]
    default:
      return commands.behaviours[behaviour]?.[0] ?? behaviour
  }
}

/** Whom it was asked of. */
export function whom(asked: readonly string[] | null | undefined): string {
  if (asked == null) return 'all robots'
  return asked.length <= 3 ? asked.join(', ') : robots(asked.length)
}

const MEASURES: Readonly<Record<string, string>> = {
  contacts: 'Contacts of a robot',
  way_m: 'Way of a robot',
  nearest_m: 'Nearest that two robots came',
}

export const measureName = (name: string): string =>
  MEASURES[name] ?? name.replace(/_m$/, '').replaceAll('_', ' ')

export function measure(value: number, unit: string): string {
  return unit === '' ? value.toFixed(2) : `${value.toFixed(2)} ${unit}`
}

export const form = {
  title: (at: number) => {
    const { clock, tenth } = exact(at)
    return `What if, at ${clock}.${tenth}?`
  },
  lead: 'The recorded fleet is simulated from this moment on, as it was and with another command. No robot is told anything.',
  whom: 'To whom',
  all: 'All robots',
  choose: 'Choose a robot above, or in the arena, to ask about it alone.',
  seconds: 'How far ahead',
  secondsOf: (value: number) => `${String(value)} seconds`,
  draws: 'Draws',
  drawsOf: (value: number) => `${String(value)} draws`,
  drawsHint: 'More draws take longer, and narrow the intervals.',
  nothing: 'Choose a command above.',
  question: (who: string, what: string) => `What if ${who} had been told “${what}”?`,
  ask: 'Simulate',
  asking: 'Asking…',
  cancel: 'Cancel',
  failed: (why: string) => `Not asked: ${why}.`,
  /** Told in other words than the server's, for what a person can do about it. */
  busy: 'Another question is being worked out. Wait until it is done, or end it.',
  notRecorded: 'Nothing was recorded at this moment, or not of this robot. Choose another one.',
  toList: 'Go to it',
  before: 'What was asked before',
}

export const list = {
  lead: 'What would have happened, had robots been told something else: asked of a moment of the record.',
  title: 'Asked before',
  none: 'Nothing has been asked yet.',
  hint: 'Choose a moment in the history, and press “What if…” there.',
  toHistory: 'Go to the history',
  kept: 'The server keeps the last 16 until it is restarted.',
  columns: ['Question', 'Moment', 'State', 'Asked'],
  question: (who: string, what: string) => `${who}: ${what}`,
  span: (ahead: number, draws: number) => `${number(ahead)} s ahead, ${number(draws)} draws`,
  by: (when: number, name: string) => `${exact(when).clock}, by ${name}`,
  forget: 'Forget',
  forgetOf: (what: string) => `Forget “${what}”`,
  forgotten: 'The question is forgotten.',
}

export const state: Readonly<Record<string, string>> = {
  running: 'Running',
  done: 'Done',
  failed: 'Failed',
}

export const page = {
  mark: 'Simulated',
  title: (who: string, what: string) => `What if ${who} had been told “${what}”?`,
  facts: (at: number, ahead: number, draws: number, by: string) =>
    `${spoken(at)}; ${number(ahead)} s ahead; ${number(draws)} draws; asked by ${by}`,
  toMoment: 'In the history',
  all: 'All questions',
  forget: 'Forget',
  end: 'End it',
  ended: 'The question was ended.',
  notDone: (why: string) => `Not done: ${why}.`,
  progress: (done: number, all: number) => `${number(done)} of ${number(all)} draws`,
  progressLabel: 'Draws that are done',
  finished: 'The answer is there.',
  running: 'Both worlds are being simulated…',
  failed: (why: string | null) =>
    why === null ? 'It could not be worked out.' : `It could not be worked out: ${why}.`,
  unreadable: (why: string) => `The answer cannot be shown: ${why}.`,
  gone: 'The server does not keep this question any more: it keeps the last 16 until it is restarted.',
}

export const worlds = {
  names: { was: 'As it was', would: 'What if' } satisfies Record<World, string>,
  about: {
    was: 'simulated from the record',
    would: 'with the command',
  } satisfies Record<World, string>,
  label: 'Both worlds',
  picture: (name: string) =>
    `Simulated picture of the arena: ${name}. With the focus here: arrow keys move the view of both, plus and minus zoom, Home shows everything, Enter selects the robot nearest to the cross. The text below says the same as the picture.`,
  summary({ fleet }: Replay): string {
    const counts = new Map<RobotState, number>()
    for (const { placed, state: now } of fleet.all()) {
      if (placed) counts.set(now, (counts.get(now) ?? 0) + 1)
    }
    const listed = [...counts].map(
      ([now, count]) => `${number(count)} ${states[now].toLowerCase()}`,
    )
    return `${fleet.size === 1 ? 'One robot' : `${number(fleet.size)} robots`}: ${listed.join(', ')}.`
  },
  robot({ selected }: Replay, within: number): string {
    if (selected === undefined) return ''
    const { id, state: now, x, y } = selected
    return `${id}: ${states[now].toLowerCase()} at ${signed(x, 2)}, ${signed(y, 2)} m, ± ${within.toFixed(2)} m.`
  },
  key: {
    disc: 'Disc: holds 95 % of the draws',
    ghost: 'Dashed outline: where it was in fact, red where the draws do not hold it',
    way: 'Dotted: the recorded way of the chosen robot',
    asked: 'Dashed ring: was told something else',
  },
}

export const transport = {
  label: 'Playback of both worlds',
  line: 'Time after the moment',
  value: (now: number, all: number) => `${seconds(now)} of ${seconds(all)}`,
  hint: 'Arrow keys move by a little, with Shift by a fifth of a second, Page Up and Page Down by more, Home and End to the ends.',
}

export const nullTest = {
  title: 'Is the simulation right?',
  told: ({ robots: all, inside }: NullTest) =>
    `${number(inside)} of ${number(all)} ${all === 1 ? 'robot was' : 'robots were'} in fact where the simulation has them, within 95 % of its draws.`,
  none: 'What came next was not recorded, so nobody knows whether the simulation is right.',
  weak: 'The simulation does not make what was recorded: this answer is worth little.',
}

export const measures = {
  title: 'Measures',
  columns: ['Measure', 'As it was', 'What if', 'Difference'],
  interval: (low: number, high: number) => `95 %: ${signed(low, 2)} to ${signed(high, 2)}`,
  difference: (value: number, unit: string) =>
    `${value > 0 ? '+' : ''}${signed(value, 2)}${unit === '' ? '' : ` ${unit}`}`,
  clear: 'clear',
  unclear: 'could be chance',
}

const BODIES = { record: 'by what it did before', make: 'of its make' }

export const table = {
  title: 'Robots',
  lead: 'The furthest apart first. Choosing one selects it in both worlds.',
  columns: ['Robot', 'Apart in the end', 'Parted', 'Contacts', 'Recorded', 'Body'],
  asked: 'told something else',
  doing: (what: string, supposed: boolean) =>
    supposed ? `was doing, it is supposed: ${what}` : `was doing: ${what}`,
  apart: (metres: number) => `${metres.toFixed(2)} m`,
  parted: (after: number | null) => (after === null ? 'never' : `after ${seconds(after)}`),
  contacts: (was: number, would: number) => `${was.toFixed(1)} → ${would.toFixed(1)}`,
  inside: (value: boolean | null) =>
    value === null ? 'nothing recorded' : value ? 'as simulated' : 'elsewhere',
  body: (known: 'certificate' | keyof typeof BODIES, certificate: string | null) =>
    known === 'certificate' ? `certificate ${certificate ?? ''}` : BODIES[known],
  more: (count: number) => `Show all ${number(count)}`,
}
