import { describe, expect, it } from 'vitest'
import text from '../../interface.json?raw'
import { COLOURS } from '../../src/feed/arena'
import type { Draft } from '../../src/fleet/world'
import {
  FIRST_DRAFT,
  KINDS,
  MOST_BOOKMARKS,
  MOST_ROBOTS,
  arrows,
  decimal,
  dropOf,
  droppedItem,
  fieldsOf,
  freeName,
  itemOf,
  moved,
  nameTrouble,
  placeOf,
  previewArena,
  stepOf,
  whole,
} from '../../src/fleet/world'
import { itemWords, scenarios } from '../../src/strings-world'

const { messages } = JSON.parse(text) as {
  messages: Record<string, { $defs: Record<string, unknown> }>
}
/** What the server says of commands to the simulated world. */
const DEFINITIONS = messages['simulator-command']?.$defs ?? {}

const draft = (change: Partial<Draft>): Draft => ({ ...FIRST_DRAFT, x: '1', y: '-0,5', ...change })

function itemFrom(change: Partial<Draft>) {
  const found = itemOf(draft(change))
  if ('bad' in found) throw new Error(`${found.bad} is bad`)
  return found.item
}

describe('what is put into the world', () => {
  it('is told as the live feed tells of it', () => {
    expect(dropOf(itemFrom({ kind: 'post', radius: '0.2' }))).toEqual({
      command: 'drop',
      obstacle: { shape: 'circle', x: 1, y: -0.5, r: 0.2 },
    })
    expect(dropOf(itemFrom({ kind: 'cube', size: '0,3', colour: 'blue' }))).toEqual({
      command: 'drop',
      object: { shape: 'box', colour: 'blue', x: 1, y: -0.5, size: 0.3 },
    })
    const wall = itemFrom({ kind: 'wall', length: '2', width: '0.1', turn: '90' })
    expect(wall).toMatchObject({ obstacle: { shape: 'box', w: 2, h: 0.1 } })
    expect('obstacle' in wall && wall.obstacle.shape === 'box' && wall.obstacle.theta).toBeCloseTo(
      Math.PI / 2,
    )
    expect(placeOf(wall)).toEqual({ x: 1, y: -0.5 })
  })

  it('is made of the fields and words that the server takes', () => {
    const known = JSON.stringify(DEFINITIONS)
    for (const kind of KINDS) {
      const item = itemFrom({ kind })
      const body = 'obstacle' in item ? item.obstacle : item.object
      for (const word of [...Object.keys(body), body.shape]) expect(known).toContain(`"${word}"`)
    }
    for (const colour of COLOURS) expect(known).toContain(`"${colour}"`)
  })

  it('names the first field that is no number, or out of bounds', () => {
    expect(itemOf(draft({ x: '' }))).toEqual({ bad: 'x' })
    expect(itemOf(draft({ kind: 'post', radius: '0' }))).toEqual({ bad: 'radius' })
    expect(itemOf(draft({ kind: 'ball', size: 'big' }))).toEqual({ bad: 'size' })
    expect(itemOf(draft({ turn: '361' }))).toEqual({ bad: 'turn' })
    // Fields of another kind do not matter.
    expect(itemOf(draft({ kind: 'ball', radius: '', turn: 'x' }))).toHaveProperty('item')
    for (const kind of KINDS) expect(fieldsOf(kind).length).toBeGreaterThan(0)
  })

  it('is said in words', () => {
    expect(itemWords(itemFrom({ kind: 'wall', turn: '-45' }))).toBe(
      'box, 0.5 × 0.2 m, turned −45°, at 1.00, −0.50',
    )
    expect(itemWords(itemFrom({ kind: 'cone', colour: 'red', size: '1' }))).toBe(
      'red cone, 1 m, at 1.00, −0.50',
    )
    expect(itemWords(itemFrom({ kind: 'post', radius: '10' }))).toContain('radius 10 m')
    expect(scenarios.facts(8, 2.4, 1, 0, 2)).toBe('8 × 2.4 m, 1 obstacle, 2 things that move')
  })

  it('is listed even where a newer server has shapes that this page does not know', () => {
    const ball = { shape: 'ball', colour: 'red', x: 0, y: 0, size: 0.1 } as const
    expect(droppedItem({ id: 1, object: ball })).toEqual({ object: ball })
    expect(droppedItem({ id: 2 })).toBe(null)
    expect(droppedItem({ id: 3, object: { ...ball, shape: 'torus' as 'ball' } })).toBe(null)
    expect(previewArena({ width: 2, height: 3, obstacles: [] })?.height).toBe(3)
    expect(previewArena({ width: -2 })).toBe(null)
    expect(previewArena(null)).toBe(null)
  })
})

