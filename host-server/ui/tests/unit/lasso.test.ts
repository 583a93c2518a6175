import { describe, expect, it } from 'vitest'
import type { Point } from '../../src/arena/lasso'
import { Lasso, inPolygon } from '../../src/arena/lasso'
import { SPACING, assign, hexagons } from '../../src/arena/spread'

const square: Point[] = [
  [0, 0],
  [10, 0],
  [10, 10],
  [0, 10],
]

describe('a line around robots', () => {
  it.each([
    [5, 5, true],
    [0.1, 9.9, true],
    [10.1, 5, false],
    [-1, -1, false],
    [5, -0.1, false],
  ])('at %d, %d: %s', (x, y, inside) => {
    expect(inPolygon(square, x, y)).toBe(inside)
  })

  it('may be hollow', () => {
    const letter: Point[] = [...square.slice(0, 3), [7, 10], [7, 3], [3, 3], [3, 10], [0, 10]]
    expect(inPolygon(letter, 5, 6)).toBe(false)
    expect(inPolygon(letter, 1, 6)).toBe(true)
  })

  it('may cross itself', () => {
    const bow: Point[] = [
      [0, 0],
      [10, 10],
      [10, 0],
      [0, 10],
    ]
    expect(inPolygon(bow, 1, 5)).toBe(true)
    expect(inPolygon(bow, 5, 1)).toBe(false)
  })

  it('encloses nothing before it has three points', () => {
    expect(inPolygon([], 0, 0)).toBe(false)
    const lasso = new Lasso([0, 0])
    lasso.extend([10, 0])
    expect(lasso.holds(5, 0)).toBe(false)
    lasso.extend([5, 10])
    expect(lasso.holds(5, 3)).toBe(true)
  })

  it('skips what is too near, and is bounded', () => {
    const lasso = new Lasso([0, 0])
    expect(lasso.extend([1, 1])).toBe(false)
    for (let i = 1; i < 5_000; i++) lasso.extend([10 * i, 0])
    expect(lasso.points.length).toBe(2_000)
  })
})

describe('places around a point', () => {
  it.each([1, 2, 7, 19, 61])('are %d, apart from each other and close to it', (count) => {
    const places = hexagons(count)
    expect(places).toHaveLength(count)
    for (const [i, a] of places.entries()) {
      for (const b of places.slice(i + 1)) {
        expect(Math.hypot(a[0] - b[0], a[1] - b[1])).toBeGreaterThan(SPACING * 0.99)
      }
    }
    const rings = Math.ceil((Math.sqrt(12 * count - 3) - 3) / 6)
    for (const [x, y] of places) {
      expect(Math.hypot(x, y)).toBeLessThanOrEqual(SPACING * rings + 1e-9)
    }
  })

  it('one robot goes exactly where it is sent', () => {
    expect(assign([{ id: 'a', x: 5, y: 5 }], 1.23456, -2, null)).toEqual([
      { id: 'a', x: 1.235, y: -2 },
    ])
  })

  it('gives each robot a place of its own, near ones first', () => {
    const robots = [
      { id: 'far', x: 3, y: 0 },
      { id: 'there', x: 0, y: 0 },
    ]
    const places = assign(robots, 0, 0, null)
    expect(places[0]).toEqual({ id: 'there', x: 0, y: 0 })
    expect(places[1]?.id).toBe('far')
    expect(places[1]?.x).toBeCloseTo(SPACING, 3)
  })

  it('keeps places off the walls', () => {
    const robots = Array.from({ length: 9 }, (_, i) => ({ id: String(i), x: 0, y: 0 }))
    for (const { x, y } of assign(robots, 2, -1, { width: 4, height: 2 })) {
      expect(Math.abs(x)).toBeLessThanOrEqual(1.8)
      expect(Math.abs(y)).toBeLessThanOrEqual(0.8)
    }
  })
})
