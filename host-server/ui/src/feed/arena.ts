/** The simulated arena as the hello frame tells it; lengths in metres, angles in radians. */

import type { Fields } from './fields'
import { Refused, array, number, object, oneOf, positive } from './fields'

export type Obstacle =
  | { shape: 'circle'; x: number; y: number; r: number }
  | { shape: 'box'; x: number; y: number; w: number; h: number; theta: number }

/** An obstacle that goes around between its own place and the corners of its path. */
export interface Mover {
  body: Obstacle
  path: readonly (readonly [number, number])[]
}

/** Floor that grips differently. */
export interface Patch {
  x: number
  y: number
  w: number
  h: number
  theta: number
  grip: number
}

export const OBJECT_SHAPES = ['cylinder', 'box', 'ball', 'cone'] as const
export const COLOURS = [
  'red',
  'green',
  'blue',
  'yellow',
  'orange',
  'purple',
  'white',
  'black',
] as const

/** A coloured thing to see. */
export interface Thing {
  shape: (typeof OBJECT_SHAPES)[number]
  colour: (typeof COLOURS)[number]
  x: number
  y: number
  size: number
}

/** Arena centred on the origin. */
export interface Arena {
  width: number
  height: number
  obstacles: Obstacle[]
  movers: Mover[]
  patches: Patch[]
  objects: Thing[]
}

export function readArena(body: Fields): Arena {
  // Left out where there are none.
  const list = (name: string): Fields[] => array(body[name] ?? []).map(object)
  return {
    width: positive(body['width']),
    height: positive(body['height']),
    obstacles: array(body['obstacles']).map((item) => readObstacle(object(item))),
    movers: list('movers').map((mover) => ({
      body: readObstacle(object(mover['body'])),
      path: array(mover['path']).map((corner) => {
        const [x, y] = array(corner)
        return [number(x), number(y)] as const
      }),
    })),
    patches: list('patches').map((patch) => ({ ...readBox(patch), grip: positive(patch['grip']) })),
    objects: list('objects').map(readThing),
  }
}

export function readThing(body: Fields): Thing {
  return {
    shape: oneOf(OBJECT_SHAPES, body['shape']),
    colour: oneOf(COLOURS, body['colour']),
    x: number(body['x']),
    y: number(body['y']),
    size: positive(body['size']),
  }
}

function readBox(body: Fields): Omit<Patch, 'grip'> {
  return {
    x: number(body['x']),
    y: number(body['y']),
    w: positive(body['w']),
    h: positive(body['h']),
    theta: number(body['theta']),
  }
}

export function readObstacle(body: Fields): Obstacle {
  switch (body['shape']) {
    case 'circle':
      return {
        shape: 'circle',
        x: number(body['x']),
        y: number(body['y']),
        r: positive(body['r']),
      }
    case 'box':
      return { shape: 'box', ...readBox(body) }
    default:
      throw new Refused('bad-shape')
  }
}