describe('numbers', () => {
  it('are read as people write them', () => {
    expect(decimal(' −1,5 ', -2, 2)).toBe(-1.5)
    for (const text of ['', 'x', '3', 'Infinity', '1 2']) expect(decimal(text, -2, 2)).toBe(null)
    expect(whole('', 1, 9)).toBe(undefined)
    expect(whole(' 7 ', 1, 9)).toBe(7)
    for (const text of ['0', '10', '1.5', '-1', '1e1', 'x']) expect(whole(text, 1, 9)).toBe(null)
    expect(whole(String(MOST_ROBOTS + 1), 1, MOST_ROBOTS)).toBe(null)
  })
})

describe('arrow keys on the map', () => {
  const arena = { width: 10, height: 4 }

  it('move the place by a hundredth of the arena, farther with Shift, and not through walls', () => {
    expect(stepOf(arena)).toBe(0.1)
    expect(stepOf({ width: 480, height: 10 })).toBe(5)
    expect(moved(null, 'ArrowRight', false, arena)).toEqual({ x: 0.1, y: 0 })
    expect(moved({ x: 0.1, y: 0 }, 'ArrowDown', true, arena)).toEqual({ x: 0.1, y: -0.5 })
    expect(moved({ x: 0, y: 1.95 }, 'ArrowUp', false, arena)).toEqual({ x: 0, y: 2 })
    expect(moved({ x: 99, y: 0 }, 'ArrowLeft', false, arena)).toEqual({ x: 5, y: 0 })
  })

  it('leave other keys alone', () => {
    expect(moved(null, 'a', false, arena)).toBe(null)
    expect(moved(null, 'Tab', false, arena)).toBe(null)
  })
})

describe('names of bookmarks', () => {
  const schema = DEFINITIONS['SnapshotName'] as { pattern: string; maxLength: number }

  it('are checked as the schema says', () => {
    const known = new RegExp(schema.pattern)
    const most = 'x'.repeat(schema.maxLength)
    for (const name of ['a', '1', '-', 'before-the-door', most, '', 'A', 'a b', 'ä', `${most}x`]) {
      const good = known.test(name) && name.length <= schema.maxLength
      expect([name, nameTrouble(name, [])]).toEqual([name, good ? null : 'alphabet'])
    }
    expect(nameTrouble('here', ['there', 'here'])).toBe('taken')
  })

  it('are offered so that nobody has them yet', () => {
    expect(freeName('arena', [])).toBe('arena-1')
    expect(freeName('arena', ['arena-1', 'arena-2', 'arena-4'])).toBe('arena-3')
    const taken: string[] = []
    for (let i = 0; i < MOST_BOOKMARKS; i++) {
      const name = freeName(`My Scenario ${'long '.repeat(9)}`, taken)
      expect(nameTrouble(name, taken)).toBe(null)
      taken.push(name)
    }
  })
})

describe('robots on a preview', () => {
  it('are one path, each pointing where it looks', () => {
    const path = arrows(
      [
        { x: 1, y: 2, theta: 0 },
        { x: 0, y: 0, theta: Math.PI / 2 },
      ],
      1,
    )
    expect(path.match(/M/g)).toHaveLength(2)
    expect(path).toMatch(/^M2\.000 2\.000L/)
    expect(path).toMatch(/M0\.000 1\.000L/)
    expect(arrows([], 1)).toBe('')
  })
})
