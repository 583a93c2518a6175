/** Every word the control room shows, in one place. */

import type { Kind, Presence, RobotState } from './feed/decode'
import { words } from './strings-account'

export const states: Record<RobotState, string> = {
  INITIALIZING: 'Starting',
  IDLE: 'Idle',
  MOVING: 'Moving',
  SCANNING: 'Scanning',
  CAUTION: 'Caution',
  AVOIDING: 'Avoiding',
  UPDATING: 'Updating',
  ERROR: 'Error',
}

export const presences: Record<Presence, string> = {
  online: 'Online',
  stale: 'Stale',
  offline: 'Offline',
}

export const kinds: Record<Kind, string> = {
  simulated: 'Simulated',
  emulated: 'Emulated',
  physical: 'Physical',
}

const reasons: Readonly<Record<string, string>> = {
  malformed: 'the command could not be read',
  unknown_command: 'it does not know this command',
  out_of_range: 'a value is out of range',
  unsupported: 'it cannot do this',
  no_clock: 'its clock is not set yet',
  estopped: 'it is in emergency stop; re-arm first',
  busy: 'it is busy',
  no_range: 'its range sensor gives no reading',
  low_battery: 'its battery is low',
  blocked: 'the way is blocked',
  interrupted: 'something newer took over',
  link_lost: 'it lost its link',
  timeout: 'it took too long',
  fault: 'it reports a fault',
  no_policy: 'it has no policy of this name',
  bad_policy: 'its policy cannot be read',
  other_observation: 'its policy was trained for another program',
  no_map: 'it has no map',
}

/** Why a robot did not do it; nothing where it gave no reason. */
export function reasonWords(reason: string | null): string {
  return reason === null ? '' : (reasons[reason] ?? reason)
}

const outcomes: Readonly<Record<string, string>> = {
  rejected: 'was refused',
  expired: 'came too late',
  stale: 'came out of order',
  failed: 'failed',
  timeout: 'was not answered',
}

