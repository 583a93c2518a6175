// What people do again and again: open a page, log in, go somewhere. The server is the
// mock, or the closed one at BASE_URL whose first admin's code is INVITE.

import { startMock } from '../tests/mock/server.mjs'
import { check, until } from './checks.mjs'

export const PASSWORD = 'correct horse battery'
export const OTHER_PASSWORD = 'another good password'

/** `null` with a real server: there is no hand on it then. */
export const mock =
  process.env.BASE_URL === undefined ? await startMock({ robots: 12, open: false }) : null
export const base = mock?.url ?? process.env.BASE_URL
export const code = mock?.accounts.firstCode ?? process.env.INVITE

/** A check that needs a hand on the server. */
export const byMock = (name, act) => (mock === null ? undefined : check(name, act))
export const id = (page, name) => page.getByTestId(name)

export { openPage as newPage } from './checks.mjs'

export function live(page) {
  return until('the feed is not live', async () => {
    const lamp = id(page, 'connection')
    return (await lamp.count()) > 0 && (await lamp.getAttribute('data-connection')) === 'live'
  })
}

export async function logIn(page, user, password) {
  await id(page, 'user').fill(user)
  await id(page, 'password').fill(password)
  await page.keyboard.press('Enter')
}

export async function goTo(page, name) {
  await page.goto(`${base}/#/${name}`)
  await page.locator(`[data-page=${name}]`).waitFor()
  await page.locator('#page-title').waitFor()
}

export const focusedId = (page) =>
  page.evaluate(() => document.activeElement?.dataset?.testid ?? '')
export const stopState = (page) => id(page, 'stop-panel').getAttribute('data-stop')
