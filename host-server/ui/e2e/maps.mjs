// The map of the selected robot, against the mock: off at first, asked for only while somebody looks, and only of the
// robot that is selected; in words as well as in the picture.

import { apart, id, mock, onPage, open, soon, standing } from './arena-steps.mjs'
import { axe, check, expect, measure, pause, picture } from './checks.mjs'

const said = (page) => id(page, 'map-words').textContent()
const shown = (page) => id(page, 'map-words').getAttribute('data-map')

/** Sends a robot somewhere as far away as it takes to look at its map. */
function send(robot) {
  const { width, height } = mock.world.arena
  const away = (along, size) => (along > 0 ? -0.4 : 0.4) * size
  const goal = { x: away(robot.x, width), y: away(robot.y, height) }
  mock.world.obey(robot, { command: 'goto', parameters: goal }, Date.now(), () => undefined)
}

async function select(page, robot) {
  await id(page, 'search').fill(robot)
  await page.locator(`[data-testid=robot-row][data-robot-id="${robot}"]`).click()
  await id(page, 'search').fill('')
}

async function onDesk(page) {
  await standing(page)
  const [one, two] = mock.world.robots.filter(({ presence }) => presence === 'online')
  mock.maps.asked.length = 0

  await check('maps: nobody is asked before somebody looks', async () => {
    await select(page, one.id)
    await pause(1_200)
    expect(mock.maps.asked.length === 0, `asked ${mock.maps.asked.join()}`)
    expect((await id(page, 'map-words').count()) === 0, 'something is said')
  })

  await check('maps: the layer is switched by keys, and says that there is no map', async () => {
    await id(page, 'layers').focus()
    await page.keyboard.press('Enter')
    for (let at = 0; at < 3; at++) await page.keyboard.press('Tab')
    const focused = await id(page, 'map').evaluate((one) => one === document.activeElement)
    expect(focused, 'not reached')
    expect((await id(page, 'map').inputValue()) === 'none', 'it is on')
    await page.keyboard.press('ArrowUp')
    await soon('nothing is said', async () => (await id(page, 'map-words').count()) === 1)
    await soon(
      'not said',
      async () => (await said(page)).includes('has no map'),
      () => said(page),
    )
    expect((await shown(page)) === null, 'a map is shown')
    await axe(page, 'axe-core, no map')
    // Escape would let go of the robot as well.
    await id(page, 'layers').click()
  })

  await check('maps: a robot on its way shows its map and its plan', async () => {
    send(one)
    await soon(
      'no map',
      async () => (await shown(page)) === one.id,
      () => said(page),
    )
    const words = await said(page)
    expect(words.includes('64 cells blocked') && words.includes('9 cleared'), words)
    expect(words.includes('goal') && !words.includes('no way'), words)
    const times = mock.maps.asked.length
    await soon('it is not asked again', () => mock.maps.asked.length > times)
    await picture(page, 'map')
    await axe(page, 'axe-core, a map')
  })

  await check('maps: another robot is another map', async () => {
    send(two)
    await select(page, two.id)
    await soon('still the one before', async () => (await shown(page)) === two.id)
    const before = mock.maps.asked.length
    await soon('not asked', () => mock.maps.asked.length > before)
    expect(
      mock.maps.asked.slice(before).every((robot) => robot === two.id),
      'both are asked',
    )
  })

  await check('maps: nobody is asked any more when it is switched off', async () => {
    await id(page, 'layers').click()
    await id(page, 'map').selectOption('none')
    await soon('something is said', async () => (await id(page, 'map-words').count()) === 0)
    const before = mock.maps.asked.length
    await pause(1_500)
    expect(mock.maps.asked.length <= before + 1, `${mock.maps.asked.length - before} times`)
  })
}

/** On a phone, in the dark. */
async function onPhone() {
  const page = await open('phone')
  await standing(page)
  await check('maps, phone: a tap shows it, and what is pressed is large enough', async () => {
    const robot = apart()
    await page.touchscreen.tap(...(await onPage(page, robot.x, robot.y)))
    await soon('nothing is selected', async () => {
      return (await id(page, 'robot-panel').getAttribute('data-robot-id')) === robot.id
    })
    send(robot)
    await id(page, 'layers').tap()
    await id(page, 'map').selectOption('selected')
    await soon(
      'no map',
      async () => (await shown(page)) === robot.id,
      () => said(page),
    )
    await measure(page, 'layers with a map, phone, dark')
    await picture(page, 'map-phone-layers')
    await id(page, 'layers').tap()
    await measure(page, 'map, phone, dark')
    await picture(page, 'map-phone')
    return axe(page, 'axe-core, a map, phone, dark')
  })
}

export async function byMaps() {
  await onDesk(await open())
  await onPhone()
}
