// By mouse: choosing, following, drawing around robots, sending them; and a server that is lost.

import { startMock } from '../tests/mock/server.mjs'
import {
  apart,
  arena,
  camera,
  goals,
  id,
  lasso,
  mock,
  onPage,
  online,
  open,
  openAt,
  selected,
  sent,
  settled,
  soon,
  stand,
  standing,
} from './arena-steps.mjs'
import { axe, check, expect } from './checks.mjs'

export async function byMouse() {
  const page = await open()
  await standing(page)
  const robot = apart()

  await check('a click in the arena selects the robot under it', async () => {
    await page.mouse.click(...(await onPage(page, robot.x, robot.y)))
    await soon('nothing is selected', async () => (await selected(page)) === robot.id)
    return robot.id
  })

  await check('a drag moves the view, the wheel zooms, the button shows everything', async () => {
    const before = await camera(page)
    const box = await id(page, 'arena').boundingBox()
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2]
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x + 60, y, { steps: 5 })
    await page.mouse.up()
    const moved = await camera(page)
    expect(moved.x < before.x, 'the view did not move')
    await page.mouse.wheel(0, -400)
    await soon('not zoomed', async () => (await camera(page)).scale > 1.3 * before.scale)
    expect((await id(page, 'minimap').getAttribute('data-shown')) === 'true', 'no overview')
    await id(page, 'fit').click()
    await soon('not everything', async () => {
      return Math.abs((await camera(page)).scale - before.scale) < 0.01
    })
    await soon('the overview stays', async () => !(await id(page, 'minimap').isVisible()))
  })

  await check('the overview moves the view', async () => {
    await id(page, 'zoom-in').click()
    await id(page, 'zoom-in').click()
    const map = await id(page, 'minimap').boundingBox()
    await page.mouse.click(map.x + map.width * 0.25, map.y + map.height * 0.25)
    const corner = await camera(page)
    await page.mouse.move(map.x + map.width * 0.25, map.y + map.height * 0.25)
    await page.mouse.down()
    await page.mouse.move(map.x + map.width * 0.75, map.y + map.height * 0.75, { steps: 4 })
    await page.mouse.up()
    const other = await camera(page)
    const { width, height } = mock.world.arena
    expect(Math.abs(corner.x + width / 4) < 0.1 * width, `x ${corner.x} for a quarter`)
    expect(Math.abs(other.x - width / 4) < 0.1 * width, `x ${other.x} for three quarters`)
    expect(corner.y > 0 && other.y < 0 && height > 0, 'up is not up')
    await id(page, 'fit').click()
  })

  await check('following keeps the robot in the middle until the view is moved', async () => {
    await page.keyboard.press('f')
    await soon('not following', async () => (await arena(page, 'follow')) === 'true')
    mock.world.obey(robot, { command: 'behave', parameters: { behaviour: 'wander' } }, Date.now())
    const from = { x: robot.x, y: robot.y }
    await soon('the robot does not move', () => {
      return Math.hypot(robot.x - from.x, robot.y - from.y) > 0.15
    })
    await soon('the view stays behind', async () => {
      const view = await camera(page)
      return Math.hypot(view.x - robot.x, view.y - robot.y) < 0.15
    })
    await page.keyboard.press('f')
    await soon('still following', async () => (await arena(page, 'follow')) === 'false')
    stand()
    await id(page, 'fit').click()
  })

  await check('a line around robots chooses them, with Shift or the tool', async () => {
    await standing(page)
    await settled(page)
    // Around the five that are nearest to the middle, as far from the sixth as from the fifth.
    const far = mock.world.robots.map(({ x, y }) => Math.hypot(x, y)).sort((a, b) => a - b)
    const metres = (far[4] + far[5]) / 2
    const inside = mock.world.robots.filter(({ x, y }) => Math.hypot(x, y) < metres)
    const middle = await onPage(page, 0, 0)
    const radius = metres * (await camera(page)).scale
    await page.keyboard.down('Shift')
    await lasso(page, middle, radius * 1.02)
    await page.keyboard.up('Shift')
    await soon('nobody is chosen', async () => (await id(page, 'group').count()) === 1)
    const count = Number(await id(page, 'group').getAttribute('data-count'))
    // A robot at the rim may be on either side.
    expect(Math.abs(count - inside.length) <= 2, `${count} chosen of ${inside.length}`)
    await id(page, 'ungroup').click()
    await soon('still chosen', async () => (await id(page, 'group').count()) === 0)
    await id(page, 'lasso').click()
    await lasso(page, middle, radius)
    await soon('nobody is chosen by the tool', async () => (await id(page, 'group').count()) === 1)
    expect((await id(page, 'lasso').getAttribute('aria-pressed')) === 'false', 'the tool stays')
    return `${count} robots`
  })

  await check('a group goes to a click, each robot to a place of its own', async () => {
    const count = Number(await id(page, 'group').getAttribute('data-count'))
    const before = sent('goto').length
    await id(page, 'go').click()
    await page.mouse.click(...(await onPage(page, 0.4, 0.4)))
    await soon('no goals', async () => (await goals(page)).some(({ state }) => state === 'going'))
    const told = sent('goto').slice(before)
    expect(told.length > 0 && told.length <= count, `${told.length} of ${count} were told`)
    const places = new Set(told.map(({ parameters: { x, y } }) => `${x} ${y}`))
    expect(places.size === told.length, 'two robots are sent to one spot')
    await soon('nobody arrives', async () => {
      return (await goals(page)).some(({ state }) => state === 'reached')
    })
    await page.keyboard.press('Escape')
    return `${told.length} robots`
  })

  await check('what became of a goal is said, also when it is refused', async () => {
    stand()
    if ((await id(page, 'group').count()) > 0) await id(page, 'ungroup').click()
    await id(page, 'search').fill(robot.id)
    await page.locator(`[data-robot-id="${robot.id}"][data-testid=robot-row]`).click()
    await id(page, 'search').fill('')
    robot.estopped = true
    await id(page, 'go').click()
    await page.mouse.click(...(await onPage(page, 0.2, 0.2)))
    await soon('no refusal', async () => {
      return (await goals(page)).some(({ state, why }) => state === 'failed' && /re-arm/.test(why))
    })
    robot.estopped = false
    await page.mouse.move(0, 0)
    return axe(page, 'axe-core with goals')
  })

  await check('an open list of layers closes by a press elsewhere', async () => {
    await id(page, 'layers').click()
    await id(page, 'trails').selectOption('all')
    await axe(page, 'axe-core with layers')
    await page.mouse.click(...(await onPage(page, -2, -2)))
    await soon('still open', async () => !(await id(page, 'trails').isVisible()))
  })
}

