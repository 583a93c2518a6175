// Fences, against the mock: drawn by mouse, keys and finger, put up by coordinates, crossed, changed
// and taken down; and what somebody sees who may only watch.

import { startMock } from '../tests/mock/server.mjs'
import { apart, id, mock, onPage, open, openAt, soon, standing } from './arena-steps.mjs'
import { axe, check, expect, measure, pause, picture } from './checks.mjs'

const fences = () => mock.fences.map(({ name }) => name)
const corners = (page) => id(page, 'fence-bar').getAttribute('data-corners')
const row = (page, name) => page.locator(`[data-testid=fence][data-fence="${name}"]`)
const box = (page) => page.locator('.arena-box')

async function openList(page) {
  if ((await id(page, 'fences').getAttribute('aria-expanded')) !== 'true') {
    await id(page, 'fences').click()
  }
  await id(page, 'fence-panel').waitFor()
}

/** Presses at places of the world, slowly enough to be no double click. */
async function press(page, places) {
  for (const [x, y] of places) {
    await page.mouse.click(...(await onPage(page, x, y)))
    await pause(40)
  }
}

async function saved(page, name) {
  await id(page, 'fence-save').click()
  await row(page, name).waitFor()
  await soon('it is not drawn', async () => {
    return (await box(page).getAttribute('data-fences')) === String(mock.fences.length)
  })
}

export async function byFences() {
  const page = await open()
  await standing(page)
  const { width, height } = mock.world.arena
  const [w, h] = [width * 0.32, height * 0.24]

  await check('fences: corners are clicked, taken back, and closed by Enter', async () => {
    await openList(page)
    expect((await id(page, 'fence-panel').textContent()).includes('No fences'), 'not empty')
    await axe(page, 'axe-core, no fences')
    await id(page, 'fence-draw').click()
    await press(page, [
      [-w, -h],
      [w, -h],
      [w, h],
      [0, 0],
    ])
    await soon('four corners', async () => (await corners(page)) === '4')
    await page.keyboard.press('Backspace')
    await soon('three corners', async () => (await corners(page)) === '3')
    // The shape of a bow tie is no fence, and says so before it is closed.
    await press(page, [[0, -1.5 * h]])
    await soon('nothing is said', async () => {
      return (await id(page, 'fence-hint').textContent()).includes('runs into itself')
    })
    await picture(page, 'fence-tangled')
    await page.keyboard.press('Enter')
    await soon('it was closed', async () => (await corners(page)) === '4')
    await id(page, 'fence-back').click()
    await id(page, 'arena').focus()
    await press(page, [[-w, h]])
    await picture(page, 'fence-drawing')
    await page.keyboard.press('Enter')
    await id(page, 'fence-form').waitFor()
    await id(page, 'fence-save').click()
    expect((await id(page, 'fence-form').textContent()).includes('Give it a name'), 'no error')
    await id(page, 'fence-name').fill('yard')
    await id(page, 'fence-action').selectOption('stop')
    await picture(page, 'fence-form')
    await axe(page, 'axe-core, form of a fence')
    await saved(page, 'yard')
    const [yard] = mock.fences
    expect(yard.kind === 'keep_in' && yard.action === 'stop', 'another kind of fence')
    expect(yard.corners.length === 4 && Math.abs(yard.corners[0][0] + w) < 0.05, 'elsewhere')
  })

  await check('fences: a double click closes, Escape gives up', async () => {
    await id(page, 'fence-draw').click()
    await press(page, [[-w / 2, 0]])
    await page.keyboard.press('Escape')
    await id(page, 'fence-panel').waitFor()
    expect(fences().length === 1, 'there is another')
    await id(page, 'fence-draw').click()
    await press(page, [
      [-w / 3, -h / 3],
      [w / 3, -h / 3],
    ])
    await pause(600)
    await page.mouse.dblclick(...(await onPage(page, 0, h / 2)))
    await id(page, 'fence-name').fill('pit')
    await id(page, 'fence-kind').selectOption('keep_out')
    await saved(page, 'pit')
    expect(mock.fences[1].corners.length === 3, `${mock.fences[1].corners.length} corners`)
    await picture(page, 'fence-two')
  })

  await check('fences: a name that is taken, and corners that are none, are refused', async () => {
    await id(page, 'fence-enter').click()
    await id(page, 'fence-name').fill('yard')
    await id(page, 'fence-corners').fill('0, 0\n1, 1\n1, 0\n0, 1')
    await id(page, 'fence-save').click()
    await soon('nothing is said', async () => {
      return (await id(page, 'fence-corners-error').textContent()).includes('cross')
    })
    await id(page, 'fence-corners').fill('0, 0\n1, 0\nx')
    await soon('no line', async () => {
      return (await id(page, 'fence-corners-error').textContent()).includes('Line 3')
    })
    await picture(page, 'fence-refused')
    await id(page, 'fence-corners').fill('0, 0\n1, 0\n1, 1')
    await id(page, 'fence-save').click()
    await soon('nothing is said', async () => {
      return (await id(page, 'fence-failure').textContent()).includes('of that name')
    })
    await axe(page, 'axe-core, refused')
    await id(page, 'fence-form-cancel').click()
    expect(fences().join() === 'yard,pit', fences().join())
  })

  await check('fences: who is beyond one is named wherever robots are', async () => {
    const robot = mock.world.robots.find(({ fence }) => fence === 'yard')
    expect(robot !== undefined, 'nobody is outside of the yard')
    await soon('not counted', async () => {
      return Number(await row(page, 'yard').getAttribute('data-beyond')) > 0
    })
    await id(page, 'search').fill(robot.id)
    const line = page.locator(`[data-testid=robot-row][data-robot-id="${robot.id}"]`)
    expect((await line.textContent()).includes('beyond yard'), 'the list says nothing')
    await line.click()
    await soon('the panel says nothing', async () => {
      return (await id(page, 'robot-fence').textContent()).includes('yard')
    })
    await id(page, 'search').fill('')
    await picture(page, 'fence-beyond')
    await axe(page, 'axe-core, beyond a fence')
    return robot.id
  })

  await check('fences: one who crosses is stopped and told of, and back', async () => {
    const robot = apart()
    const [yard] = mock.fences
    Object.assign(robot, { x: 0, y: -h * 0.8 })
    yard.corners = [
      [-w, -h],
      [w, -h],
      [w, h],
      [-w, h],
    ]
    await soon('not inside', () => (robot.fence ?? null) === null)
    mock.world.obey(robot, { command: 'behave', parameters: { behaviour: 'wander' } }, Date.now())
    Object.assign(robot, { x: 0, y: -h * 1.2 })
    await soon('not beyond', () => robot.fence === 'yard')
    await soon('no event', async () => {
      const log = await page.locator('.event-log').textContent()
      return log.includes('left fence yard')
    })
    expect(robot.v === 0 && robot.w === 0, 'not stopped')
    Object.assign(robot, { x: 0, y: -h * 0.6 })
    await soon('no event of the way back', async () => {
      const log = await page.locator('.event-log').textContent()
      return log.includes('came back into fence yard')
    })
  })

  await check('fences: one is changed, others of other people come by themselves', async () => {
    await id(page, 'fence-edit').first().click()
    await id(page, 'fence-name').fill('court')
    await id(page, 'fence-action').selectOption('warn')
    await saved(page, 'court')
    mock.fences.push({ ...mock.fences[1], id: 'other', name: 'hill', by: 'bob' })
    await row(page, 'hill').waitFor()
    await picture(page, 'fence-three')
  })

  await check('fences: deleting asks first', async () => {
    await row(page, 'hill').getByTestId('fence-remove').click()
    await axe(page, 'axe-core, question')
    await picture(page, 'fence-question')
    await page.getByTestId('cancel').click()
    expect(fences().includes('hill'), 'gone without a word')
    await row(page, 'hill').getByTestId('fence-remove').click()
    await page.getByTestId('confirm').click()
    await row(page, 'hill').waitFor({ state: 'detached' })
    expect(!fences().includes('hill'), 'still there')
    await id(page, 'fence-close').click()
    await picture(page, 'fence-light')
  })
  await byTouch(w, h)
  await byWatcher()
  mock.fences.length = 0
}

