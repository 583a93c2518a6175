// The twin of the selected robot, against the mock: off at first, asked for only while somebody looks, and only that of
// the robot that is selected; in words as well as in the picture. And what it finds wrong, on the page of the robot.

import { id, mock, open, openAt, soon, standing } from './arena-steps.mjs'
import { axe, check, expect, pause, picture } from './checks.mjs'

const seen = (page, name) =>
  id(page, name)
    .count()
    .then((count) => count === 1)

const said = (page) => id(page, 'twin-words').textContent()
const shown = (page) => id(page, 'twin-words').getAttribute('data-twin')

async function select(page, robot) {
  await id(page, 'search').fill(robot)
  await page.locator(`[data-testid=robot-row][data-robot-id="${robot}"]`).click()
  await id(page, 'search').fill('')
}

export async function byTwins() {
  const page = await open()
  await standing(page)
  const [one, two] = mock.world.robots.filter(({ presence }) => presence === 'online')
  mock.twins.asked.length = 0

  await check('twins: nobody is asked for before somebody looks', async () => {
    await select(page, one.id)
    await pause(1_000)
    expect(mock.twins.asked.length === 0, `asked ${mock.twins.asked.join()}`)
  })

  await check('twins: the layer shows that of the robot that is selected', async () => {
    await id(page, 'layers').click()
    await id(page, 'twin').selectOption('selected')
    await soon('no twin', async () => (await id(page, 'twin-words').count()) === 1)
    await soon(
      'not shown',
      async () => (await shown(page)) === one.id,
      () => said(page),
    )
    const words = await said(page)
    expect(words.includes('± 1.2 cm') && words.includes('in 1 s'), words)
    const times = mock.twins.asked.length
    await soon('it is not asked again', () => mock.twins.asked.length > times + 1)
    await id(page, 'layers').click()
    await picture(page, 'twin')
    await axe(page, 'axe-core, a twin')
    await select(page, two.id)
    await soon('still the one before', async () => (await shown(page)) === two.id)
  })

  await check('twins: nobody is asked for any more when it is switched off', async () => {
    await id(page, 'layers').click()
    await id(page, 'twin').selectOption('none')
    await soon('something is said', async () => (await id(page, 'twin-words').count()) === 0)
    const before = mock.twins.asked.length
    await pause(1_000)
    expect(mock.twins.asked.length <= before + 1, `${mock.twins.asked.length - before} times`)
  })

  await check('twins: the page of a robot says what is wrong with it', async () => {
    mock.twins.weak.add(one.id)
    await page.goto(`${mock.url}/#/robots/${one.id}`)
    await soon('no fault', async () => (await id(page, 'twin-fault').count()) === 1)
    const words = await id(page, 'twin-fault').textContent()
    expect(words.includes('Left motor weak: 12 % is missing'), words)
    await axe(page, 'axe-core, a fault')
    mock.twins.weak.delete(one.id)
    mock.twins.stale.add(one.id)
    await soon('no certificate is stale', () => seen(page, 'twin-stale'))
    mock.twins.stale.delete(one.id)
    await soon('still there', async () => (await id(page, 'twin-well').count()) === 1)
  })

  await check('gap: the report is a link away from a twin, the worst robot first', async () => {
    await id(page, 'twin-gap').click()
    await soon('no rows', async () => (await id(page, 'gap-row').count()) === 9)
    const rows = await id(page, 'gap-row').allTextContents()
    expect(rows[0].includes('All robots') && rows[0].includes('floor 1.2 cm'), rows[0])
    expect(rows[1].includes('8.0 cm') && rows[1].includes('17 %'), rows[1])
    expect(rows[8].includes('too few'), rows[8])
    await picture(page, 'gap')
    await axe(page, 'axe-core, the reality gap')
    const hand = await openAt(`${mock.url}/#/robots?gap=yes`, 'phone')
    await soon('no rows', async () => (await id(hand, 'gap-row').count()) === 9)
    const wide = await hand.evaluate(() => document.documentElement.scrollWidth - innerWidth)
    expect(wide <= 0, `${wide} pixels too wide`)
    await picture(hand, 'gap-phone')
    await id(hand, 'gap-close').click()
    await soon('no list', () => seen(hand, 'gap-open'))
    await id(hand, 'gap-open').click()
    await soon('no report', () => seen(hand, 'gap'))
    await page.goto(`${mock.url}/#/robots/${one.id}`)
    await soon('no page', () => seen(page, 'calibrate-open'))
  })

  await check('calibration: what it would be is shown before anything drives', async () => {
    await id(page, 'calibrate-open').click()
    await soon('no outline', () => seen(page, 'calibrate-outline'))
    const words = await id(page, 'calibrate-takes').textContent()
    expect(words.includes('80 s on 1.2 × 1.3 m'), words)
    expect(
      (await id(page, 'calibrate-permit').textContent()).includes('may begin'),
      'not permitted',
    )
    await id(page, 'calibrate-around').fill('0.5')
    await id(page, 'calibrate-around').press('Enter')
    await soon('still permitted', async () => {
      return (await id(page, 'calibrate-permit').getAttribute('data-refused')) === 'leaves'
    })
    expect(!(await seen(page, 'calibrate-begin')), 'it can be begun all the same')
    await id(page, 'calibrate-around').fill('')
    await id(page, 'calibrate-open').click()
    await soon('not permitted', () => seen(page, 'calibrate-begin'))
    await picture(page, 'calibrate')
    await axe(page, 'axe-core, before a calibration')
    expect(mock.twins.calibrations.length === 0, 'it has begun by itself')
  })

  await check('calibration: it begins when somebody has said that the floor is free', async () => {
    await id(page, 'calibrate-floor').fill('lino')
    await id(page, 'calibrate-begin').click()
    await id(page, 'cancel').click()
    expect(mock.twins.calibrations.length === 0, 'a no began it')
    await id(page, 'calibrate-begin').click()
    await id(page, 'confirm').click()
    await soon('nothing begins', () => seen(page, 'calibrate-state'))
    expect(mock.twins.calibrations[0]?.floor === 'lino', 'the floor is lost')
    await id(page, 'calibrate-stop').click()
    await soon('it goes on', () => seen(page, 'calibrate-result'))
    const words = await id(page, 'calibrate-result').textContent()
    expect(words.includes('Broken off') && words.includes('stopped it'), words)
  })

  await check('calibration: a phone shows each step and what came of it', async () => {
    await page.setViewportSize({ width: 390, height: 800 })
    await id(page, 'calibrate-open').click()
    await soon('not permitted', () => seen(page, 'calibrate-begin'))
    await id(page, 'calibrate-begin').click()
    await id(page, 'confirm').click()
    await soon('no held-out drive', async () => {
      if (!(await seen(page, 'calibrate-state'))) return false
      return (await id(page, 'calibrate-state').getAttribute('data-state')) === 'held_out'
    })
    const wide = await page.evaluate(() => document.documentElement.scrollWidth)
    expect(wide <= 390, `the page is ${wide} px wide`)
    await soon('no result', () => seen(page, 'calibrate-errors'))
    const words = await id(page, 'calibrate-errors').textContent()
    expect(words.includes('4.1 cm') && words.includes('52.0 cm'), words)
    await picture(page, 'calibrated')
    await axe(page, 'axe-core, after a calibration')
  })
}
