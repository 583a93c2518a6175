// By keyboard alone, by gamepad, by fingers.

import {
  apart,
  camera,
  id,
  mock,
  onPage,
  open,
  selected,
  sent,
  soon,
  stand,
  standing,
} from './arena-steps.mjs'
import { PHONE } from './browser.mjs'
import { axe, check, expect, frames } from './checks.mjs'

export async function byKeyboard() {
  const page = await open()
  await standing(page)

  await check('with keys alone: to the arena, around in it, and to a robot', async () => {
    await page.keyboard.press('Tab')
    const isArena = () => page.evaluate(() => document.activeElement?.dataset?.testid === 'arena')
    for (let i = 0; i < 40 && !(await isArena()); i++) await page.keyboard.press('Tab')
    expect(await isArena(), 'Tab does not come to the arena')
    const before = await camera(page)
    await page.keyboard.press('ArrowRight')
    await page.keyboard.press('ArrowUp')
    const moved = await camera(page)
    expect(moved.x > before.x && moved.y > before.y, 'arrows do not move the view')
    await page.keyboard.press('+')
    await soon('not zoomed', async () => (await camera(page)).scale > before.scale)
    await page.keyboard.press('Home')
    await soon('not everything', async () => {
      return Math.abs((await camera(page)).scale - before.scale) < 0.01
    })
    await page.keyboard.press('Enter')
    await soon('nothing is selected', async () => (await selected(page)) !== null)
    await page.keyboard.press('Shift+Enter')
    await soon('nothing is chosen', async () => (await id(page, 'group').count()) === 1)
    await axe(page, 'axe-core with the cross')
    await page.keyboard.press('Escape')
    await soon('still chosen', async () => (await id(page, 'group').count()) === 0)
    return selected(page)
  })

  await check('keys send a robot to the cross', async () => {
    const before = sent('goto').length
    await page.keyboard.press('g')
    await page.keyboard.press('Enter')
    await soon('no goto', () => sent('goto').length > before)
    stand()
  })

  await check('the pad takes Tab only after Enter, and gives it back with Esc', async () => {
    await id(page, 'robot-stop').focus()
    await page.keyboard.press('Shift+Tab')
    const inPad = () => page.evaluate(() => document.activeElement?.closest('#drive-pad') !== null)
    for (let i = 0; i < 8; i++) {
      if (await page.evaluate(() => document.activeElement?.id === 'drive-pad')) break
      await page.keyboard.press('Shift+Tab')
    }
    expect(await inPad(), 'Tab does not come to the pad')
    const captured = () => id(page, 'drive-pad').getAttribute('data-captured')
    expect((await captured()) === 'false', 'the pad takes the keyboard unasked')
    await page.keyboard.press('Enter')
    expect((await captured()) === 'true', 'Enter does not give it the keyboard')
    const first = await selected(page)
    await page.keyboard.press('Tab')
    await soon('Tab does not change robots', async () => (await selected(page)) !== first)
    await page.keyboard.press('Shift+Tab')
    await soon('Shift Tab does not go back', async () => (await selected(page)) === first)
    await page.keyboard.press('Escape')
    expect((await captured()) === 'false', 'Esc does not take it back')
    await page.keyboard.press('Tab')
    expect((await selected(page)) === first, 'Tab still changes robots')
  })

  await check('a held arrow drives, and Space stops all from anywhere', async () => {
    const robot = apart()
    await id(page, 'search').fill(robot.id)
    await page.keyboard.press('Enter')
    await page.locator(`[data-robot-id="${robot.id}"][data-testid=robot-row]`).click()
    await id(page, 'search').fill('')
    await id(page, 'drive-pad').focus()
    const before = sent('drive').length
    await page.keyboard.down('ArrowUp')
    await soon('no drive', () => sent('drive').length > before + 1)
    await id(page, 'layers').focus()
    await page.keyboard.press('Space')
    await soon('no stop', () => sent('estop').length > 0)
    await page.keyboard.up('ArrowUp')
    await soon('not latched', async () => {
      return (await id(page, 'stop-panel').getAttribute('data-stop')) === 'stopped'
    })
    expect((await id(page, 'drive-pad').getAttribute('data-blocked')) === 'stopped', 'not blocked')
    expect(!(await id(page, 'trails').isVisible()), 'Space pressed the button too')
    await page.keyboard.press('g')
    const hint = await id(page, 'arena-hint').textContent()
    expect(hint.includes('Emergency stop'), `"${hint}" does not say why nothing can go`)
    await id(page, 'rearm').click()
    await soon('still latched', async () => {
      return (await id(page, 'stop-panel').getAttribute('data-stop')) === 'armed'
    })
  })
}

/** A gamepad that the page believes in. */
function plug() {
  const pad = {
    id: 'Test pad',
    index: 0,
    connected: true,
    axes: [0, 0, 0, 0],
    buttons: Array.from({ length: 17 }, () => ({ pressed: false })),
  }
  globalThis.testPad = pad
  navigator.getGamepads = () => [globalThis.testPad]
  const event = new Event('gamepadconnected')
  Object.defineProperty(event, 'gamepad', { value: pad })
  dispatchEvent(event)
}

