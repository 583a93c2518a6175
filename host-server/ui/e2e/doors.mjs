// How the page meets people: on a phone, when they guess, when the server is away or open.

import { PHONE } from './browser.mjs'
import { afresh, axe, axeDark, check, expect, measure, picture, until } from './checks.mjs'
import { OTHER_PASSWORD, base, byMock, goTo, id, live, logIn, mock, newPage } from './steps.mjs'

export async function phone(browser) {
  const page = await newPage(browser, {
    viewport: PHONE,
    hasTouch: true,
    isMobile: true,
    deviceScaleFactor: 2,
    reducedMotion: 'reduce',
  })
  const look = async (name) => {
    await measure(page, name)
    await picture(page, `phone-light-${name}`)
    await axeDark(page, name, () => picture(page, `phone-dark-${name}`))
  }
  await check('on a phone, every page fits and every target is large, light and dark', async () => {
    await page.goto(base)
    await id(page, 'login').waitFor()
    await look('login')
    await logIn(page, 'ada', OTHER_PASSWORD)
    await live(page)
    await look('room')
    for (const name of ['account', 'people', 'keys', 'audit']) {
      await goTo(page, name)
      await until('it still loads', async () => {
        return (await page.locator('.empty[role=status]').count()) === 0
      })
      await look(name)
      const box = await id(page, 'stop-all').boundingBox()
      expect(box !== null && box.y + box.height <= PHONE.height, `${name}: no stop`)
    }
  })
  await page.context().close()
}

export async function limits(page) {
  await check('too many attempts are answered with the time to wait', async () => {
    await page.goto(base)
    await id(page, 'login').waitFor()
    for (let i = 0; i < 12; i++) {
      await logIn(page, 'mallory', `guess number ${i}`)
      await until('no answer', async () => {
        return (await page.locator('[aria-disabled=true]').count()) === 0
      })
      const words = await id(page, 'login-failure').textContent()
      if (words.includes('too many')) return words.trim()
    }
    throw new Error('guessing went on')
  })
}

export async function openServer(page) {
  if (mock === null) return
  mock.accounts.setOpen(true)
  await check('an open server shows no login and says that it is open', async () => {
    await afresh(page, base)
    await live(page)
    expect((await id(page, 'open-mark').textContent()).startsWith('open'), 'it does not say')
    expect((await id(page, 'account-link').count()) === 0, 'there is an account')
    return axe(page, 'axe-core')
  })
  await picture(page, 'open')
}

export async function troubles(page) {
  await byMock('a server that is away at the start is waited for', async () => {
    await page.goto('about:blank')
    mock.setDown(true)
    await page.goto(base)
    const words = page.locator('.entrance h1', { hasText: 'cannot be reached' })
    await words.waitFor()
    await axe(page, 'away')
    mock.setDown(false)
    await id(page, 'login').waitFor()
  })
  await check('a part that does not come is named', async () => {
    await page.route('**/assets/enter-*', (route) => route.abort())
    await page.goto(`${base}/?again`)
    await page.locator('.entrance h1', { hasText: 'could not be loaded' }).waitFor()
    return axe(page, 'axe-core')
  })
  await page.unroute('**/assets/enter-*')
}