export const text = {
  title: 'Terracrawler',
  room: 'Control room',
  fleet: (name: string) => `Fleet ${name}`,

  connection: {
    label: 'Connection',
    connecting: 'Connecting…',
    live: 'Live',
    silent: 'No news',
    waiting: 'Reconnecting',
    age: (seconds: number) =>
      seconds < 2 ? 'up to date' : `what you see is ${duration(seconds)} old`,
    retryIn: (seconds: number) => (seconds < 1 ? 'trying now' : `next try in ${duration(seconds)}`),
    retry: 'Retry now',
    mismatch: (theirs: number) =>
      `This page does not understand the server's live feed (version ${String(theirs)}). Reload the page.`,
    reload: 'Reload',
  },

  metrics: {
    label: 'Fleet figures',
    online: 'online',
    stale: 'stale',
    offline: 'offline',
    messages: 'messages/s',
    realTime: 'real time',
    realTimeHint: 'Simulated seconds per second',
    answered: 'commands answered',
    ignored: 'frames ignored',
    none: '–',
  },

  stop: {
    label: 'Emergency stop',
    button: 'STOP ALL',
    hint: 'or press Space',
    sending: 'STOPPING…',
    stopped: 'STOPPED',
    again: 'press to send again',
    standing: (still: number, all: number) =>
      still === all
        ? `All ${String(all)} reachable robots stand.`
        : `${String(still)} of ${String(all)} reachable robots stand.`,
    unseen: 'Whether robots stand cannot be seen: there is no live picture.',
    confirmed: (completed: number, expected: number) =>
      completed === expected
        ? `All ${String(expected)} confirmed.`
        : `${String(completed)} of ${String(expected)} confirmed.`,
    latched: 'Motion is refused until you re-arm.',
    notDelivered: (why: string) => `Stop not delivered yet: ${why}. Trying again.`,
    notRearmed: (why: string) => `Not re-armed: ${why}.`,
    rearm: 'Re-arm',
    rearming: 'Re-arming…',
    armed: 'Armed: robots may move.',
    wander: 'Wander',
    wanderHint: 'Let all robots wander',
    announced: 'Emergency stop. All robots are told to stand.',
    announcedArmed: 'Re-armed. Robots stand until told otherwise.',
  },

  list: {
    label: 'Robots',
    search: 'Search robots',
    searchPlaceholder: 'Search',
    filter: 'Show',
    all: 'All robots',
    attention: 'Needs attention',
    count: (shown: number, all: number) =>
      shown === all ? String(all) : `${String(shown)} of ${String(all)}`,
    none: 'No robot matches.',
    empty: 'No robots yet. They appear here as soon as one connects.',
    battery: (percent: number) => `Battery ${String(percent)} %`,
    batteryLow: 'Battery low',
    low: 'low',
    beyond: (fence: string) => `beyond ${fence}`,
    chosen: 'in the selection',
    chosenCount: (count: number) => `${String(count)} selected`,
    command: 'Command',
    chooseNone: 'None',
  },

  arena: {
    label: 'Arena',
    picture: 'Live picture of the arena. The text below says the same in words.',
    fit: 'Show everything',
    zoomIn: 'Zoom in',
    zoomOut: 'Zoom out',
    follow: 'Follow',
    followHint: 'Keep the selected robot in the middle',
    old: (seconds: number) => `As seen ${duration(seconds)} ago: `,
    noWebgl:
      'This browser cannot draw the arena (no WebGL2). The list and all controls work without it.',
    lost: 'The graphics card dropped the picture; it will be back in a moment.',
    legend: 'Legend',
    metres: (length: number) => `${String(length)} m`,
  },

  robot: {
    label: 'Selected robot',
    none: 'Select a robot in the arena or in the list to see and drive it.',
    clear: 'Clear selection',
    page: 'More',
    pageHint: (id: string) => `Everything about ${id}`,
    position: 'Position',
    heading: 'Heading',
    range: 'Range',
    battery: 'Battery',
    behaviour: 'Behaviour',
    firmware: 'Firmware',
    board: 'Board',
    temperature: 'Temperature',
    signal: 'Signal',
    noReading: 'no reading',
    sees: 'Sees',
    seesNothing: 'nothing',
    unknown: '–',
    actions: 'Commands to this robot',
    stop: 'Stop',
    wander: 'Let it wander',
    reset: 'Reset',
    identify: 'Identify',
    capture: 'Take a picture',
    picture: (robot: string, time: string) => `What ${robot} saw, received ${time}`,
    fence: 'Fence',
    beyond: (fence: string) => `On the wrong side of fence ${fence}`,
    within: 'on the right side of all',
    duplicate: 'Two robots seem to use this name.',
  },

  drive: {
    label: 'Drive',
    forward: 'Forward',
    backward: 'Backward',
    left: 'Turn left',
    right: 'Turn right',
    speed: 'Speed',
    ready: 'Hold an arrow key, W A S D or a button. Letting go stops the robot.',
    driving: (v: number, w: number) => `Driving: ${v.toFixed(2)} m/s, ${degrees(w)}°/s`,
    blocked: {
      role: words.need.drive,
      link: 'No connection to the server, so driving is off.',
      stopped: 'Emergency stop is on. Re-arm to drive.',
      offline: 'This robot is offline.',
      stale: 'This robot has not been heard of for a while.',
      gone: 'This robot is no longer in the fleet.',
      starting: 'This robot is still starting.',
      updating: 'This robot is being updated.',
      error: 'This robot reports an error. Reset it to drive.',
    },
  },

  log: {
    label: 'Events',
    empty: 'Nothing yet.',
    levels: 'Show events',
    least: { info: 'All', warn: 'Warnings', error: 'Errors' },
    find: 'Find',
    search: 'Search events',
    none: 'No event matches.',
    moment: 'Show this moment',
    pin: 'Pin to the top',
    unpin: 'Take from the top',
    clear: 'Clear',
    level: { info: 'Info', warn: 'Warning', error: 'Error' },
    commandFailed: (what: string, who: string, why: string) =>
      `“${what}” to ${who} was not sent: ${why}`,
    refused: (what: string, status: string, reason: string | null) =>
      `“${what}” ${outcomes[status] ?? status}${reason === null ? '' : `: ${reasons[reason] ?? reason}`}`,
    sent: (what: string, who: string) => `“${what}” sent to ${who}`,
    all: 'all robots',
    linkLost: 'Connection to the server lost',
    linkBack: 'Connected to the server',
  },

  theme: { label: 'Colours', system: 'System', light: 'Light', dark: 'Dark' },

  tabs: { label: 'Panels', robots: 'Robots', drive: 'Drive', events: 'Events' },

  help: {
    open: 'Keyboard help',
    title: 'Keyboard',
    close: 'Close',
    keys: [
      [
        'Space',
        'Emergency stop of all robots, wherever the focus is. Only a text field takes a space as text: press Esc first.',
      ],
      [
        '↑ ↓ ← →  or  W S A D',
        'Drive the selected robot while held. Letting go, leaving the window or losing the connection stops it.',
      ],
      ['Esc', 'Leaves a text field; otherwise stops driving; pressed again, clears the selection.'],
      [
        '[  and  ]',
        'Previous and next robot; Tab and Shift Tab too, while the drive pad has the keyboard.',
      ],
      ['Enter, on the drive pad', 'Gives the pad the keyboard; Esc takes it back.'],
      [
        '↑ ↓ in the list, Enter',
        'Move through the list; go to the controls of the robot. With Shift, Enter takes it into the selection.',
      ],
      ['/', 'Search robots.'],
      ['+  −  0', 'Zoom in, zoom out, show everything.'],
      [
        '↑ ↓ ← →  in the arena',
        'Move the view. Enter selects the robot nearest to the cross, Shift Enter adds it to the group, Home shows everything.',
      ],
      ['F', 'Follow the selected robot, or stop following.'],
      ['G', 'Go here: then click in the arena, or press Enter, to send the chosen robots there.'],
      ['L', 'Lasso: then draw around robots to choose them; dragging with Shift does the same.'],
      ['?', 'This help.'],
    ],
    note: 'After an emergency stop robots refuse motion until you re-arm. Re-arming does not move them.',
  },
} as const

