// @vitest-environment happy-dom

import { mount } from '@vue/test-utils'
import { describe, expect, it } from 'vitest'
import { nextTick } from 'vue'
import { createApi } from '../../src/api'
import RobotList from '../../src/components/RobotList.vue'
import { ROOM, Room } from '../../src/control/room'

function setUp(count: number) {
  const room = new Room({
    url: 'ws://test',
    api: createApi(() => Promise.reject(new Error('off'))),
  })
  room.fleet.applyRoster({
    kind: 'roster',
    removed: [],
    robots: Array.from({ length: count }, (_, index) => ({
      index,
      id: index === 4 ? 'rover-1' : `sim-${String(index).padStart(4, '0')}`,
      kind: index === 4 ? ('physical' as const) : ('simulated' as const),
      presence: index === 7 ? ('offline' as const) : ('online' as const),
      firmware: '',
      board: '',
    })),
  })
  const list = mount(RobotList, { global: { provide: { [ROOM as symbol]: room } } })
  const ids = () =>
    list.findAll('[data-testid=robot-row]').map((row) => row.attributes('data-robot-id'))
  return { room, list, ids }
}

describe('the list of robots', () => {
  it('renders only the rows in view, and says how many there are', () => {
    const { list, ids } = setUp(1_000)
    expect(ids().length).toBeGreaterThan(5)
    expect(ids().length).toBeLessThan(40)
    const first = list.find('[data-testid=robot-row]')
    expect(first.attributes('aria-setsize')).toBe('1000')
    expect(list.find('[data-testid=robot-count]').attributes('data-total')).toBe('1000')
  })

  it('follows the scroll position', async () => {
    const { list, ids } = setUp(1_000)
    const box = list.find('[data-testid=robot-list]')
    box.element.scrollTop = 48 * 500
    await box.trigger('scroll')
    expect(ids()).toContain('sim-0500')
    expect(ids()).not.toContain('sim-0000')
  })

  it('searches by part of the name, in any case', async () => {
    const { list, ids } = setUp(1_000)
    await list.find('[data-testid=search]').setValue('SIM-099')
    expect(ids()).toHaveLength(10)
  })

  it('filters by kind, presence and need of attention', async () => {
    const { list, ids } = setUp(20)
    const filter = list.find('[data-testid=filter]')
    await filter.setValue('physical')
    expect(ids()).toEqual(['rover-1'])
    await filter.setValue('offline')
    expect(ids()).toEqual(['sim-0007'])
    await filter.setValue('attention')
    expect(ids()).toEqual(['sim-0007'])
  })

  it('selects by click, and by arrows and Enter', async () => {
    const { room, list } = setUp(20)
    await list.find('[data-robot-id=sim-0003]').trigger('click')
    expect(room.selectedId.value).toBe('sim-0003')
    const box = list.find('[data-testid=robot-list]')
    await box.trigger('keydown', { key: 'ArrowDown' })
    expect(box.attributes('aria-activedescendant')).toBe('row-sim-0005')
    expect(room.selectedId.value).toBe('sim-0003')
    await box.trigger('keydown', { key: 'Enter' })
    expect(room.selectedId.value).toBe('sim-0005')
    expect(list.emitted('chosen')).toHaveLength(2)
  })

  it('says so when nothing matches', async () => {
    const { list, ids } = setUp(3)
    await list.find('[data-testid=search]').setValue('nobody')
    await nextTick()
    expect(ids()).toEqual([])
    expect(list.text()).toContain('No robot matches')
  })
})
