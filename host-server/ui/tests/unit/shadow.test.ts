// @vitest-environment happy-dom

import { mount } from '@vue/test-utils'
import { expect, it } from 'vitest'
import { createApi } from '../../src/api'
import RobotShadow from '../../src/pages/robot/RobotShadow.vue'

const told = {
  policy: 'candidate',
  decisions: 1_200,
  agreed: 1_128,
  vetoes: 60,
  driving_vetoes: 84,
  agreement: { share: 0.94, low: 0.925, high: 0.952 },
  veto_share: { share: 0.05, low: 0.039, high: 0.064 },
  driving_veto_share: { share: 0.07, low: 0.057, high: 0.086 },
}

async function detailsOf(shadow: unknown) {
  const api = createApi(() =>
    Promise.resolve(
      new Response(JSON.stringify({ id: 'a', shadow }), {
        headers: { 'content-type': 'application/json' },
      }),
    ),
  )
  return (await api.robot('a')).shadow
}

it('what a robot compares is read, and what is none is not', async () => {
  const shadow = await detailsOf(told)
  expect(shadow).toEqual({
    policy: 'candidate',
    decisions: 1_200,
    agreement: told.agreement,
    vetoes: told.veto_share,
    drivingVetoes: told.driving_veto_share,
  })
  for (const none of [null, undefined, 7, {}, { policy: 'candidate' }, { decisions: 1 }]) {
    expect(await detailsOf(none)).toBe(null)
  }
  const waits = { ...told, decisions: 0, agreement: null, veto_share: { share: 1 } }
  expect(await detailsOf(waits)).toMatchObject({ decisions: 0, agreement: null, vetoes: null })
})

it('the tile has the shares with their intervals, and ends the comparison', async () => {
  const shadow = await detailsOf(told)
  if (shadow === null) throw new Error('there is one')
  const tile = mount(RobotShadow, { props: { shadow, may: true } })
  expect(tile.text()).toContain('Candidate candidate')
  expect(tile.text()).toContain('1,200')
  expect(tile.text()).toContain('94.0 % (95 %: 92.5 to 95.2)')
  await tile.get('[data-testid=shadow-end]').trigger('click')
  expect(tile.emitted('end')).toHaveLength(1)
  await tile.setProps({ may: false })
  expect(tile.get('[data-testid=shadow-end]').attributes('disabled')).toBeDefined()
  await tile.setProps({ shadow: { ...shadow, decisions: 0, agreement: null } })
  expect(tile.find('[data-testid=shadow-waits]').exists()).toBe(true)
  expect(tile.find('dl').exists()).toBe(false)
})
