/** Words of the arena and of driving; those shared with other views are in `strings.ts`. */

import { millimetres } from './strings'

export const words = {
  picture:
    'Live picture of the arena. With the focus here: arrow keys move the view, plus and minus zoom, Home shows everything, Enter selects the robot nearest to the cross, Shift and Enter adds it to the group, G sends robots to the cross. The text below says the same as the picture.',
  tools: 'Arena tools',
  follow: 'Follow',
  followHint: 'Keep the selected robot in the middle (F)',
  lasso: 'Lasso',
  lassoHint: 'Draw around robots to choose them (L, or drag with Shift)',
  go: 'Go here',
  goHint: 'Then click where the chosen robots shall go (G)',
  goFirst: 'Choose a robot or a group first.',
  goMany: (most: number) => `No more than ${String(most)} robots can be sent to one point.`,
  fences: 'Fences',
  fencesHint: 'Where robots are to stay in or out of',
  fencesFailed: 'The part of the page that shows fences could not be loaded: reload the page.',
  layers: 'Layers',
  cones: 'Sensor cones',
  trails: 'Trails',
  map: 'Map and plan',
  mapHint: 'What the selected robot has noticed around itself, and the way that it has planned',
  mapFailed: 'The part of the page that shows maps could not be loaded: reload the page.',
  twin: 'Twin',
  twinHint: 'Where the selected robot is by what its motors did, and where it will be in a second',
  twinFailed: 'The part of the page that shows twins could not be loaded: reload the page.',
  putIn: 'Put things in…',
  putInHint: 'Obstacles and coloured objects, on the page of the simulation',
  extent: { all: 'All', selected: 'Selected', none: 'None' },
  group: (count: number) => `${String(count)} robot${count === 1 ? '' : 's'} chosen`,
  ungroup: 'Clear the choice',
  nobody: 'No robot is inside the line.',
  aim: (count: number) =>
    `Click where ${count === 1 ? 'the robot' : `${String(count)} robots`} shall go. Esc: not now.`,
  draw: 'Draw a line around robots. Esc: not now.',
  reading: (id: string, range: number | null) =>
    range === null ? id : `${id} · ${millimetres(range)}`,
  empty: 'No robots yet. They appear here as soon as one connects.',
  connecting: 'Waiting for the live picture…',
  sent: (count: number, x: string) =>
    `${count === 1 ? '“goto”' : `“goto” for ${String(count)} robots`} sent: ${x}`,
  skipped: (count: number) =>
    `${String(count)} ${count === 1 ? 'is' : 'are'} not reachable and ${count === 1 ? 'was' : 'were'} left out`,
  reached: 'reached its goal',
  goals: (going: number, reached: number, failed: number) =>
    [
      going > 0 ? `${String(going)} on the way` : '',
      reached > 0 ? `${String(reached)} arrived` : '',
      failed > 0 ? `${String(failed)} failed` : '',
    ]
      .filter((part) => part !== '')
      .join(', '),
  goalsLabel: 'Goals: ',
  clusters: 'Numbers count robots that are too close together to draw; zoom in to see them.',
  minimap: 'Overview of the arena: click or drag to move the view',
  legend: {
    cells: 'Grid lines every metre; the stronger ones border the cells in which robots listen.',
    cone: 'A cone reaches as far as the range sensor sees; its far edge is the echo.',
    trail: 'A trail is where a robot was in the last ten seconds.',
    ring: 'A whole ring: selected to drive. A dashed ring: chosen as a group.',
    patch: 'Hatched floor grips differently; a dashed way is that of something that moves.',
    fence:
      'A fence has its hatching where robots must not be; a whole line stops them, a dashed one warns.',
    map: 'The map of a robot: filled cells are blocked, hollow ones were looked through since. Dots lead along its planned way; a ring is where it drives to now, a ring with a cross its goal.',
    twin: 'The twin of a robot: a dashed outline where it is by what its motors did and a tracker saw, a dotted one where it will be in a second; the discs hold nineteen of twenty.',
    stale: 'Hatched: not heard of for a while. Hollow: offline.',
  },
  pad: {
    capture: 'Press Enter to drive with the keyboard.',
    captured: 'Tab: next robot. Esc: leave the pad.',
    stick: (name: string) => `Gamepad: ${name}`,
    stickWaits: 'Let go of the stick once before it drives.',
    stickHelp: 'Stick drives; A stops the robot, B stops all, shoulder buttons change robots.',
  },
} as const
