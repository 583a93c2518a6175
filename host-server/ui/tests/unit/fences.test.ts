import { describe, expect, it } from 'vitest'
import type { Point } from '../../src/arena/lasso'
import { Pen } from '../../src/fences/pen'
import type { Flaw } from '../../src/fences/shape'
import { flawOf, isTangled, readCorners, rounded, written } from '../../src/fences/shape'
import { labelOf, words } from '../../src/strings-fences'

const square: Point[] = [
  [0, 0],
  [2, 0],
  [2, 2],
  [0, 2],
]

/** Corners on a circle. */
const around = (count: number): Point[] =>
  Array.from({ length: count }, (_, n) => {
    const angle = (n / count) * 2 * Math.PI
    return [Math.cos(angle), Math.sin(angle)]
  })

describe('what makes a fence', () => {
  it('is a line around some ground', () => {
    expect(flawOf(square)).toBeNull()
    expect(flawOf([...square].reverse())).toBeNull()
    expect(flawOf(around(3))).toBeNull()
    expect(flawOf(around(32))).toBeNull()
    expect(
      flawOf([
        [0, 0],
        [1, 0],
        [2, 0],
        [0, 2],
      ]),
    ).toBeNull()
  })

  const flaws: [string, Point[], Flaw][] = [
    ['too few corners', square.slice(0, 2), { flaw: 'few' }],
    ['too many corners', around(33), { flaw: 'many' }],
    [
      'a corner far away',
      [
        [0, 0],
        [1, 0],
        [0, 10_001],
      ],
      { flaw: 'far', corner: 3 },
    ],
    [
      'a corner that is no number',
      [
        [0, 0],
        [Number.NaN, 0],
        [0, 1],
      ],
      { flaw: 'far', corner: 2 },
    ],
    [
      'a corner twice',
      [
        [0, 0],
        [1, 0],
        [1, 0],
        [0, 1],
      ],
      { flaw: 'twice', corner: 3 },
    ],
    ['an end at the beginning', [...square, [0, 0]], { flaw: 'twice', corner: 1 }],
    [
      'a bow tie',
      [
        [0, 0],
        [1, 1],
        [1, 0],
        [0, 1],
      ],
      { flaw: 'crossing', one: 1, other: 3 },
    ],
    [
      'an edge through a corner',
      [
        [0, 0],
        [2, 0],
        [2, 2],
        [1, 0],
        [0, 2],
      ],
      { flaw: 'crossing', one: 1, other: 3 },
    ],
    [
      'a way there and back',
      [
        [0, 0],
        [2, 0],
        [1, 0],
        [0, 2],
      ],
      { flaw: 'crossing', one: 1, other: 2 },
    ],
    [
      'next to nothing',
      [
        [0, 0],
        [0.09, 0],
        [0.09, 0.09],
        [0, 0.09],
      ],
      { flaw: 'small' },
    ],
  ]
  it.each(flaws)('is not %s', (_, corners, flaw) => {
    expect(flawOf(corners)).toEqual(flaw)
    expect(words.flaw(flaw)).toMatch(/\.$/)
  })

  it('shows while it is drawn that it runs into itself', () => {
    expect(isTangled(square)).toBe(false)
    expect(
      isTangled([
        [0, 0],
        [2, 2],
        [2, 0],
        [0, 2],
      ]),
    ).toBe(true)
    expect(
      isTangled([
        [0, 0],
        [2, 0],
        [1, 0],
      ]),
    ).toBe(true)
    expect(isTangled([])).toBe(false)
  })

  it('is to the centimetre', () => {
    expect(rounded([1.23456, -0.0001])).toEqual([1.23, 0])
  })
})

describe('corners in writing', () => {
  it('come back as they went', () => {
    expect(readCorners(written(square))).toEqual({ corners: square })
  })

  it('may be written in several ways', () => {
    expect(readCorners('1.5,2\n\n  −3 ; 4e0  \n5 6')).toEqual({
      corners: [
        [1.5, 2],
        [-3, 4],
        [5, 6],
      ],
    })
    expect(readCorners('')).toEqual({ corners: [] })
  })

  it.each([
    ['1, 2, 3', 1],
    ['0, 0\n1', 2],
    ['0, 0\nx, 1', 2],
    ['0, 0\n\n1,', 3],
    ['Infinity, 1', 1],
  ])('names the line that is none: %j', (lines, line) => {
    expect(readCorners(lines)).toEqual({ line })
  })
})

describe('the pen', () => {
  /** One pixel to the centimetre. */
  const seen = ([x, y]: Point): Point => [100 * x, 100 * y]
  const press = (pen: Pen, x: number, y: number, time: number) =>
    pen.press([100 * x, 100 * y], [x, y], seen, time)

  function drawn(): Pen {
    const pen = new Pen()
    square.forEach(([x, y], at) => expect(press(pen, x, y, 1_000 * at)).toBe('corner'))
    return pen
  }

  it('puts a corner where it is pressed', () => {
    expect(drawn().corners).toEqual(square)
  })

  it('closes by a second press at the same place, in time', () => {
    const pen = drawn()
    expect(press(pen, 0.02, 2.05, 3_300)).toBe('close')
    expect(pen.corners).toEqual(square)
    const slow = drawn()
    expect(press(slow, 0.02, 2.05, 4_000)).toBe('corner')
    const elsewhere = drawn()
    expect(press(elsewhere, 1, 1, 3_100)).toBe('corner')
  })

  it('closes at the first corner, once there are three', () => {
    expect(press(drawn(), 0.05, 0.05, 9_000)).toBe('close')
    const pen = new Pen()
    press(pen, 0, 0, 0)
    press(pen, 1, 0, 1_000)
    expect(press(pen, 0.05, 0.05, 2_000)).toBe('corner')
  })

  it('takes corners back, the last first', () => {
    const pen = drawn()
    expect(pen.takeBack()).toBe(true)
    expect(pen.corners).toEqual(square.slice(0, 3))
    // What is taken back is no first half of a double click.
    expect(press(pen, 0, 2, 3_100)).toBe('corner')
    for (let i = 0; i < 4; i++) expect(pen.takeBack()).toBe(true)
    expect(pen.takeBack()).toBe(false)
  })

  it('has no more corners than a fence may have', () => {
    const pen = new Pen()
    for (let n = 0; n < 32; n++) expect(press(pen, n, n % 2, 1_000 * n)).toBe('corner')
    expect(press(pen, 40, 0, 40_000)).toBe('full')
    expect(pen.corners).toHaveLength(32)
  })
})

describe('a fence in the picture', () => {
  it('says what it is', () => {
    const fence = {
      id: '1',
      name: 'yard',
      kind: 'keep_in' as const,
      action: 'stop' as const,
      corners: [],
      by: 'ada',
      made_at: 0,
    }
    expect(labelOf(fence)).toBe('yard · keep in · stop')
    expect(labelOf({ ...fence, kind: 'keep_out', action: 'warn' })).toBe('yard · keep out')
  })
})
