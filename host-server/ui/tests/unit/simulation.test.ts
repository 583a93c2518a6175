// @vitest-environment happy-dom

import { flushPromises, mount } from '@vue/test-utils'
import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { Component } from 'vue'
import { createApi } from '../../src/api'
import type { ScenarioPreview, SimulatorBody, SimulatorCommand } from '../../src/api-types'
import { Stage } from '../../src/arena/stage'
import { ROOM, Room } from '../../src/control/room'
import { ApiError } from '../../src/http'
import type { FleetApi } from '../../src/pages/fleet-api'
import BookmarkPanel from '../../src/pages/simulation/BookmarkPanel.vue'
import ScenarioPicker from '../../src/pages/simulation/ScenarioPicker.vue'
import ThingsPanel from '../../src/pages/simulation/ThingsPanel.vue'
import { ADDRESS, useView } from '../../src/view'

const WORLD: SimulatorBody = {
  state: 'running',
  factor: 1,
  real_time_factor: 1,
  time: 5,
  seed: 1,
  robots: 2,
  connected: 2,
  hash: '',
  scenario: 'arena',
  dropped: [],
  bookmarks: [],
}
const ARENA = { width: 6, height: 4, obstacles: [], movers: [], patches: [], objects: [] }

const bookmark = (name: string) => ({
  name,
  time: 61,
  made_at: 1_700_000_000_000,
  robots: 2,
  scenario: 'arena',
})
const preview = (name: string, change: Partial<ScenarioPreview> = {}): ScenarioPreview => ({
  name,
  about: `${name} it is`,
  robots: 4,
  seed: 9,
  arena: ARENA as unknown as ScenarioPreview['arena'],
  poses: [{ x: 0, y: 0, theta: 0 }],
  ...change,
})

let clean: (() => void)[] = []
beforeEach(() => {
  history.replaceState(null, '', '/')
})
afterEach(() => {
  for (const undo of clean) undo()
  clean = []
  vi.useRealTimers()
})

/** A panel of the page, with a server that takes everything, or refuses with `refusal`. */
function setUp(
  panel: Component,
  {
    world = {} as Partial<SimulatorBody>,
    why = null as string | null,
    refusal = null as ApiError | null,
  } = {},
) {
  const sent: SimulatorCommand[] = []
  const asked: string[] = []
  const answer = { refusal }
  const api: Partial<FleetApi> = {
    simulate(command) {
      sent.push(command)
      if (answer.refusal !== null) return Promise.reject(answer.refusal)
      const now = { ...WORLD, ...world }
      const taken = command.command === 'take' ? command.item : null
      const dropped = now.dropped.filter((one) => one.id !== taken)
      return Promise.resolve({ simulator: { ...now, dropped, scenario: 'hall', robots: 3 } })
    },
    scenarios: () =>
      Promise.resolve(
        ['arena', 'hall'].map((name) => ({
          name,
          about: `${name} it is`,
          robots: 4,
          width: 6,
          height: 4,
          obstacles: 0,
          objects: 0,
          movers: 0,
        })),
      ),
    scenario(name, robots, seed) {
      asked.push([name, robots, seed].join(' '))
      return Promise.resolve(preview(name, { robots: robots ?? 4, seed: seed ?? 9 }))
    },
  }
  const room = new Room({
    url: 'ws://test',
    api: createApi(() => Promise.reject(new Error('off'))),
  })
  room.arena.value = { ...ARENA }
  const address = useView()
  const page = mount(panel, {
    props: {
      api,
      world: { ...WORLD, ...world },
      why,
      onChanged: (changed: SimulatorBody) => page.setProps({ world: changed }),
    },
    global: { provide: { [ROOM as symbol]: room, [ADDRESS as symbol]: address } },
    attachTo: document.body,
  })
  clean.push(() => page.unmount(), address.close)
  const id = (name: string) => page.find(`[data-testid=${name}]`)
  return { page, id, sent, asked, answer, room }
}

