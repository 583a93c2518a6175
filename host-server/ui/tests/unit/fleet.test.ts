import { describe, expect, it } from 'vitest'
import { decodeFrame } from '../../src/feed/decode'
import type { PosesFrame, RosterEntry } from '../../src/feed/decode'
import { Fleet, MOVING_FOR_MS, isMoving, poseAt, shortestTurn } from '../../src/fleet/fleet'
import { posesFrame } from '../mock/encode.mjs'

const T0 = 1_700_000_000_000

function entry(index: number, id: string): RosterEntry {
  return { index, id, kind: 'simulated', presence: 'online', firmware: '', board: '' }
}

function poses(ms: number, index: number, x: number, heading = 0): PosesFrame {
  const row = { index, x, y: 0, heading, state: 'MOVING', presence: 'online' }
  const decoded = decodeFrame(posesFrame({ ms, robots: [row] }))
  if (!decoded.ok || decoded.frame.kind !== 'poses') throw new Error('not poses')
  return decoded.frame
}

function fleetOf(...entries: RosterEntry[]): Fleet {
  const fleet = new Fleet()
  fleet.begin(T0)
  fleet.applyRoster({ kind: 'roster', robots: entries, removed: [] })
  return fleet
}

describe('the roster', () => {
  it('adds, changes and removes', () => {
    const fleet = fleetOf(entry(0, 'a'), entry(1, 'b'))
    fleet.applyRoster({
      kind: 'roster',
      robots: [{ ...entry(1, 'b'), presence: 'stale' }, entry(2, 'c')],
      removed: [0],
    })
    expect([...fleet.all()].map(({ id }) => id)).toEqual(['b', 'c'])
    expect(fleet.get('b')?.presence).toBe('stale')
    expect(fleet.get('a')).toBeUndefined()
  })

  it('replaces everything after a new connection, and keeps what is the same', () => {
    const fleet = fleetOf(entry(0, 'a'), entry(1, 'b'))
    fleet.applyPoses(poses(T0, 0, 2), T0)
    fleet.begin(T0 + 5_000)
    fleet.applyRoster({ kind: 'roster', robots: [entry(0, 'a'), entry(1, 'z')], removed: [] })
    expect(fleet.get('a')?.x).toBeCloseTo(2, 3)
    expect(fleet.get('b')).toBeUndefined()
    expect(fleet.get('z')?.placed).toBe(false)
  })

  it('follows a robot whose index has changed', () => {
    const fleet = fleetOf(entry(0, 'a'))
    fleet.applyRoster({ kind: 'roster', robots: [entry(5, 'a')], removed: [] })
    expect(fleet.size).toBe(1)
    expect(fleet.get('a')?.index).toBe(5)
  })

  it('sorts names with numbers as people do', () => {
    const fleet = fleetOf(entry(0, 'sim-10'), entry(1, 'sim-2'))
    expect(fleet.byName().map(({ id }) => id)).toEqual(['sim-2', 'sim-10'])
  })
})

describe('poses', () => {
  it('are reached over the time since the pose before, without a jump', () => {
    const fleet = fleetOf(entry(0, 'a'))
    const robot = fleet.get('a')
    if (robot === undefined) throw new Error('lost')
    fleet.applyPoses(poses(T0, 0, 1), T0)
    fleet.applyPoses(poses(T0 + 200, 0, 2), T0 + 200)
    expect(poseAt(robot, T0 + 200).x).toBeCloseTo(1, 3)
    expect(poseAt(robot, T0 + 300).x).toBeCloseTo(1.5, 3)
    // The next one comes early: it starts from what is shown.
    fleet.applyPoses(poses(T0 + 300, 0, 3), T0 + 300)
    expect(poseAt(robot, T0 + 300).x).toBeCloseTo(1.5, 3)
    expect(poseAt(robot, T0 + 350).x).toBeCloseTo(2.25, 3)
    expect(poseAt(robot, T0 + 999).x).toBeCloseTo(3, 3)
    expect(fleet.settledAt).toBe(T0 + 400)
  })

  it('do not creep after a long rest', () => {
    const fleet = fleetOf(entry(0, 'a'))
    const robot = fleet.get('a')
    if (robot === undefined) throw new Error('lost')
    fleet.applyPoses(poses(T0, 0, 1), T0)
    fleet.applyPoses(poses(T0 + 10_000, 0, 1.02), T0 + 10_000)
    expect(poseAt(robot, T0 + 10_250).x).toBeCloseTo(1.02, 3)
  })

  it('for strangers are counted and ignored', () => {
    const fleet = fleetOf(entry(0, 'a'))
    fleet.applyPoses(poses(T0, 9, 1), T0)
    expect(fleet.strangers).toBe(1)
  })

  it('that are older than what is known are ignored', () => {
    const fleet = fleetOf(entry(0, 'a'))
    fleet.applyPoses(poses(T0 + 500, 0, 2), T0 + 500)
    fleet.applyPoses(poses(T0 + 400, 0, 1), T0 + 400)
    expect(fleet.get('a')?.x).toBeCloseTo(2, 3)
  })

  it('tell moving from standing', () => {
    const fleet = fleetOf(entry(0, 'a'))
    const robot = fleet.get('a')
    if (robot === undefined) throw new Error('lost')
    fleet.applyPoses(poses(T0, 0, 1), T0)
    fleet.applyPoses(poses(T0 + 100, 0, 1.001), T0 + 100)
    expect(isMoving(robot, T0 + 100)).toBe(false)
    fleet.applyPoses(poses(T0 + 200, 0, 1.05), T0 + 200)
    expect(isMoving(robot, T0 + 200)).toBe(true)
    expect(isMoving(robot, T0 + 200 + MOVING_FOR_MS)).toBe(false)
    fleet.applyPoses(poses(T0 + 2_000, 0, 1.05, 0.5), T0 + 2_000)
    expect(fleet.moving(T0 + 2_000)).toBe(1)
  })
})

describe('shortestTurn', () => {
  it.each([
    [0.1, 6.2, -0.183],
    [6.2, 0.1, 0.183],
    [1, 2, 1],
  ])('from %d to %d is %d', (from, to, turn) => {
    expect(shortestTurn(from, to)).toBeCloseTo(turn, 2)
  })
})