/** On a phone, in the dark. */
async function byTouch(w, h) {
  const page = await open('phone')
  await check('fences: fingers draw one, and everything is large enough', async () => {
    await id(page, 'fences').tap()
    await id(page, 'fence-panel').waitFor()
    await measure(page, 'list of fences, phone, dark')
    await picture(page, 'fence-phone-list')
    await id(page, 'fence-draw').tap()
    for (const [x, y] of [
      [-w / 2, -h / 2],
      [w / 2, -h / 2],
      [0, h / 2],
    ]) {
      await page.touchscreen.tap(...(await onPage(page, x, y)))
      await pause(40)
    }
    await soon('three corners', async () => (await corners(page)) === '3')
    await measure(page, 'drawing, phone, dark')
    await picture(page, 'fence-phone-drawing')
    await id(page, 'fence-finish').tap()
    await id(page, 'fence-name').fill('nook')
    await measure(page, 'form of a fence, phone, dark')
    await picture(page, 'fence-phone-form')
    await saved(page, 'nook')
    await id(page, 'fence-close').tap()
    await picture(page, 'fence-phone-dark')
  })
}

async function byWatcher() {
  const closed = await startMock({ robots: 6, seed: 5, open: false })
  closed.accounts.addUser('vera', 'viewer', 'vera watches')
  await check('fences: who may only watch sees them, and why nothing can be changed', async () => {
    const page = await openAt(closed.url)
    await id(page, 'user').fill('vera')
    await id(page, 'password').fill('vera watches')
    await page.keyboard.press('Enter')
    closed.fences.push({
      id: 'f1',
      name: 'yard',
      kind: 'keep_in',
      action: 'warn',
      corners: [
        [-1, -1],
        [1, -1],
        [0, 1],
      ],
      by: 'ada',
      made_at: 1,
    })
    await id(page, 'fences').click()
    await row(page, 'yard').waitFor()
    for (const name of ['fence-draw', 'fence-enter', 'fence-edit', 'fence-remove']) {
      expect(await id(page, name).isDisabled(), `${name} is on`)
    }
    const why = await id(page, 'fence-need').textContent()
    expect(why.includes('operator'), why)
    await picture(page, 'fence-viewer-dark')
    await axe(page, 'axe-core, viewer')
  })
  await closed.close()
}