describe('putting things into the world', () => {
  it('goes by fields and button', async () => {
    const { page, id, sent } = setUp(ThingsPanel)
    await id('thing-kind').setValue('ball')
    await id('thing-colour').setValue('green')
    await id('thing-x').setValue('1,5')
    await id('thing-y').setValue('-1')
    expect(page.findAll('.ghost circle').length).toBeGreaterThan(0)
    await id('put').trigger('submit')
    await flushPromises()
    expect(sent).toEqual([
      { command: 'drop', object: { shape: 'ball', colour: 'green', x: 1.5, y: -1, size: 0.2 } },
    ])
    expect(id('things-said').text()).toContain('green ball')
    expect(page.emitted('changed')).toHaveLength(1)
    // It is in the world now; a ghost in the same place would be a second one.
    expect(page.find('.ghost').exists()).toBe(false)
  })

  it('goes by arrow keys and Enter on the map', async () => {
    const { id, sent } = setUp(ThingsPanel)
    const map = id('world-map')
    await map.trigger('keydown', { key: 'ArrowRight' })
    await map.trigger('keydown', { key: 'ArrowUp', shiftKey: true })
    expect(map.attributes('data-place')).toBe('0.1 0.5')
    await map.trigger('keydown', { key: 'Enter' })
    await flushPromises()
    expect(sent).toMatchObject([{ command: 'drop', obstacle: { shape: 'box', x: 0.1, y: 0.5 } }])
  })

  it('sends no nonsense, and says which field it is', async () => {
    const { page, id, sent } = setUp(ThingsPanel)
    await id('thing-length').setValue('long')
    await page.find('form').trigger('submit')
    expect(sent).toEqual([])
    expect(page.find('[role=alert]').text()).toContain('Length')
    expect(id('thing-length').attributes('aria-invalid')).toBe('true')
  })

  it('says why the server refuses, until it is tried elsewhere', async () => {
    const refusal = new ApiError('Conflict', 409, 'refused', null, 'it overlaps robot sim-0001')
    const { page, id, answer } = setUp(ThingsPanel, { refusal })
    await id('thing-x').setValue('0')
    await id('thing-y').setValue('0')
    await page.find('form').trigger('submit')
    await flushPromises()
    expect(page.find('[role=alert]').text()).toContain('it overlaps robot sim-0001')
    expect(page.find('.ghost.refused').exists()).toBe(true)
    await id('thing-x').setValue('2')
    expect(page.find('.ghost.refused').exists()).toBe(false)
    answer.refusal = null
    await page.find('form').trigger('submit')
    await flushPromises()
    expect(page.find('[role=alert]').exists()).toBe(false)
  })

  it('takes away, and the focus goes on', async () => {
    const post = { shape: 'circle', x: 0, y: 1, r: 0.2 } as const
    const { page, sent } = setUp(ThingsPanel, {
      world: { dropped: [{ id: 4, obstacle: post }, { id: 7 }] },
    })
    const [first] = page.findAll('.dropped button')
    expect(first?.attributes('aria-label')).toContain('round post')
    await first?.trigger('click')
    await flushPromises()
    expect(sent).toEqual([{ command: 'take', item: 4 }])
    expect((document.activeElement as HTMLElement).closest('li')?.dataset['item']).toBe('7')
  })

  it('is off for viewers, with the reason', async () => {
    const { page, id, sent } = setUp(ThingsPanel, {
      world: { dropped: [{ id: 7 }] },
      why: 'only operators',
    })
    await id('world-map').trigger('keydown', { key: 'Enter' })
    await page.find('form').trigger('submit')
    for (const button of page.findAll('button')) {
      expect(button.attributes('disabled')).toBeDefined()
      expect(button.attributes('title')).toBe('only operators')
    }
    expect(sent).toEqual([])
  })
})