export function summary(
  online: number,
  stale: number,
  offline: number,
  moving: number,
  counts: ReadonlyMap<RobotState, number>,
): string {
  const all = online + stale + offline
  if (all === 0) return 'No robots.'
  const parts = [`${String(online)} of ${plural(all, 'robot')} online, ${String(moving)} in motion`]
  const inStates = [...counts]
    .filter(([, count]) => count > 0)
    .map(([state, count]) => `${String(count)} ${states[state].toLowerCase()}`)
  if (inStates.length > 0) parts.push(inStates.join(', '))
  if (stale > 0) parts.push(`${String(stale)} stale`)
  if (offline > 0) parts.push(`${String(offline)} offline`)
  return `${parts.join('; ')}.`
}

export function selectedSummary(
  id: string,
  state: RobotState,
  x: number,
  y: number,
  heading: number,
  range: number | null,
): string {
  const seen = range === null ? 'no range reading' : `${millimetres(range)} to what is ahead`
  return `${id}: ${states[state].toLowerCase()} at ${position(x, y)}, heading ${degrees(heading)}°, ${seen}.`
}

/** A thing and where it is, as seen by a robot: positive angles are to its left. */
export function sighting(kind: string, bearing: number): string {
  const off = Math.round((Math.abs(bearing) * 180) / Math.PI)
  if (off === 0) return `${kind} ahead`
  return `${kind} ${String(off)}° ${bearing > 0 ? 'left' : 'right'}`
}

export function position(x: number, y: number): string {
  return `${signed(x, 2)}, ${signed(y, 2)} m`
}

export function degrees(radians: number): string {
  return signed((radians * 180) / Math.PI)
}

export function millimetres(value: number): string {
  return `${(value / 1_000).toFixed(2)} m`
}

export function duration(seconds: number): string {
  if (seconds < 90) return `${String(Math.round(seconds))} s`
  if (seconds < 5_400) return `${String(Math.round(seconds / 60))} min`
  return `${String(Math.round(seconds / 3_600))} h`
}

/** With a true minus sign. */
export function signed(value: number, digits = 0): string {
  // Adding zero turns −0 into 0.
  return (Number(value.toFixed(digits)) + 0).toFixed(digits).replace('-', '−')
}

function plural(count: number, word: string): string {
  return `${String(count)} ${word}${count === 1 ? '' : 's'}`
}
