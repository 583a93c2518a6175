// @vitest-environment happy-dom

import { mount } from '@vue/test-utils'
import { describe, expect, it, vi } from 'vitest'
import { nextTick } from 'vue'
import { createApi } from '../../src/api'
import StopPanel from '../../src/components/StopPanel.vue'
import { ROOM, Room } from '../../src/control/room'
import type { ConnectionState } from '../../src/feed/connection'

function setUp(state: ConnectionState) {
  const answer = () => Promise.resolve(new Response('{"id":"1"}', { status: 202 }))
  const room = new Room({ url: 'ws://test', api: createApi(answer) })
  room.fleet.applyRoster({
    kind: 'roster',
    removed: [],
    robots: [
      {
        index: 0,
        id: 'sim-0001',
        kind: 'simulated',
        presence: 'online',
        firmware: '',
        board: '',
      },
    ],
  })
  room.status.value = { state, attempt: 0, retryAt: null }
  const panel = mount(StopPanel, { global: { provide: { [ROOM as symbol]: room } } })
  return { room, panel }
}

describe('the stop panel', () => {
  it('latches and offers to re-arm', async () => {
    const { panel } = setUp('live')
    await panel.find('[data-testid=stop-all]').trigger('click')
    expect(panel.attributes('data-stop')).toBe('sending')
    expect(panel.find('[data-testid=rearm]').attributes('disabled')).toBeDefined()
    await vi.waitFor(() => expect(panel.attributes('data-stop')).toBe('stopped'), 60_000)
    expect(panel.text()).toContain('All 1 reachable robots stand')
    expect(panel.find('[data-testid=wander-all]').exists()).toBe(false)
  })

  it('claims nothing about robots it does not see', async () => {
    const { room, panel } = setUp('waiting')
    room.stopAll()
    await nextTick()
    expect(panel.text()).toContain('cannot be seen')
    expect(panel.text()).not.toContain('robots stand.')
  })
})