export async function byGamepad() {
  const page = await open()
  stand()
  const robot = apart()
  await id(page, 'search').fill(robot.id)
  await page.locator(`[data-robot-id="${robot.id}"][data-testid=robot-row]`).click()
  const last = () => mock.commands.at(-1)
  const driving = () => id(page, 'drive-pad').getAttribute('data-driving')
  const push = (x, y) => page.evaluate(([x, y]) => (globalThis.testPad.axes = [x, y]), [x, y])

  await check('a gamepad drives, and letting go of the stick stops', async () => {
    await page.evaluate(plug)
    await id(page, 'gamepad').waitFor()
    await frames(page)
    await push(0, -0.8)
    await soon('no drive', () => last()?.command === 'drive' && last().parameters.v > 0.1)
    await push(0.02, -0.03)
    await soon('no stop', () => last()?.command === 'stop')
    expect((await driving()) === 'false', 'still driving')
  })

  await check('after a stop the stick must be let go first', async () => {
    await push(0, -1)
    await soon('no drive', async () => (await driving()) === 'true')
    await page.evaluate(() => dispatchEvent(new Event('blur')))
    await soon('still driving', async () => (await driving()) === 'false')
    await frames(page, 30)
    expect((await driving()) === 'false', 'it drives on by itself')
    await push(0, 0)
    await frames(page)
    await push(0, -1)
    await soon('no drive again', async () => (await driving()) === 'true')
  })

  await check('a gamepad that is unplugged stops, and its button stops all', async () => {
    await page.evaluate(() => {
      const event = new Event('gamepaddisconnected')
      Object.defineProperty(event, 'gamepad', { value: globalThis.testPad })
      dispatchEvent(event)
    })
    await soon('still driving', async () => (await driving()) === 'false')
    expect((await id(page, 'gamepad').count()) === 0, 'it is still named')
    await page.evaluate(plug)
    await id(page, 'gamepad').waitFor()
    const before = sent('estop').length
    await page.evaluate(() => (globalThis.testPad.buttons[1] = { pressed: true }))
    await soon('no stop', () => sent('estop').length > before)
    await id(page, 'rearm').click()
    await soon('still latched', async () => {
      return (await id(page, 'stop-panel').getAttribute('data-stop')) === 'armed'
    })
  })
}

export async function byFinger() {
  const page = await open('phone')
  await standing(page)

  await check('fingers: a tap selects, and what is pressed is large enough', async () => {
    const robot = apart()
    await page.touchscreen.tap(...(await onPage(page, robot.x, robot.y)))
    await soon('nothing is selected', async () => (await selected(page)) === robot.id)
    for (const name of ['zoom-in', 'fit', 'follow', 'lasso', 'go', 'layers', 'pad-forward']) {
      const box = await id(page, name).boundingBox()
      expect(box !== null && box.width >= 44 && box.height >= 44, `${name} is too small`)
    }
    const wide = await page.evaluate(() => document.documentElement.scrollWidth)
    expect(wide <= PHONE.width, `the page is ${wide} pixels wide`)
  })

  await check('fingers: two of them zoom, one draws a line with the tool', async () => {
    const box = await id(page, 'arena').boundingBox()
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2 + 20]
    const session = await page.context().newCDPSession(page)
    const touch = (type, ...points) =>
      session.send('Input.dispatchTouchEvent', {
        type,
        touchPoints: points.map(([px, py], at) => ({ x: px, y: py, id: at })),
      })
    const before = (await camera(page)).scale
    await touch('touchStart', [x - 30, y])
    await touch('touchStart', [x - 30, y], [x + 30, y])
    for (let i = 1; i <= 6; i++) await touch('touchMove', [x - 30 - 5 * i, y], [x + 30 + 5 * i, y])
    await touch('touchEnd')
    await soon('not zoomed', async () => (await camera(page)).scale > 1.5 * before)
    await id(page, 'fit').tap()
    await id(page, 'lasso').tap()
    await touch('touchStart', [box.x + 20, box.y + 60])
    for (const [px, py] of [
      [box.width - 20, 60],
      [box.width - 20, box.height - 10],
      [20, box.height - 10],
    ]) {
      await touch('touchMove', [box.x + px, box.y + py])
    }
    await touch('touchEnd')
    await soon('nobody is chosen', async () => (await id(page, 'group').count()) === 1)
  })

  await check('fingers: holding a button drives, lifting stops; nothing violates', async () => {
    const box = await id(page, 'pad-forward').boundingBox()
    const session = await page.context().newCDPSession(page)
    const point = { x: box.x + box.width / 2, y: box.y + box.height / 2 }
    const before = sent('drive').length
    await session.send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: [point] })
    await soon('no drive', () => sent('drive').length > before + 1)
    await session.send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] })
    await soon('no stop', () => mock.commands.at(-1)?.command === 'stop')
    return axe(page, 'axe-core, phone, dark')
  })
}
