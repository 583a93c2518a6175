/** Words of the dashboard and of the list of robots; loaded with them. */

import type { Mode } from './fleet/health'
import type { Show, Sort } from './fleet/order'
import { kinds, presences, states } from './strings'

const number = (value: number): string => value.toLocaleString('en')

export const shows: Record<Show, string> = {
  all: 'All robots',
  attention: 'Needs attention',
  low: 'Low battery',
  fence: 'Beyond a fence',
  ...presences,
  ...kinds,
  initializing: states.INITIALIZING,
  idle: states.IDLE,
  moving: states.MOVING,
  scanning: states.SCANNING,
  caution: states.CAUTION,
  avoiding: states.AVOIDING,
  updating: states.UPDATING,
  error: states.ERROR,
}

export const sorts: Record<Sort, string> = {
  name: 'Name',
  state: 'State',
  battery: 'Battery',
  signal: 'Signal',
  range: 'Range',
  behaviour: 'Behaviour',
  firmware: 'Firmware',
  seen: 'Last heard',
}

export const statuses: Readonly<Record<string, string>> = {
  waiting: 'waiting to be sent',
  pending: 'sent, no answer yet',
  accepted: 'under way',
  completed: 'done',
  rejected: 'refused',
  expired: 'came too late',
  stale: 'out of order',
  failed: 'failed',
  timeout: 'no answer',
  unsent: 'not sent',
}

export const modes: Record<Mode, string> = {
  none: 'No robots',
  simulation: 'Simulation',
  physical: 'Physical robots',
  hybrid: 'Hybrid',
}

export const dashboard = {
  verdictGood: 'All well',
  verdictWatch: 'Worth a look',
  verdictBad: 'Something is wrong',
  goodMore: (online: number) =>
    `${number(online)} ${online === 1 ? 'robot is' : 'robots are'} online, broker and database keep up, nothing asks for attention.`,
  look: 'Show',
  old: (age: string) => `What you see is ${age} old.`,
  fleet: 'Fleet',
  of: (all: number) => `of ${number(all)}`,
  byState: 'By state',
  noStates: 'No robot is there to have a state.',
  commands: 'Commands',
  commandsLead: 'of the last five minutes',
  success: 'completed',
  none: 'No command was answered lately.',
  median: 'half of them within',
  slow: '95 % within',
  open: 'Answered since the server started',
  server: 'Server',
  broker: 'Broker',
  database: 'Database',
  simulation: 'Simulation',
  mode: 'Mode',
  version: 'Version',
  connected: 'connected',
  lost: 'not connected',
  unknown: 'not known',
  keepsUp: (queued: number) => (queued === 0 ? 'keeps up' : `keeps up, ${number(queued)} wait`),
  behind: (queued: number) => `is behind by ${number(queued)} samples`,
  brokerMore: (connections: number) => `${number(connections)} connections`,
  losses: (count: number) =>
    `lost ${count === 1 ? 'once' : `${number(count)} times`} since the start`,
  free: (free: string) => `${free} free`,
  pace: (factor: number) => `${factor.toFixed(2)}× real time`,
  noSimulation: 'none in this process',
  ended: 'has ended',
  figuresFailed: (why: string) => `The server’s figures could not be read: ${why}.`,
  attention: 'Needs attention',
  nobody: 'No robot needs attention.',
  more: (count: number) => `and ${number(count)} more`,
  messages: 'messages/s',
  batteries: 'Lowest batteries',
  noBatteries: 'No robot has told its battery yet.',
}

export const robots = {
  search: 'Search robots',
  show: 'Show',
  sort: 'Sort by',
  ascending: 'Rising',
  descending: 'Falling',
  as: 'View',
  table: 'Table',
  cards: 'Cards',
  count: (shown: number, all: number) =>
    shown === all ? `${number(all)} robots` : `${number(shown)} of ${number(all)} robots`,
  none: 'No robot matches.',
  noneMore: 'Show all robots',
  empty: 'No robots yet. They appear here as soon as one connects.',
  loading: 'Waiting for the server…',
  selected: (count: number) => `${number(count)} selected`,
  selectAll: 'Select all shown',
  selectNone: 'Select none',
  select: (id: string) => `Select ${id}`,
  act: 'Command the selection',
  columns: 'Robots',
  name: 'Name',
  position: 'Position',
  noReading: 'no reading',
  never: 'never',
  ago: (age: string) => `${age} ago`,
  now: 'now',
  sortBy: (column: string) => `Sort by ${column}`,
}
