/** Putting things into the simulated world, and keeping moments of it: what may be sent. */

import type { DroppedItem, SimulatorCommand } from '../api-types'
import type { Arena, Obstacle, Thing } from '../feed/arena'
import { COLOURS, readArena, readObstacle, readThing } from '../feed/arena'
import { object } from '../feed/fields'

export interface Place {
  x: number
  y: number
}

/** What can be put into the world; a `wall` is an obstacle, a `cube` a coloured box. */
export const KINDS = ['post', 'wall', 'cylinder', 'cube', 'ball', 'cone'] as const
export type ItemKind = (typeof KINDS)[number]
export type Item = { obstacle: Obstacle } | { object: Thing }

/** Lengths in metres that can be put in; the server knows what fits. */
const LENGTHS = { least: 0.02, most: 100 }
export const TURN = { least: -360, most: 360 }
export const FARTHEST = 250

/** Fields of the form, as they are written. */
export interface Draft {
  kind: ItemKind
  radius: string
  length: string
  width: string
  /** Degrees, anticlockwise. */
  turn: string
  size: string
  colour: Thing['colour']
  x: string
  y: string
}
export type DraftField = Exclude<keyof Draft, 'kind' | 'colour'>

export const FIRST_DRAFT: Draft = {
  kind: 'wall',
  radius: '0.15',
  length: '0.5',
  width: '0.2',
  turn: '0',
  size: '0.2',
  colour: COLOURS[0],
  x: '',
  y: '',
}

/** The fields that say how large, and how turned. */
export function fieldsOf(kind: ItemKind): readonly DraftField[] {
  if (kind === 'post') return ['radius']
  return kind === 'wall' ? ['length', 'width', 'turn'] : ['size']
}

/** Least and most of a field. */
export function boundsOf(field: DraftField): { least: number; most: number } {
  if (field === 'turn') return TURN
  return field === 'x' || field === 'y' ? { least: -FARTHEST, most: FARTHEST } : LENGTHS
}

/** As people write numbers; null when it is none within the bounds. */
export function decimal(text: string, least: number, most: number): number | null {
  const written = text.trim().replace(',', '.').replace('−', '-')
  const value = Number(written)
  return written !== '' && Number.isFinite(value) && value >= least && value <= most ? value : null
}

/** A whole number from `least` on; `undefined` when nothing is written, `null` when it is none. */
export function whole(text: string, least: number, most: number): number | null | undefined {
  const written = text.trim()
  if (written === '') return undefined
  const value = Number(written)
  return /^\d{1,15}$/.test(written) && value >= least && value <= most ? value : null
}

/** What the form describes, or the first field that keeps it from being something. */
export function itemOf(draft: Draft): { item: Item } | { bad: DraftField } {
  const read: Partial<Record<DraftField, number>> = {}
  for (const field of [...fieldsOf(draft.kind), 'x', 'y'] as const) {
    const { least, most } = boundsOf(field)
    const value = decimal(draft[field], least, most)
    if (value === null) return { bad: field }
    read[field] = value
  }
  const { radius = 0, length = 0, width = 0, turn = 0, size = 0, x = 0, y = 0 } = read
  switch (draft.kind) {
    case 'post':
      return { item: { obstacle: { shape: 'circle', x, y, r: radius } } }
    case 'wall': {
      const theta = (turn * Math.PI) / 180
      return { item: { obstacle: { shape: 'box', x, y, w: length, h: width, theta } } }
    }
    default: {
      const shape = draft.kind === 'cube' ? 'box' : draft.kind
      return { item: { object: { shape, colour: draft.colour, x, y, size } } }
    }
  }
}

export function placeOf(item: Item): Place {
  const { x, y } = 'obstacle' in item ? item.obstacle : item.object
  return { x, y }
}

export const dropOf = (item: Item): SimulatorCommand => ({ command: 'drop', ...item })

/** What was dropped, as it can be drawn and named; null when this page does not know its shape. */
export function droppedItem(dropped: DroppedItem): Item | null {
  try {
    if (dropped.obstacle !== undefined) return { obstacle: readObstacle(object(dropped.obstacle)) }
    return { object: readThing(object(dropped.object)) }
  } catch {
    return null
  }
}

/** The arena of a preview; null when it cannot be read. */
export function previewArena(arena: unknown): Arena | null {
  try {
    return readArena(object(arena))
  } catch {
    return null
  }
}

/** How far one press of an arrow moves a place: about a hundredth of the arena. */
export function stepOf(arena: Pick<Arena, 'width' | 'height'>): number {
  const longest = Math.max(arena.width, arena.height)
  return [0.05, 0.1, 0.25, 0.5, 1, 2.5].find((step) => step * 100 >= longest) ?? 5
}

const ARROWS: Readonly<Record<string, readonly [number, number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
}

/** Where an arrow moves a place; null for other keys. It stays within the walls. */
export function moved(
  place: Place | null,
  key: string,
  far: boolean,
  arena: Pick<Arena, 'width' | 'height'>,
): Place | null {
  const way = ARROWS[key]
  if (way === undefined) return null
  const step = stepOf(arena) * (far ? 5 : 1)
  const within = (value: number, side: number): number =>
    round(Math.min(side / 2, Math.max(-side / 2, value)))
  const from = place ?? { x: 0, y: 0 }
  return {
    x: within(from.x + way[0] * step, arena.width),
    y: within(from.y + way[1] * step, arena.height),
  }
}

/** To the centimetre, which is closer than a hand is. */
export function round(value: number): number {
  return Math.round(value * 100) / 100 + 0
}

/** As many robots as a world can have. */
export const MOST_ROBOTS = 65_535

/** As many bookmarks as the server keeps. */
export const MOST_BOOKMARKS = 16
const LONGEST_NAME = 32

export type NameTrouble = 'alphabet' | 'taken'

/** What is wrong with the name of a bookmark; null when nothing is. */
export function nameTrouble(name: string, taken: readonly string[]): NameTrouble | null {
  if (!/^[a-z0-9-]{1,32}$/.test(name)) return 'alphabet'
  return taken.includes(name) ? 'taken' : null
}

/** A name that nobody has yet: of the scenario and a number. */
export function freeName(scenario: string, taken: readonly string[]): string {
  const letters = scenario.toLowerCase().replace(/[^a-z0-9-]+/g, '-')
  for (let count = 1; ; count++) {
    const end = `-${String(count)}`
    const name = `${letters.slice(0, LONGEST_NAME - end.length)}${end}`
    if (!taken.includes(name)) return name
  }
}

/**
 * Arrows at all the poses, as one path: a thousand elements would cost the browser more than the
 * picture is worth.
 */
export function arrows(poses: readonly (Place & { theta: number })[], size: number): string {
  const corners = [
    [1, 0],
    [-0.7, 0.7],
    [-0.35, 0],
    [-0.7, -0.7],
  ] as const
  return poses
    .map(({ x, y, theta }) => {
      const [c, s] = [Math.cos(theta) * size, Math.sin(theta) * size]
      const points = corners.map(
        ([a, b]) => `${(x + a * c - b * s).toFixed(3)} ${(y + a * s + b * c).toFixed(3)}`,
      )
      return `M${points.join('L')}Z`
    })
    .join('')
}
