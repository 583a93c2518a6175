// `npm run e2e:updates`: releases added, looked at and withdrawn, in a real browser, against the open server at
// BASE_URL, with the files RELEASE and FORGED; without one every state and size is looked at, with the mock.

import { startMock } from '../tests/mock/server.mjs'
import { DESKTOP, PHONE, launch } from './browser.mjs'
import { axe, axeDark, check, expect, fail, finish, guarded } from './checks.mjs'
import { measure, openPage, picture, until } from './checks.mjs'

const mock = process.env.BASE_URL === undefined ? await startMock({ robots: 12, open: true }) : null
const base = mock?.url ?? process.env.BASE_URL
const id = (page, name) => page.getByTestId(name)

async function goTo(page, place) {
  await page.goto(`${base}/#/${place}`)
  await until('the feed is not live', async () => {
    const lamp = id(page, 'connection')
    return (await lamp.count()) > 0 && (await lamp.getAttribute('data-connection')) === 'live'
  })
  await page.locator('#page-title').waitFor()
}

async function give(page, file) {
  await id(page, 'release-file').setInputFiles(file)
  await id(page, 'send-release').click()
}

async function withdraw(page, reason) {
  await id(page, 'withdraw').click()
  await page.locator('.trouble').waitFor()
  await id(page, 'withdraw-reason').fill(reason)
  await id(page, 'withdraw').click()
  await id(page, 'confirm').waitFor()
  await axe(page, 'a question')
  await id(page, 'confirm').click()
  await id(page, 'release-withdrawn').waitFor()
  const words = await id(page, 'release-withdrawn').textContent()
  expect(words.includes(reason), `it says ${words}`)
  expect((await id(page, 'withdraw').count()) === 0, 'it can be withdrawn twice')
}

async function real(page) {
  await check('there are none yet, and the page says how to make one', async () => {
    await goTo(page, 'updates')
    await id(page, 'releases-empty').waitFor()
    return axe(page, 'empty')
  })
  await check('without a file nothing is sent, and the field says so', async () => {
    await id(page, 'send-release').click()
    await page.locator('.trouble').waitFor()
    const focused = await page.evaluate(() => document.activeElement?.dataset.testid)
    expect(focused === 'release-file', `${focused} has the focus`)
  })
  await check('a forged one is refused, with the reason', async () => {
    await give(page, process.env.FORGED)
    await id(page, 'release-refused').waitFor()
    const codes = await page.locator('[data-fault]').evaluateAll((all) => {
      return all.map((one) => one.dataset.fault)
    })
    expect(codes.join() === 'bad_block', `it says ${codes.join()}`)
    await axe(page, 'refused')
  })
  await check('a genuine one is added, and shown to the last field', async () => {
    await give(page, process.env.RELEASE)
    await id(page, 'release-added').waitFor()
    const row = page.locator('[data-release]')
    await row.first().waitFor()
    expect((await row.count()) === 1, 'it is there more than once')
    await row.locator('a').click()
    await id(page, 'release').waitFor()
    await page.locator('#release-title').waitFor()
    const words = await page.locator('.release-facts').textContent()
    for (const told of ['virt', '0.4.0', 'abc123', '12', '2099']) {
      expect(words.includes(told), `${told} is not in ${words}`)
    }
    await axe(page, 'a release')
  })
  await check('the same one again is refused', async () => {
    await goTo(page, 'updates')
    await give(page, process.env.RELEASE)
    await id(page, 'release-refused').waitFor()
    const words = await id(page, 'release-refused').textContent()
    expect(words.includes('already'), `it says ${words}`)
  })
  await check('it is withdrawn for good, with a reason', async () => {
    await page.locator('[data-release] a').click()
    await id(page, 'withdraw').waitFor()
    await withdraw(page, 'drives into walls')
    await goTo(page, 'updates')
    await page.locator('[data-standing=withdrawn]').waitFor()
  })
}

async function looks(page) {
  for (const [name, place, ready] of [
    ['updates', 'updates', 'releases'],
    ['release', `updates/${mock.releases[0].id}`, 'withdraw'],
    ['release-withdrawn', `updates/${mock.releases[1].id}`, 'release-withdrawn'],
    ['release-unknown', 'updates/nobody', 'release-unknown'],
  ]) {
    await check(`${name} on a desktop and a phone`, async () => {
      await page.setViewportSize(DESKTOP)
      await goTo(page, place)
      await id(page, ready).waitFor()
      await axeDark(page, name, () => picture(page, `${name}-dark`))
      await axe(page, name)
      await picture(page, name)
      await page.setViewportSize(PHONE)
      await measure(page, `${name} on a phone`)
      await picture(page, `${name}-phone`)
    })
  }
  await page.setViewportSize(DESKTOP)
  await check('states are told apart', async () => {
    await goTo(page, 'updates')
    for (const standing of ['good', 'expired', 'withdrawn']) {
      await page.locator(`[data-standing=${standing}]`).first().waitFor()
    }
  })
  await check('a refusal is told with its reason', async () => {
    const file = {
      name: 'x.release',
      mimeType: 'application/octet-stream',
      buffer: Buffer.from('x'),
    }
    await give(page, file)
    await page.locator('[data-fault=bad_signature]').waitFor()
    await picture(page, 'release-refused')
    return axe(page, 'refused')
  })
  await check('one is withdrawn', async () => {
    await goTo(page, `updates/${mock.releases[3].id}`)
    await id(page, 'withdraw').waitFor()
    await withdraw(page, 'sees ghosts')
  })
}

const deadline = guarded()
const browser = await launch()
try {
  const page = await openPage(browser)
  await (mock === null ? real(page) : looks(page))
} catch (error) {
  fail(`the run ended early: ${error.message}`)
} finally {
  await browser.close()
  await mock?.close()
  clearTimeout(deadline)
}
finish()
