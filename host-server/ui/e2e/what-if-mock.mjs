// What the page about what would have been does when questions fail, wait for others or are ended; and what viewers
// see. Needs a hand on the server, so it runs against the mock only.

import { startMock } from '../tests/mock/server.mjs'
import { axe, check, expect, openPage, picture, until } from './checks.mjs'

const PASSWORD = 'correct horse battery'
const id = (page, name) => page.getByTestId(name)

export async function byMock({ browser, page, mock, ask, asked }) {
  const { hand, all } = mock.counterfactuals
  await check('a question that runs says how far it is, and another one waits', async () => {
    hand.held = true
    await ask(page, asked)
    await id(page, 'what-if-progress').waitFor()
    expect(/0 of 10 draws/.test(await id(page, 'what-if-progress').textContent()), 'no progress')
    await axe(page, 'running')
    await picture(page, 'what-if-running')
    const running = page.url()
    await ask(page, asked, 'tell-wander')
    await id(page, 'what-if-failure').waitFor()
    const words = await id(page, 'what-if-failure').textContent()
    expect(words.includes('being worked out'), `it says ${words}`)
    await picture(page, 'what-if-busy')
    await page.goto(running)
  })
  await check('it is ended by its button', async () => {
    const before = all.length
    await id(page, 'what-if-end').click()
    await until('it is still there', () => all.length === before - 1)
    await until('it leads nowhere', () => page.url().endsWith('#/what-if'))
    hand.held = false
  })
  await check('one that fails says why', async () => {
    hand.fails = 'the history was pruned meanwhile'
    await ask(page, asked)
    await id(page, 'what-if-failed').waitFor()
    const words = await id(page, 'what-if-failed').textContent()
    expect(words.includes('pruned meanwhile'), `it says ${words}`)
    await axe(page, 'failed')
    await picture(page, 'what-if-failed')
    hand.fails = null
  })
  await check('one whose simulation was wrong says that it is worth little', async () => {
    hand.astray = 2
    await ask(page, asked)
    await until('it holds', async () => {
      const test = id(page, 'null-test')
      return (await test.count()) === 1 && (await test.getAttribute('data-holds')) === 'false'
    })
    await axe(page, 'worth little')
    await picture(page, 'what-if-weak')
    hand.astray = 12
  })
  await check('one that is forgotten is no more, and a link to it says so', async () => {
    const address = page.url()
    await id(page, 'what-if-forget').click()
    await id(page, 'what-if-list').waitFor()
    await page.goto(address)
    await id(page, 'what-if-gone').waitFor()
    await axe(page, 'gone')
  })
  await check('a moment of which nothing is recorded has no answer', async () => {
    await ask(page, { ...asked, at: asked.at - 3_600_000 })
    await id(page, 'what-if-failure').waitFor()
    const words = await id(page, 'what-if-failure').textContent()
    expect(words.includes('Nothing was recorded'), `it says ${words}`)
  })
  await check('who may only watch is not asked', () => watched(browser))
}

/** The history as viewers of a closed server see it. */
async function watched(browser) {
  const closed = await startMock({ robots: 4, open: false })
  try {
    const call = async (path, body, token = '') => {
      const headers = { 'content-type': 'application/json', authorization: `Bearer ${token}` }
      const init = { method: 'POST', headers, body: JSON.stringify(body) }
      return (await fetch(`${closed.url}/api/v1${path}`, init)).json()
    }
    const code = closed.accounts.firstCode
    const { token } = await call('/invitations', { code, name: 'ada', password: PASSWORD })
    await call('/users', { name: 'eve', role: 'viewer', password: PASSWORD }, token)
    const page = await openPage(browser)
    await page.goto(`${closed.url}/#/history`)
    await id(page, 'user').fill('eve')
    await id(page, 'password').fill(PASSWORD)
    await page.keyboard.press('Enter')
    await until('no moment is shown', async () => {
      const here = id(page, 'history')
      return (await here.count()) === 1 && (await here.getAttribute('data-here')) === 'shown'
    })
    expect((await id(page, 'copy-moment').count()) === 1, 'there is no banner')
    expect((await id(page, 'what-if').count()) === 0, 'there is a button')
    await page.context().close()
  } finally {
    await closed.close()
  }
}
