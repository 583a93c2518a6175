import { describe, expect, it } from 'vitest'
import type { Robot } from '../../src/fleet/fleet'
import { Fleet } from '../../src/fleet/fleet'
import type { RobotSummary, Wanted } from '../../src/fleet/order'
import { SHOWS, arrange, needsAttention, passes } from '../../src/fleet/order'
import { columnsIn, reveal, visible } from '../../src/fleet/rows'

function fleetOf(count: number, change: (robot: Robot, index: number) => void = () => undefined) {
  const fleet = new Fleet()
  fleet.applyRoster({
    kind: 'roster',
    removed: [],
    robots: Array.from({ length: count }, (_, index) => ({
      index,
      id: `sim-${String(index + 1)}`,
      kind: index % 3 === 0 ? ('physical' as const) : ('simulated' as const),
      presence: 'online' as const,
      firmware: index === 2 ? '' : `0.${String(index % 2)}.0`,
      board: '',
    })),
  })
  fleet.byName().forEach(change)
  return fleet
}

const all: Wanted = { search: '', show: 'all', sort: 'name', descending: false }
const summary = (battery: number | null): RobotSummary => ({
  battery,
  rssi: null,
  behaviour: null,
  lastSeen: null,
})
const ids = (robots: readonly Robot[]) => robots.map(({ id }) => id)

describe('the order of robots', () => {
  it('is by name as people count', () => {
    const robots = arrange(fleetOf(12).byName(), all, new Map())
    expect(ids(robots).slice(0, 3)).toEqual(['sim-1', 'sim-2', 'sim-3'])
    expect(ids(robots).at(-1)).toBe('sim-12')
    const back = arrange(fleetOf(12).byName(), { ...all, descending: true }, new Map())
    expect(ids(back)[0]).toBe('sim-12')
  })

  it('leaves the list it was given as it is', () => {
    const fleet = fleetOf(3)
    arrange(fleet.byName(), { ...all, descending: true }, new Map())
    expect(ids(fleet.byName())).toEqual(['sim-1', 'sim-2', 'sim-3'])
  })

  it('puts what is not known last, either way', () => {
    const summaries = new Map([
      ['sim-1', summary(70)],
      ['sim-2', summary(null)],
      ['sim-3', summary(15)],
    ])
    const up = arrange(fleetOf(4).byName(), { ...all, sort: 'battery' }, summaries)
    expect(ids(up)).toEqual(['sim-3', 'sim-1', 'sim-2', 'sim-4'])
    const down = arrange(
      fleetOf(4).byName(),
      { ...all, sort: 'battery', descending: true },
      summaries,
    )
    expect(ids(down)).toEqual(['sim-1', 'sim-3', 'sim-2', 'sim-4'])
    const firmware = arrange(fleetOf(3).byName(), { ...all, sort: 'firmware' }, new Map())
    expect(ids(firmware)).toEqual(['sim-1', 'sim-2', 'sim-3'])
  })

  it('puts what must be looked at first', () => {
    const fleet = fleetOf(4, (robot, index) => {
      robot.state = index === 1 ? 'ERROR' : 'IDLE'
      if (index === 3) robot.presence = 'offline'
    })
    const robots = arrange(fleet.byName(), { ...all, sort: 'state' }, new Map())
    expect(ids(robots)).toEqual(['sim-4', 'sim-2', 'sim-1', 'sim-3'])
  })

  it('filters by search, state, kind, presence, battery and need of attention', () => {
    const fleet = fleetOf(9, (robot, index) => {
      robot.state = index === 0 ? 'ERROR' : 'MOVING'
      if (index === 1) robot.presence = 'stale'
      if (index === 2) robot.lowBattery = true
      if (index === 4) robot.fence = 'yard'
      if (index === 3) Object.assign(robot, { presence: 'offline', state: 'ERROR' })
    })
    const count = (change: Partial<Wanted>) =>
      arrange(fleet.byName(), { ...all, ...change }, new Map()).length
    expect(count({ search: ' SIM-3 ' })).toBe(1)
    expect(count({ show: 'physical' })).toBe(3)
    expect(count({ show: 'stale' })).toBe(1)
    expect(count({ show: 'low' })).toBe(1)
    expect(count({ show: 'fence' })).toBe(1)
    // What an offline robot did last says nothing about now.
    expect(count({ show: 'error' })).toBe(1)
    expect(count({ show: 'moving' })).toBe(7)
    expect(count({ show: 'attention' })).toBe(5)
    expect(fleet.byName().filter(needsAttention)).toHaveLength(5)
    for (const show of SHOWS) {
      expect(fleet.byName().some((robot) => typeof passes(robot, show) !== 'boolean')).toBe(false)
    }
  })

  it('takes ten thousand', () => {
    const fleet = fleetOf(10_000)
    const summaries = new Map(
      fleet.byName().map(({ id }, index) => [id, summary((index * 7_919) % 100)]),
    )
    const robots = arrange(fleet.byName(), { ...all, sort: 'battery' }, summaries)
    const charges = robots.map(({ id }) => summaries.get(id)?.battery ?? -1)
    expect(charges.every((charge, at) => at === 0 || charge >= (charges[at - 1] ?? 0))).toBe(true)
  })
})

describe('rows in view', () => {
  it('are those in view and a few beyond each edge', () => {
    expect(visible(0, 440, 44, 10_000)).toEqual({ first: 0, end: 16 })
    expect(visible(44_000, 440, 44, 10_000)).toEqual({ first: 994, end: 1_016 })
    expect(visible(1e9, 440, 44, 10_000)).toEqual({ first: 9_993, end: 10_000 })
    expect(visible(0, 440, 44, 0)).toEqual({ first: 0, end: 0 })
  })

  it('are scrolled to by as little as it takes', () => {
    expect(reveal(5, 0, 440, 44)).toBe(0)
    expect(reveal(2, 440, 440, 44)).toBe(88)
    expect(reveal(20, 0, 440, 44)).toBe(484)
  })

  it('hold as many cards as fit', () => {
    expect(columnsIn(1_000, 230, 10)).toBe(4)
    expect(columnsIn(100, 230, 10)).toBe(1)
  })
})
