// @vitest-environment happy-dom

import { describe, expect, it } from 'vitest'
import type { CounterfactualAnswer } from '../../src/api-types'
import { commandWords, measures, whom } from '../../src/strings-what-if'
import { Replay } from '../../src/history/replay'
import { linkTo, parseRoute, placeOf } from '../../src/view'
import { readAnswer } from '../../src/what-if/answer'
import { frameOf } from '../../src/what-if/frame'
import { overlayAt, radiusAt } from '../../src/what-if/overlay'
import { afterOf, queryOfAfter } from '../../src/what-if/address'
import { bodyOf } from '../../src/what-if/question'
import { isClear, nullTestOf, robotRows } from '../../src/what-if/rows'

const AT = 1_790_000_000_000
type Robot = CounterfactualAnswer['robots'][number]

/** Goes a quarter of a metre each step; with the change it stays. */
function robot(name: string, more: Partial<Robot> = {}): Robot {
  const line = [0, 0.25, 0.5]
  const still = [0, 0, 0]
  return {
    robot: name,
    kind: 'simulated',
    body: 'record',
    certificate: null,
    command: 'wander',
    supposed: false,
    recorded: { x: line, y: still, theta: still },
    was: { x: line, y: still, theta: still, state: [1, 1, 1], within: [0, 0.1, 0.2] },
    would: { x: still, y: still, theta: still, state: [1, 0, 0], within: [0, 0, 0] },
    inside: true,
    parted_s: 0.25,
    apart: 0.5,
    contacts: [0.4, 0.1],
    ...more,
  }
}

function answer(robots: Robot[]): CounterfactualAnswer {
  return {
    step: 250,
    states: ['IDLE', 'MOVING'],
    arena: { width: 4, height: 3, obstacles: [] },
    null_test: { robots: robots.length, inside: robots.length },
    measures: [],
    robots,
  } as unknown as CounterfactualAnswer
}

describe('an answer', () => {
  it('is shown as a record is, both worlds by themselves', () => {
    const { window, worlds } = readAnswer(answer([robot('sim-0001')]), AT)
    expect(window).toEqual({ from: AT, to: AT + 500 })
    const [was, would] = [new Replay(), new Replay()]
    was.show(AT + 375, worlds.was, null)
    would.show(AT + 375, worlds.would, null)
    expect(was.fleet.get('sim-0001')?.x).toBeCloseTo(0.375)
    expect(was.fleet.get('sim-0001')?.state).toBe('MOVING')
    expect(would.fleet.get('sim-0001')?.x).toBe(0)
    expect(would.fleet.get('sim-0001')?.state).toBe('IDLE')
    expect(was.arena.value?.width).toBe(4)
  })

  it('is known up to its end, without gaps', () => {
    const { window, worlds } = readAnswer(answer([robot('sim-0001')]), AT)
    const was = new Replay()
    was.show(window.to, worlds.was, null)
    expect(was.fleet.get('sim-0001')).toMatchObject({ x: 0.5, presence: 'online' })
    expect(was.gaps.size).toBe(0)
  })

  it('whose columns do not fit together is refused', () => {
    const broken = robot('sim-0001')
    broken.would.within = [0]
    expect(() => readAnswer(answer([broken]), AT)).toThrow('sim-0001')
  })

  it('without robots and without an arena is an empty one', () => {
    const { window, worlds } = readAnswer({ ...answer([]), arena: null }, AT)
    expect(window.to).toBeGreaterThan(window.from)
    expect(worlds.was.tracks.size).toBe(0)
  })
})

describe('what both pictures show', () => {
  it('holds the arena, and whoever leaves it in either world', () => {
    const gone = robot('sim-0001')
    gone.would.x = [0, 1, 3]
    const walls = frameOf(readAnswer(answer([robot('sim-0001')]), AT))
    expect(walls?.maxX).toBeCloseTo(2.08)
    expect(frameOf(readAnswer(answer([gone]), AT))).toEqual({ ...walls, maxX: 3 })
    expect(frameOf(readAnswer({ ...answer([]), arena: null }, AT))).toBeNull()
  })
})

