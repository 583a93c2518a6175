// @vitest-environment happy-dom

import { mount } from '@vue/test-utils'
import { afterEach, describe, expect, it, vi } from 'vitest'
import { nextTick, ref } from 'vue'
import type { Role } from '../../src/account/roles'
import { createApi } from '../../src/api'
import type { FenceBody, NewFence } from '../../src/api-types'
import { Stage } from '../../src/arena/stage'
import { ArenaTools } from '../../src/arena/tools'
import { ROOM, Room } from '../../src/control/room'
import type { FencesApi } from '../../src/fences/api'
import FencePanel from '../../src/fences/FencePanel.vue'
import { FenceLayer } from '../../src/fences/layer'
import { ApiError } from '../../src/http'

const yard: FenceBody = {
  id: '1',
  name: 'yard',
  kind: 'keep_in',
  action: 'stop',
  corners: [
    [0, 0],
    [2, 0],
    [2, 2],
  ],
  by: 'ada',
  made_at: 1,
}
const keys = { shiftKey: false, ctrlKey: false, metaKey: false }

/** A server that keeps fences, and what was asked of it. */
function server(fences: FenceBody[] = []) {
  const calls: string[] = []
  const api: FencesApi = {
    list: () => Promise.resolve([...fences]),
    add(fence: NewFence) {
      calls.push(`add ${fence.name} ${JSON.stringify(fence.corners)}`)
      if (fences.some(({ name }) => name === fence.name)) {
        return Promise.reject(new ApiError('Conflict', 409, 'exists', null, 'taken'))
      }
      fences.push({ ...fence, id: '9', by: 'ada', made_at: 2 })
      return Promise.resolve(fences.at(-1) as FenceBody)
    },
    change(id: string, fence: NewFence) {
      calls.push(`change ${id} ${fence.name} ${fence.kind}`)
      fences.splice(0, 1, { ...yard, ...fence })
      return Promise.resolve(fences[0] as FenceBody)
    },
    remove(id: string) {
      calls.push(`remove ${id}`)
      fences.length = 0
      return Promise.resolve()
    },
  }
  return { api, calls }
}

function setUp(fences: FenceBody[] = [], role: Role = 'operator') {
  const off = createApi(() => Promise.reject(new Error('off')))
  const room = new Room({ url: 'ws://test', api: off, role: ref(role) })
  const stage = new Stage(room)
  // One pixel to the centimetre; the middle of the picture is at 0, 0.
  stage.size = { width: 800, height: 600 }
  stage.camera.value = { x: 0, y: 0, scale: 100 }
  const tools = new ArenaTools(room, stage, () => undefined)
  const { api, calls } = server(fences)
  const layer = new FenceLayer(room, stage, tools, api)
  layer.start()
  const press = (x: number, y: number) => tools.tap(400 + 100 * x, 300 - 100 * y, keys)
  return { room, tools, layer, calls, press }
}

function wait(): void {
  vi.setSystemTime(Date.now() + 1_000)
}

afterEach(() => vi.useRealTimers())

/** Draws a triangle, slowly. */
function triangle(press: (x: number, y: number) => void): void {
  for (const [x, y] of [
    [0, 0],
    [1, 0],
    [0, 1],
  ] as const) {
    wait()
    press(x, y)
  }
}

describe('drawing a fence', () => {
  it('takes presses of the arena as corners until Enter', async () => {
    vi.useFakeTimers({ toFake: ['Date', 'performance'] })
    const { layer, tools, press } = setUp()
    const drawn = layer.draw()
    expect(tools.tool.value).toBe('fence')
    triangle(press)
    expect(layer.corners.value).toHaveLength(3)
    tools.aim(false)
    expect(await drawn).toEqual([
      [0, 0],
      [1, 0],
      [0, 1],
    ])
    expect([tools.tool.value, layer.corners.value]).toEqual(['none', null])
    layer.stop()
  })

  it('does not close what is no fence, and says why', () => {
    vi.useFakeTimers({ toFake: ['Date', 'performance'] })
    const { layer, tools, press } = setUp()
    void layer.draw()
    press(0, 0)
    tools.aim(false)
    expect(layer.refused.value).toContain('at least 3')
    triangle(press)
    wait()
    press(0.5, -1)
    expect(layer.refused.value).toContain('runs into itself')
    layer.takeBack()
    expect(layer.refused.value).toBe('')
    layer.stop()
  })

  it('is given up by Escape, by another tool, and begun anew', async () => {
    const { layer, tools, press } = setUp()
    const first = layer.draw()
    press(0, 0)
    expect(tools.leave()).toBe(true)
    expect(await first).toBeNull()
    const second = layer.draw()
    tools.toggle('lasso')
    expect(await second).toBeNull()
    expect(tools.tool.value).toBe('lasso')
    const third = layer.draw()
    void layer.draw()
    expect(await third).toBeNull()
    expect(tools.tool.value).toBe('fence')
    layer.stop()
  })

  it('takes the last corner back by Backspace, but not out of a text field', () => {
    vi.useFakeTimers({ toFake: ['Date', 'performance'] })
    const { layer, press } = setUp()
    void layer.draw()
    triangle(press)
    const field = document.createElement('input')
    document.body.append(field)
    field.dispatchEvent(new KeyboardEvent('keydown', { key: 'Backspace', bubbles: true }))
    expect(layer.corners.value).toHaveLength(3)
    document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'Backspace', bubbles: true }))
    expect(layer.corners.value).toHaveLength(2)
    layer.stop()
  })

  it('leaves choosing robots alone once it is over', () => {
    const { layer, tools, room, press } = setUp()
    layer.stop()
    press(0, 0)
    expect([tools.tool.value, room.selectedId.value]).toEqual(['none', null])
  })
})

