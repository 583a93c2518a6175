/** Words of the simulated world: its scenarios, what is put into it, its bookmarks; loaded with its page. */

import type { Obstacle, Thing } from './feed/arena'
import type { DraftField, Item, ItemKind, NameTrouble } from './fleet/world'

const count = (value: number): string => value.toLocaleString('en')
const metres = (value: number): string => value.toFixed(2).replace(/\.?0+$/, '')
const many = (value: number, one: string, more: string): string =>
  value === 1 ? `1 ${one}` : `${count(value)} ${more}`

/** Metres, with a true minus. */
const coordinate = (value: number): string => value.toFixed(2).replace('-', '−')

export const scenarios = {
  title: 'Scenarios',
  now: 'Scenario',
  running: 'running now',
  choose: 'Choose a scenario',
  none: 'This server has no scenarios built in.',
  facts: (width: number, height: number, obstacles: number, objects: number, movers: number) =>
    [
      `${metres(width)} × ${metres(height)} m`,
      obstacles > 0 ? many(obstacles, 'obstacle', 'obstacles') : '',
      movers > 0 ? many(movers, 'thing that moves', 'things that move') : '',
      objects > 0 ? many(objects, 'coloured object', 'coloured objects') : '',
    ]
      .filter((part) => part !== '')
      .join(', '),
  robots: (value: number) => many(value, 'robot', 'robots'),
  robotsField: 'Robots',
  seedField: 'Seed',
  usual: (value: string) => `usually ${value}`,
  badRobots: (most: number) => `A whole number from 1 to ${count(most)}.`,
  badSeed: 'A whole number from 0 up, 15 digits at most.',
  preview: (name: string, robots: number, seed: string) =>
    `How ${name} begins, with ${many(robots, 'robot', 'robots')} and seed ${seed}`,
  previewOf: (robots: string, seed: string) => `${robots}, seed ${seed}`,
  drawn: (value: number) => `The first ${count(value)} of them are drawn.`,
  noPreview: 'No preview',
  looking: 'Building the preview…',
  unreadable: 'This page cannot draw it; the server may be newer than the page.',
  load: (name: string) => `Load ${name}`,
  slide: (name: string) => `Slide to load ${name}; the running world ends`,
  ends: 'The running world ends: its robots begin anew, and what was dropped is gone. Bookmarks stay.',
  loaded: (name: string, robots: number) =>
    `${name} is loaded, with ${many(robots, 'robot', 'robots')}.`,
}

export const things = {
  title: 'Things in the world',
  lead: 'Press a place on the map to put it there. With the focus on the map, arrow keys move it (Shift: farther) and Enter puts it there.',
  map: 'Map of the world: clicking puts the thing there; arrow keys move it, Shift moves it farther, Enter puts it there',
  what: 'What',
  groups: { obstacle: 'Obstacles', object: 'Coloured objects' },
  kinds: {
    post: 'Round post',
    wall: 'Box to go around',
    cylinder: 'Cylinder',
    cube: 'Cube',
    ball: 'Ball',
    cone: 'Cone',
  } satisfies Record<ItemKind, string>,
  fields: {
    radius: 'Radius, m',
    length: 'Length, m',
    width: 'Width, m',
    turn: 'Turn, °',
    size: 'Size, m',
    x: 'x, m',
    y: 'y, m',
  } satisfies Record<DraftField, string>,
  colour: 'Colour',
  colours: {
    red: 'red',
    green: 'green',
    blue: 'blue',
    yellow: 'yellow',
    orange: 'orange',
    purple: 'purple',
    white: 'white',
    black: 'black',
  } satisfies Record<Thing['colour'], string>,
  put: 'Put it there',
  bad: (field: string, least: number, most: number) =>
    `${field}: a number from ${String(least).replace('-', '−')} to ${String(most)}.`,
  done: (what: string) => `Put into the world: ${what}.`,
  refused: (why: string) => `It was not put there: ${why}.`,
  dropped: 'Put in by hand',
  none: 'Nothing yet. What you put in stays until it is taken away or the world begins again.',
  take: 'Take away',
  takeOf: (what: string) => `Take away: ${what}`,
  taken: (what: string) => `Taken away: ${what}.`,
  notTaken: (why: string) => `Not taken away: ${why}.`,
  unknown: (id: number) => `Something that this page does not know (${String(id)})`,
}

const shapes: Record<Thing['shape'], string> = {
  cylinder: 'cylinder',
  box: 'cube',
  ball: 'ball',
  cone: 'cone',
}

function obstacleWords(obstacle: Obstacle): string {
  if (obstacle.shape === 'circle') return `round post, radius ${metres(obstacle.r)} m`
  const turn = Math.round((obstacle.theta * 180) / Math.PI)
  const turned = turn === 0 ? '' : `, turned ${String(turn).replace('-', '−')}°`
  return `box, ${metres(obstacle.w)} × ${metres(obstacle.h)} m${turned}`
}

/** A thing and where it stands. */
export function itemWords(item: Item): string {
  const what =
    'obstacle' in item
      ? obstacleWords(item.obstacle)
      : `${things.colours[item.object.colour]} ${shapes[item.object.shape]}, ${metres(item.object.size)} m`
  const { x, y } = 'obstacle' in item ? item.obstacle : item.object
  return `${what}, at ${coordinate(x)}, ${coordinate(y)}`
}

export const bookmarks = {
  title: 'Bookmarks',
  lead: 'A bookmark keeps this moment of the world, to come back to while the server runs.',
  name: 'Name',
  keep: 'Keep this moment',
  kept: (name: string) => `This moment is kept as ${name}.`,
  trouble: {
    alphabet: 'Small letters, digits and dashes, 32 at most.',
    taken: 'There is a bookmark of this name: forget it first, or choose another.',
  } satisfies Record<NameTrouble, string>,
  full: (most: number) => `${String(most)} bookmarks are kept; forget one to keep another.`,
  none: 'None yet.',
  columns: {
    name: 'Name',
    time: 'Time in the world',
    robots: 'Robots',
    scenario: 'Scenario',
    made: 'Kept',
    actions: 'Actions',
  },
  restore: 'Go back',
  restoreOf: (name: string) => `Go back to ${name}`,
  comes:
    'Comes back: where robots are and how they move, batteries and temperatures, faults, what was put in, parameters kept in flash.',
  not: 'Does not: what robots were doing. Their programs start anew as after a power cut, and they stand idle until told something.',
  slide: (name: string) => `Slide to go back to ${name}; the world as it is now is lost`,
  slideWords: (name: string) => `Go back to ${name}`,
  later: 'Not now',
  restored: (name: string, robots: number) =>
    `The world is as it was at ${name}: ${many(robots, 'robot stands', 'robots stand')} idle.`,
  forget: 'Forget',
  forgetOf: (name: string) => `Forget ${name}`,
  ask: (name: string) => `Forget ${name}? Nobody can go back to it then.`,
  forgotten: (name: string) => `${name} is forgotten.`,
  failed: (why: string) => `Not done: ${why}.`,
}
