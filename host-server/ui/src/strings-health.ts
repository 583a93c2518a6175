/** Words of the way to the pages and of the badge that says how things are; part of the first view. */

import type { Inner, Place } from './view'
import { duration } from './strings'

export const places: Record<Place | Inner, string> = {
  room: 'Live',
  dashboard: 'Dashboard',
  robots: 'Robots',
  command: 'Command',
  simulation: 'Simulation',
  history: 'History',
  experiments: 'Experiments',
  updates: 'Updates',
  'what-if': 'What if',
}

export const nav = { label: 'Pages', skip: 'Skip to the content' }

const count = (number: number, one: string, many: string): string =>
  number === 1 ? `One robot ${one}` : `${number.toLocaleString('en')} robots ${many}`

export const health = {
  label: 'How things are',
  asking: 'Connecting…',
  good: 'All well',
  several: (number: number) => `${String(number)} to look at`,
  /** Short enough for the badge, where one thing is wrong. */
  single: {
    link: 'No connection',
    silent: 'No news',
    broker: 'Broker lost',
    simulation: 'Simulation ended',
    journal: 'Commands not kept',
    audit: 'Audit log not kept',
    stop: 'Emergency stop on',
    empty: 'No robots',
    none: 'No robot online',
    fence: 'Beyond a fence',
    twins: 'Two robots, one id',
    space: 'Little disk space',
    dropped: 'Telemetry lost',
    damaged: 'Damaged records',
    queued: 'Database is slow',
    commands: 'Commands fail',
  } as Readonly<Record<string, string>>,
  noLink: (age: number) => `No connection to the server: what you see is ${duration(age)} old.`,
  silent: (age: number) => `The server has said nothing for ${duration(age)}.`,
  noBroker: 'The server has lost its broker: commands reach no robot.',
  noSimulation: 'The simulated world has ended.',
  noJournal:
    'Commands cannot be written down: only stops and motion are taken. Is the server’s disk full?',
  noAudit:
    'The audit log cannot be written: its lines wait in memory. Is the disk full, or a database away?',
  stopped: 'Emergency stop is on: robots refuse motion until somebody re-arms.',
  error: (number: number) => `${count(number, 'reports', 'report')} an error.`,
  empty: 'No robot has ever connected.',
  noneOnline: 'No robot is online.',
  stale: (number: number) => `${count(number, 'has', 'have')} not been heard of for a few seconds.`,
  offline: (number: number) => `${count(number, 'is', 'are')} offline.`,
  fence: (number: number) => `${count(number, 'is', 'are')} on the wrong side of a fence.`,
  low: (number: number) => `${count(number, 'has', 'have')} a low battery.`,
  twins: (number: number) =>
    `Under ${number === 1 ? 'one id' : `${String(number)} ids`} two robots seem to speak.`,
  space: (bytes: number) => `Only ${size(bytes)} left on the disk of the records.`,
  dropped: (number: number) =>
    `${number.toLocaleString('en')} telemetry samples were not kept: the database could not follow.`,
  damaged: (number: number) =>
    `${number.toLocaleString('en')} blocks of the history could not be read.`,
  queued: (number: number) =>
    `${number.toLocaleString('en')} telemetry samples wait to be written.`,
  commands: (share: number) =>
    `Only ${String(Math.round(share * 100))} % of the last commands were completed.`,
}

/** Bytes, for people. */
export function size(bytes: number): string {
  const units = ['B', 'kB', 'MB', 'GB', 'TB']
  let [value, unit] = [bytes, 0]
  while (value >= 1_000 && unit < units.length - 1) [value, unit] = [value / 1_000, unit + 1]
  return `${value >= 100 || unit === 0 ? value.toFixed(0) : value.toFixed(1)} ${units[unit] ?? ''}`
}