describe('bookmarks', () => {
  it('are kept under a name that nobody has yet', async () => {
    const { page, id, sent } = setUp(BookmarkPanel, { world: { bookmarks: [bookmark('arena-1')] } })
    expect((id('bookmark-name').element as HTMLInputElement).value).toBe('arena-2')
    await page.find('form').trigger('submit')
    await flushPromises()
    expect(sent).toEqual([{ command: 'snapshot', name: 'arena-2' }])
    expect(id('bookmarks-said').text()).toContain('arena-2')
  })

  it.each(['Not good', '', 'arena-1', 'x'.repeat(33)])('are not kept as “%s”', async (name) => {
    const { page, id, sent } = setUp(BookmarkPanel, { world: { bookmarks: [bookmark('arena-1')] } })
    await id('bookmark-name').setValue(name)
    await page.find('form').trigger('submit')
    expect(sent).toEqual([])
    expect(id('bookmark-name').attributes('aria-invalid')).toBe('true')
    expect(page.find('#bookmark-trouble').text()).not.toBe('')
  })

  it('come to an end', () => {
    const bookmarks = Array.from({ length: 16 }, (_, at) => bookmark(`b${String(at)}`))
    const { page, id } = setUp(BookmarkPanel, { world: { bookmarks } })
    expect(id('keep').attributes('disabled')).toBeDefined()
    expect(page.text()).toContain('forget one')
  })

  it('come back after a slide, which says what does not', async () => {
    const { page, id, sent } = setUp(BookmarkPanel, { world: { bookmarks: [bookmark('here')] } })
    await id('restore').trigger('click')
    expect(id('going-back').text()).toContain('start anew')
    expect(sent).toEqual([])
    const track = id('go-back-track')
    for (const share of ['30', '60', '90', '100']) await track.setValue(share)
    await flushPromises()
    expect(sent).toEqual([{ command: 'restore', name: 'here' }])
    expect(id('bookmarks-said').text()).toContain('3 robots stand idle')
    expect(page.find('[data-testid=going-back]').exists()).toBe(false)
    expect(document.activeElement?.id).toBe('restore-here')
  })

  it('are forgotten after a question', async () => {
    const { id, sent } = setUp(BookmarkPanel, { world: { bookmarks: [bookmark('here')] } })
    await id('forget').trigger('click')
    expect(sent).toEqual([])
    await id('confirm').trigger('click')
    await flushPromises()
    expect(sent).toEqual([{ command: 'forget', name: 'here' }])
  })

  it('are only looked at by viewers', () => {
    const { page } = setUp(BookmarkPanel, { world: { bookmarks: [bookmark('here')] }, why: 'no' })
    for (const button of page.findAll('button')) {
      expect(button.attributes('disabled')).toBeDefined()
      expect(button.attributes('title')).toBe('no')
    }
  })
})

describe('scenarios', () => {
  it('are drawn, and what runs is chosen', async () => {
    const { page, id, asked } = setUp(ScenarioPicker)
    await flushPromises()
    expect(asked).toEqual(['arena  ', 'hall  '])
    expect(page.findAll('[data-drawn=true]')).toHaveLength(2)
    expect(id('scenario-choice').attributes('data-name')).toBe('arena')
  })

  it('load as they were looked at, after a slide', async () => {
    vi.useFakeTimers()
    const { page, id, sent, asked } = setUp(ScenarioPicker)
    await flushPromises()
    await page.find('input[value=hall]').setValue(true)
    await id('scenario-robots').setValue('12')
    await id('scenario-seed').setValue('77')
    await vi.advanceTimersByTimeAsync(400)
    expect(asked.at(-1)).toBe('hall 12 77')
    expect(id('scenario-choice').attributes('data-robots')).toBe('12')
    for (const share of ['30', '60', '90', '100']) await id('load-track').setValue(share)
    await flushPromises()
    expect(sent).toEqual([{ command: 'load', scenario: 'hall', robots: 12, seed: 77 }])
    expect(id('scenarios-said').text()).toContain('hall is loaded, with 3 robots')
    expect(location.hash).toContain('scenario=hall')
  })

  it('are not loaded with nonsense, nor by viewers', async () => {
    const { page, id } = setUp(ScenarioPicker)
    await flushPromises()
    expect(id('load-track').attributes('disabled')).toBeUndefined()
    await id('scenario-robots').setValue('many')
    expect(id('load-track').attributes('disabled')).toBeDefined()
    expect(page.find('#scenario-trouble').text()).toContain('whole number')
    await id('scenario-robots').setValue('')
    await page.setProps({ why: 'only operators' })
    expect(id('load-track').attributes('disabled')).toBeDefined()
    expect(id('load-track').attributes('aria-label')).toContain('only operators')
  })
})

describe('the picture of the arena', () => {
  it('shows the whole of another world, but stays where it is when a thing is put in', () => {
    const room = new Room({
      url: 'ws://test',
      api: createApi(() => Promise.reject(new Error('off'))),
    })
    const stage = new Stage(room)
    stage.size = { width: 800, height: 600 }
    room.arena.value = { ...ARENA }
    stage.setArena()
    stage.setCamera({ x: 2, y: 1, scale: 300 })
    room.arena.value = { ...ARENA, obstacles: [{ shape: 'circle', x: 0, y: 0, r: 1 }] }
    stage.setArena()
    expect(stage.camera.value).toEqual({ x: 2, y: 1, scale: 300 })
    room.arena.value = { ...ARENA, width: 60 }
    stage.setArena()
    expect(stage.fitted.value).toBe(true)
    expect(stage.camera.value.scale).toBeLessThan(800 / 60)
    stage.stop()
  })
})
