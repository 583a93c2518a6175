/** Words of the page about the past; loaded with it. */

import type { Speed } from './history/address'
import { duration } from './strings'

const number = (value: number): string => value.toLocaleString('en')
const robots = (count: number): string => (count === 1 ? 'one robot' : `${number(count)} robots`)

/** A moment to the tenth of a second, with its date: by the clock of whoever looks. */
export function exact(time: number): { day: string; clock: string; tenth: string } {
  const then = new Date(time)
  return {
    day: then.toLocaleDateString('en-GB', {
      weekday: 'short',
      day: 'numeric',
      month: 'short',
      year: 'numeric',
    }),
    clock: then.toLocaleTimeString('en-GB'),
    tenth: String(Math.floor(then.getMilliseconds() / 100)),
  }
}

/** The same in one line, to the second. */
export function spoken(time: number): string {
  const { day, clock } = exact(time)
  return `${day}, ${clock}`
}

export const past = {
  recorded: 'Recorded',
  notLive: 'Not live',
  ago: (milliseconds: number) =>
    milliseconds < 1_000 ? 'just now' : `${duration(milliseconds / 1_000)} ago`,
  live: 'Back to live',
  whatIf: 'What if…',
  whatIfHint:
    'Simulate what would have happened, had robots been told something else at this moment',
  whatIfAsked: 'What was asked',
  copy: 'Copy link',
  copyHint: 'Copy a link that shows this very moment',
  copied: 'Link copied',
  copyByHand: 'Copy the address of this page by hand.',
  none: 'Nothing is recorded yet.',
  noneMore:
    'As soon as robots tell where they are, the server records it, and this page can show it.',
  loading: 'Loading this moment…',
  waits: 'Waiting…',
  empty: 'Nothing was recorded at this moment.',
  emptyMore: (from: string, to: string) => `There is a record from ${from} to ${to}.`,
  toRecord: 'Go to the end of the record',
  failed: (why: string) => `This moment could not be loaded: ${why}.`,
  notLoaded: 'This moment is not loaded.',
  retry: 'Try again',
  offline: 'No connection to the server: only what is loaded already can be shown.',

  range: {
    label: 'Time range',
    chosen: 'Chosen',
    last: { 300_000: 'Last 5 minutes', 3_600_000: 'Last hour', 86_400_000: 'Last day' } as Readonly<
      Record<number, string>
    >,
    from: 'From',
    to: 'To',
    show: 'Show',
    order: 'The end must be at least ten seconds after the beginning.',
    open: 'From – to',
    zoomIn: 'Look closer',
    zoomOut: 'Look wider',
    earlier: 'Earlier',
    later: 'Later',
  },

  line: {
    label: 'Time',
    value: (when: string, ago: string) => `${when}, ${ago}`,
    hint: 'Arrow keys move by a little, Page Up and Page Down by more, Home and End to the ends. With Shift an arrow moves by a fifth of a second. Plus and minus look closer and wider.',
    marks: (warnings: number, errors: number, all: boolean) =>
      `${number(warnings)} ${warnings === 1 ? 'warning' : 'warnings'} and ${number(errors)} ${errors === 1 ? 'error' : 'errors'} in this time${all ? '' : ', the newest only'}.`,
    key: { warn: 'Warning', error: 'Error', beyond: 'Not recorded' },
  },

  play: {
    label: 'Playback',
    play: 'Play',
    pause: 'Pause',
    back: 'One second back',
    forward: 'One second forward',
    speed: 'Speed',
    times: (speed: Speed) => `${String(speed)}×`,
  },

  arena: {
    label: 'Arena as it was',
    picture:
      'Recorded picture of the arena, not live. With the focus here: arrow keys move the view, plus and minus zoom, Home shows everything, Enter selects the robot nearest to the cross, F follows the selected robot. The text below says the same as the picture.',
    summary: (shown: number, moving: number, states: string) =>
      `${robots(shown)[0]?.toUpperCase() ?? ''}${robots(shown).slice(1)} in the record, ${number(moving)} in motion${states === '' ? '' : `; ${states}`}.`,
    gaps: (count: number, who: string) =>
      `Not heard of at this moment: ${count === 1 ? who : `${robots(count)}, ${who}`}.`,
    gap: (id: string, milliseconds: number) => `${id} (${age(milliseconds)} old)`,
    more: 'and others',
    others: (count: number) =>
      `${count === 1 ? 'One more robot' : `${number(count)} more robots`} said nothing around this time.`,
    old: (id: string, milliseconds: number) =>
      `${id}: nothing recorded for ${age(milliseconds)}; it is shown where it was then.`,
  },

  robot: {
    label: 'Robot',
    none: 'No robot',
    choose: 'Choose a robot in the arena or here to see its readings.',
    page: 'All about it now',
    unseen: (id: string) => `${id} is not in the record of this moment.`,
  },

  charts: {
    label: 'Readings',
    titles: { range: 'Range', battery: 'Battery', signal: 'Signal', wheels: 'Wheel duty' },
    none: 'Nothing was told in this time.',
    then: (value: string) => `${value} then`,
    unknown: 'no reading then',
    hint: 'Click in a chart to go to that time.',
  },

  log: {
    label: 'Recorded events',
    level: 'Show events',
    only: (id: string) => `Only ${id}`,
    onlyNone: 'Only the robot',
    none: 'No event in this time.',
    noneOf: 'No event matches.',
    older: 'Older events',
    newer: 'Newest events',
    go: (when: string) => `Go to ${when}`,
    current: 'last event then',
  },
}

/** Short, for a label in the arena. */
export function age(milliseconds: number): string {
  return milliseconds < 10_000
    ? `${(milliseconds / 1_000).toFixed(1)} s`
    : duration(milliseconds / 1_000)
}