export async function cutOff() {
  const page = await open()
  stand()
  await page.locator('[data-testid=robot-row][data-presence=online]').first().click()
  const state = () => id(page, 'connection').getAttribute('data-connection')

  await check('losing the server stops driving and greys the picture; it comes back', async () => {
    await id(page, 'drive-pad').focus()
    await page.keyboard.down('ArrowUp')
    await soon('no drive', async () => {
      return (await id(page, 'drive-pad').getAttribute('data-driving')) === 'true'
    })
    mock.setDown(true)
    await soon('not noticed', async () => (await state()) === 'waiting')
    expect((await id(page, 'drive-pad').getAttribute('data-driving')) === 'false', 'still driving')
    expect((await id(page, 'drive-pad').getAttribute('data-blocked')) === 'link', 'not blocked')
    const summary = await id(page, 'summary').textContent()
    expect(summary.includes('As seen'), 'an old picture is not called old')
    await page.keyboard.up('ArrowUp')
    mock.setDown(false)
    await soon('not back', async () => (await state()) === 'live')
    await soon('still blocked', async () => {
      return (await id(page, 'drive-pad').getAttribute('data-blocked')) === ''
    })
    const drawn = Number(await arena(page, 'drawn'))
    online()[0].behaviour = 'wander'
    await soon('no new pictures', async () => Number(await arena(page, 'drawn')) > drawn)
  })
}

export async function byThousands() {
  const many = await startMock({ robots: 3_000, seed: 2 })
  await check('thousands of robots are counted together until the view is near', async () => {
    const page = await openAt(many.url)
    await soon('no clusters', async () => Number(await arena(page, 'clusters')) > 5)
    for (let i = 0; i < 6; i++) await id(page, 'zoom-in').click()
    await soon('still clusters', async () => (await arena(page, 'clusters')) === '0')
  })
  await many.close()
}
