// @vitest-environment happy-dom

import { mount } from '@vue/test-utils'
import { expect, it, vi } from 'vitest'
import type { RobotDetails } from '../../src/api'
import { createApi } from '../../src/api'
import RobotPanel from '../../src/components/RobotPanel.vue'
import { ROOM, Room } from '../../src/control/room'

const details = (image: number | null): RobotDetails => ({
  behaviour: null,
  batteryPercent: null,
  batteryMillivolts: null,
  temperature: null,
  rssi: null,
  camera: true,
  image,
  sees: null,
  wheels: null,
  sigma: null,
  uptime: null,
  lastSeen: null,
  boot: null,
  protocol: null,
  build: null,
  models: [],
  capabilities: [],
  shadow: null,
  link: null,
  duplicate: false,
})

it('a picture is fetched with the token, shown, and given back', async () => {
  const asked: string[] = []
  const given: string[] = []
  vi.stubGlobal(
    'URL',
    Object.assign(URL, {
      createObjectURL: () => `blob:${String(asked.length)}`,
      revokeObjectURL: (address: string) => given.push(address),
    }),
  )
  const api = createApi((url) => {
    if ((url as string).includes('/image')) asked.push(url as string)
    return Promise.resolve(new Response(new Blob(['jpeg'])))
  })
  const room = new Room({ url: 'ws://test', api })
  room.selectedId.value = 'rover-1'
  const panel = mount(RobotPanel, { global: { provide: { [ROOM as symbol]: room } } })
  const source = () => panel.find('[data-testid=robot-picture]').attributes('src')

  room.details.value = details(5)
  await vi.waitFor(() => expect(source()).toBe('blob:1'))
  room.details.value = details(6)
  await vi.waitFor(() => expect(source()).toBe('blob:2'))
  expect(asked).toEqual([
    '/api/v1/robots/rover-1/image?received=5',
    '/api/v1/robots/rover-1/image?received=6',
  ])
  expect(given).toEqual(['blob:1'])
  panel.unmount()
  expect(given).toEqual(['blob:1', 'blob:2'])
})