describe('the list of fences', () => {
  function show(fences: FenceBody[], role: Role = 'operator') {
    const parts = setUp(fences, role)
    const panel = mount(FencePanel, {
      props: { layer: parts.layer },
      global: { provide: { [ROOM as symbol]: parts.room } },
      attachTo: document.body,
    })
    return { ...parts, panel, by: (name: string) => panel.find(`[data-testid=${name}]`) }
  }
  const settled = async () => {
    for (let i = 0; i < 5; i++) await Promise.resolve()
    await nextTick()
  }

  it('names who is beyond one', async () => {
    const { room, panel, layer, by } = show([yard])
    room.fleet.applyRoster({
      kind: 'roster',
      removed: [],
      robots: ['a', 'b'].map((id, index) => ({
        index,
        id,
        kind: 'simulated' as const,
        presence: 'online' as const,
        firmware: '',
        board: '',
        ...(id === 'b' ? { fence: 'yard' } : {}),
      })),
    })
    room.tick.value += 1
    await settled()
    expect(by('fence').text()).toContain('Keep in')
    expect(by('fence').text()).toContain('Beyond it: b')
    layer.stop()
    panel.unmount()
  })

  it('puts one up from coordinates, and says when that is refused', async () => {
    const { panel, layer, by, calls } = show([yard])
    await settled()
    await by('fence-enter').trigger('click')
    await by('fence-form').trigger('submit')
    expect(panel.text()).toContain('Give it a name')
    expect(by('fence-corners-error').text()).toContain('at least 3')
    await by('fence-name').setValue('yard')
    await by('fence-corners').setValue('0, 0\n1, 0\n0, 1')
    await by('fence-form').trigger('submit')
    await settled()
    expect(by('fence-failure').text()).toContain('taken')
    await by('fence-name').setValue(' pit ')
    await by('fence-form').trigger('submit')
    await settled()
    expect(calls.at(-1)).toBe('add pit [[0,0],[1,0],[0,1]]')
    expect(panel.findAll('[data-testid=fence]')).toHaveLength(2)
    layer.stop()
    panel.unmount()
  })

  it('changes one, and asks before it takes one down', async () => {
    const { panel, layer, by, calls } = show([yard])
    await settled()
    await by('fence-edit').trigger('click')
    expect((by('fence-corners').element as HTMLTextAreaElement).value).toBe('0, 0\n2, 0\n2, 2')
    await by('fence-kind').setValue('keep_out')
    await by('fence-form').trigger('submit')
    await settled()
    expect(calls).toEqual(['change 1 yard keep_out'])
    await by('fence-remove').trigger('click')
    expect(panel.text()).toContain('Delete fence yard?')
    await by('cancel').trigger('click')
    await by('fence-remove').trigger('click')
    await by('confirm').trigger('click')
    await settled()
    expect(calls.at(-1)).toBe('remove 1')
    expect(panel.findAll('[data-testid=fence]')).toHaveLength(0)
    layer.stop()
    panel.unmount()
  })

  it('says to viewers why nothing can be changed', async () => {
    const { panel, layer, by } = show([yard], 'viewer')
    await settled()
    for (const name of ['fence-draw', 'fence-enter', 'fence-edit', 'fence-remove']) {
      expect(by(name).attributes('disabled')).toBeDefined()
    }
    expect(by('fence-need').text()).toContain('operator')
    layer.stop()
    panel.unmount()
  })
})