describe('what lies over the robots', () => {
  const outside = robot('sim-0002', {
    inside: false,
    recorded: { x: [0, null, 0.1], y: [1, null, 1], theta: [0, null, 0] },
  })
  const read = readAnswer(answer([robot('sim-0001'), outside]), AT)
  const none = new Set<string>()

  it('grows with what is not known, between the points too', () => {
    expect(radiusAt(read, 'was', 'sim-0001', AT + 125)).toBeCloseTo(0.05)
    expect(radiusAt(read, 'was', 'sim-0001', AT + 9_000)).toBeCloseTo(0.2)
    expect(radiusAt(read, 'was', 'nobody', AT)).toBe(0)
  })

  it('has ghosts of what was recorded in the world as it was alone', () => {
    const was = overlayAt(read, 'was', AT + 500, 'sim-0001', none)
    expect(was.ghosts.map(({ x, outside }) => [x.toFixed(2), outside])).toEqual([
      ['0.50', false],
      ['0.10', true],
    ])
    expect(was.ghosts[1]?.drawn).toEqual([0.5, 0])
    const would = overlayAt(read, 'would', AT + 500, 'sim-0001', none)
    expect(would.ghosts).toEqual([])
    expect(would.discs).toHaveLength(2)
    expect(would.way).toEqual([])
  })

  it('has the recorded way of the chosen robot so far, of points that are known', () => {
    const way = (robot: string | null, at: number) => overlayAt(read, 'was', at, robot, none).way
    expect(way('sim-0001', AT + 300)).toEqual([
      [0, 0],
      [0.25, 0],
    ])
    expect(way('sim-0002', AT + 500)).toHaveLength(2)
    expect(way(null, AT + 500)).toEqual([])
  })

  it('makes up nothing where nothing was recorded', () => {
    const unknown = { x: [null, null, null], y: [null, null, null], theta: [null, null, null] }
    const bare = readAnswer(answer([robot('sim-0001', { recorded: unknown, inside: null })]), AT)
    expect(overlayAt(bare, 'was', AT + 250, 'sim-0001', none)).toMatchObject({
      ghosts: [],
      way: [],
    })
  })

  it('of very many robots has the discs only of those it is about', () => {
    const many = Array.from({ length: 200 }, (_, number) => robot(`sim-${String(number)}`))
    const all = readAnswer(answer(many), AT)
    const { discs } = overlayAt(all, 'would', AT, 'sim-7', new Set(['sim-1', 'sim-2']))
    expect(discs).toHaveLength(3)
    expect(discs.filter(({ chosen }) => chosen)).toHaveLength(1)
  })
})

describe('what an answer comes to', () => {
  it('holds where four of five robots were where the simulation has them', () => {
    const test = (robots: number, inside: number) =>
      nullTestOf({ ...answer([]), null_test: { robots, inside } }).holds
    expect(test(12, 11)).toBe(true)
    expect(test(10, 8)).toBe(true)
    expect(test(10, 7)).toBe(false)
    expect(test(0, 0)).toBeNull()
  })

  it('is clear where the interval leaves zero out', () => {
    expect(isClear({ mean: -0.9, low: -1.4, high: -0.4 })).toBe(true)
    expect(isClear({ mean: 0.1, low: -0.1, high: 0.3 })).toBe(false)
    expect(isClear({ mean: 0, low: 0, high: 0 })).toBe(false)
  })

  it('names the robots that parted furthest first', () => {
    const rows = robotRows([
      robot('sim-10', { apart: 0 }),
      robot('sim-9', { apart: 0 }),
      robot('sim-11', { apart: 2, contacts: [] as never }),
    ])
    expect(rows.map(({ robot }) => robot)).toEqual(['sim-11', 'sim-9', 'sim-10'])
    expect(rows[0]?.contacts).toEqual([0, 0])
  })
})

describe('a question', () => {
  it('is sent with whole milliseconds, and to one robot or all', () => {
    const question = { at: AT + 0.4, seconds: 20, draws: 20, robot: 'sim-0001' } as const
    const stop = { command: 'stop' }
    expect(bodyOf(question, stop)).toEqual({
      at: AT,
      seconds: 20,
      draws: 20,
      robots: ['sim-0001'],
      command: stop,
    })
    expect(bodyOf({ ...question, robot: null }, stop).robots).toBeNull()
  })

  it('has words for what is told, and to whom', () => {
    const behave = (parameters: object) => commandWords({ command: 'behave', parameters })
    expect(commandWords({ command: 'stop' })).toBe('Stop')
    expect(commandWords({ command: 'goto', parameters: { x: 1, y: -2 } })).toBe('Go to 1, -2')
    expect(behave({ behaviour: 'wander', speed: 60 })).toBe('Wander, 60 %')
    expect(behave({ behaviour: 'follow', leader: 'rover-1' })).toBe('Follow rover-1')
    expect(behave({ behaviour: 'formation', shape: 'line' })).toBe('Form a line')
    expect(behave({ behaviour: 'formation' })).toBe('Formation')
    expect(behave({ behaviour: 'newer' })).toBe('newer')
    expect(commandWords({ command: 'newer' })).toBe('newer')
    expect(whom(null)).toBe('all robots')
    expect(whom(['a', 'b'])).toBe('a, b')
    expect(whom(['a', 'b', 'c', 'd'])).toBe('4 robots')
    expect(measures.difference(0.5, 'm')).toBe('+0.50 m')
    expect(measures.difference(-0.5, '')).toBe('−0.50')
  })

  it('has an address of its own, in the place of the history', () => {
    expect(linkTo('what-if', { id: 'c1' })).toBe('#/what-if?id=c1')
    expect(parseRoute('#/what-if?id=c1')).toMatchObject({ view: 'what-if', query: { id: 'c1' } })
    expect(placeOf('what-if')).toBe('history')
    expect(placeOf('robots')).toBe('robots')
  })
})

describe('the time in the address', () => {
  it('is read as it was written, and the end is left out', () => {
    for (const after of [0, 1, 8_250, 60_000]) expect(afterOf(queryOfAfter(after))).toBe(after)
    expect(queryOfAfter(null)).toEqual({ after: '' })
  })

  it('is the end where nobody can tell', () => {
    for (const after of ['', '-1', '1.5', 'x', '1e99', 'NaN']) expect(afterOf({ after })).toBe(null)
    expect(afterOf({})).toBe(null)
  })
})
