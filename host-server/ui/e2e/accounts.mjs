// `npm run e2e:accounts`: people and their sessions, in a real browser. Against the
// mock; or against the closed server at BASE_URL whose first admin's code is INVITE,
// where checks that need a hand on the server are left out.

import { launch } from './browser.mjs'
import { axe, check, exchanged, expect, fail, finish } from './checks.mjs'
import { guarded, picture, until } from './checks.mjs'
import { limits, openServer, phone, troubles } from './doors.mjs'
import { OTHER_PASSWORD, PASSWORD, base, byMock, code, mock } from './steps.mjs'
import { focusedId, goTo, id, live, logIn, newPage, stopState } from './steps.mjs'

async function firstAdmin(page) {
  await check('nobody gets in without a login', async () => {
    await page.goto(base)
    await id(page, 'login').waitFor()
    expect((await focusedId(page)) === 'user', 'the name has not the focus')
    expect((await page.locator('[data-testid=robot-row]').count()) === 0, 'robots are shown')
    return axe(page, 'axe-core')
  })

  await check('the first admin makes an account by the invitation', async () => {
    await page.goto(`${base}/#invite=${code}`)
    await id(page, 'invite').waitFor()
    await axe(page, 'the invitation')
    await id(page, 'user').fill('ada')
    await id(page, 'new-password').fill('short')
    await page.keyboard.press('Enter')
    expect((await focusedId(page)) === 'new-password', 'the weak password has not the focus')
    expect(
      (await id(page, 'new-password').getAttribute('aria-invalid')) === 'true',
      'the weak password is not marked',
    )
    await axe(page, 'with an error')
    await id(page, 'new-password').fill(PASSWORD)
    expect((await page.locator('.rules [data-met=true]').count()) === 2, 'rules are not ticked')
    await id(page, 'again').fill(PASSWORD)
    await page.keyboard.press('Enter')
    await live(page)
    expect(!page.url().includes('invite'), 'the code stays in the address')
  })

  await check('a reload keeps the session, and no script can read it', async () => {
    await page.reload()
    await live(page)
    const kept = await page.evaluate(
      () => JSON.stringify(localStorage) + JSON.stringify(sessionStorage) + document.cookie,
    )
    expect(!kept.includes('token') && !kept.includes('refresh='), `found ${kept}`)
  })

  await check('a used invitation says so', async () => {
    const other = await newPage(page.context().browser())
    await other.goto(`${base}/#invite=${code}`)
    await id(other, 'user').fill('eve')
    await id(other, 'new-password').fill(PASSWORD)
    await id(other, 'again').fill(PASSWORD)
    await other.keyboard.press('Enter')
    await id(other, 'invite-failure').waitFor()
    await axe(other, 'a used invitation')
    await other.context().close()
  })
}

async function people(page) {
  await check('the last admin cannot be taken away', async () => {
    await goTo(page, 'people')
    const row = page.locator('tr[data-user=ada]')
    await row.waitFor()
    expect(await id(page, 'role-ada').isDisabled(), 'the role can be changed')
    expect((await row.getByTestId('barred').count()) === 1, 'no reason is given')
  })

  const bob = await newPage(page.context().browser())
  await check('an admin invites, and the invited one gets in as a viewer', async () => {
    await id(page, 'invite-name').fill('Bob!')
    await page.keyboard.press('Enter')
    expect((await focusedId(page)) === 'invite-name', 'a bad name has not the focus')
    await axe(page, 'a bad name')
    await id(page, 'invite-name').fill('bob')
    await id(page, 'invite-role').selectOption('viewer')
    await page.locator('[data-testid=invite-form] button').click()
    await id(page, 'link').waitFor()
    const link = await id(page, 'link').inputValue()
    expect(link.startsWith(base), `the link is ${link}`)
    await axe(page, 'an invitation')
    await picture(page, 'people')
    await bob.goto(link)
    expect((await id(bob, 'user').inputValue()) === 'bob', 'the name is not filled in')
    await id(bob, 'new-password').fill(PASSWORD)
    await id(bob, 'again').fill(PASSWORD)
    await bob.keyboard.press('Enter')
    await live(bob)
  })

  await check('a viewer sees why controls are off, and sends nothing', async () => {
    const sent = []
    bob.on('request', (request) => {
      if (request.url().endsWith('/commands')) sent.push(request.postData())
    })
    expect(await id(bob, 'stop-all').isDisabled(), 'the stop can be pressed')
    expect((await id(bob, 'stop-need').textContent()).includes('operator'), 'no reason is given')
    await bob.locator('[data-testid=robot-row]').first().click()
    expect((await id(bob, 'drive-pad').getAttribute('data-blocked')) === 'role', 'may drive')
    expect(await id(bob, 'robot-stop').isDisabled(), 'a robot may be stopped')
    await bob.keyboard.press('ArrowUp')
    await bob.keyboard.press('Space')
    await exchanged(bob)
    expect(sent.length === 0, `sent ${sent[0]}`)
    return axe(bob, 'axe-core')
  })
  await picture(bob, 'viewer')

  await check('a viewer has no admin pages', async () => {
    await bob.goto(`${base}/#/people`)
    await bob.locator('[data-page=account]').waitFor()
    expect((await id(bob, 'page-people').count()) === 0, 'there is a way to people')
  })

  await check('a new role is taken up', async () => {
    await goTo(page, 'people')
    await page.reload()
    await id(page, 'role-bob').selectOption('operator')
    await page.locator('tr[data-user=bob][data-role=operator]').waitFor()
    await bob.goto(`${base}/#/`)
    await bob.reload()
    // A server ends the sessions of whoever gets another role; the mock does not.
    if (mock === null) {
      await id(bob, 'login').waitFor()
      await logIn(bob, 'bob', PASSWORD)
    }
    await live(bob)
    expect(!(await id(bob, 'stop-all').isDisabled()), 'the stop is still off')
  })

  await check('disabling asks first, and ends the session', async () => {
    const row = page.locator('tr[data-user=bob]')
    await row.locator('[data-act=disable-bob]').click()
    expect((await focusedId(page)) === 'cancel', 'the safe answer has not the focus')
    await axe(page, 'a question')
    await page.keyboard.press('Escape')
    expect((await id(page, 'confirm').count()) === 0, 'Escape does not leave the question')
    await row.locator('[data-act=disable-bob]').click()
    await id(page, 'confirm').click()
    await page.locator('tr[data-user=bob][data-state=disabled]').waitFor()
    if (mock !== null) for (const socket of mock.sockets()) socket.terminate()
    await id(bob, 'login').waitFor()
  })

  await check('removing takes the account away', async () => {
    await page.locator('[data-act=remove-bob]').click()
    await id(page, 'confirm').click()
    await page.locator('tr[data-user=bob]').waitFor({ state: 'detached' })
  })
  await bob.context().close()
}

async function keys(page) {
  await check('a key is shown once and can be revoked', async () => {
    await goTo(page, 'keys')
    await id(page, 'enrol-robot').fill('rover-1')
    await page.keyboard.press('Enter')
    await id(page, 'secret').waitFor()
    expect((await id(page, 'secret').inputValue()).length >= 43, 'there is no secret')
    await axe(page, 'a new key')
    await picture(page, 'keys')
    await id(page, 'hide-made').click()
    await page.reload()
    const row = page.locator('tr[data-robot=rover-1]')
    await row.waitFor()
    expect((await id(page, 'secret').count()) === 0, 'the secret is still shown')
    await row.locator('[data-act=revoke-rover-1]').click()
    await axe(page, 'a question')
    await id(page, 'confirm').click()
    await page.locator('tr[data-robot=rover-1][data-state=revoked]').waitFor()
  })
}

async function audit(page) {
  if (mock !== null) {
    for (let i = 0; i < 60; i++) mock.accounts.audit('grace', 'drive', `sim-${i}`, 'ok', { v: i })
  }
  await check('the audit log is newest first, by who, and verified', async () => {
    await goTo(page, 'audit')
    await page.reload()
    const rows = page.locator('[data-testid=audit] tbody tr')
    await rows.first().waitFor()
    const numbers = await rows.evaluateAll((all) => all.map((row) => Number(row.dataset.seq)))
    expect(
      numbers.every((seq, at) => at === 0 || seq < numbers[at - 1]),
      'the order is wrong',
    )
    await axe(page, 'the log')
    await picture(page, 'audit')
    await id(page, 'verify').click()
    await page.locator('[data-testid=verified] .notice-box').waitFor()
    await id(page, 'audit-who').fill('ada')
    await page.keyboard.press('Enter')
    await until('others are shown', async () => {
      const names = await rows.locator('td:nth-child(2) b').allTextContents()
      return names.length > 0 && names.every((name) => name === 'ada')
    })
  })
  await byMock('lines that the log has not are counted', async () => {
    mock.accounts.loseLines(2)
    await id(page, 'verify').click()
    await page.locator('[data-testid=lost]', { hasText: '2 lines' }).waitFor()
    await axe(page, 'a log with a gap')
    await picture(page, 'audit-gap')
    mock.accounts.loseLines(0)
  })
  await byMock('older entries follow, and a changed log is named', async () => {
    await id(page, 'audit-who').fill('')
    await page.keyboard.press('Enter')
    const rows = page.locator('[data-testid=audit] tbody tr')
    await until('there are not 50 rows', async () => (await rows.count()) === 50)
    await id(page, 'older').click()
    await until('nothing older came', async () => (await rows.count()) > 50)
    mock.accounts.breakLog(7)
    await id(page, 'verify').click()
    await page.locator('.error-box', { hasText: '7' }).waitFor()
    await axe(page, 'a changed log')
  })
}

async function stops(page) {
  for (const name of ['account', 'people', 'keys', 'audit']) {
    await check(`the emergency stop is within reach on the page ${name}`, async () => {
      await goTo(page, name)
      await axe(page, name)
      const box = await id(page, 'stop-all').boundingBox()
      const { width, height } = page.viewportSize()
      const inside = box !== null && box.x + box.width <= width && box.y + box.height <= height
      expect(inside, 'it is not on the screen')
      await page.keyboard.press('Space')
      await until('Space did not stop', async () => (await stopState(page)) === 'stopped')
      await id(page, 'rearm').click()
      await until('not re-armed', async () => (await stopState(page)) === 'armed')
    })
  }
}

async function sessions(page) {
  const context = page.context()
  await goTo(page, 'account')
  await page.goto(`${base}/#/`)
  const second = await context.newPage()
  second.setDefaultTimeout(8_000)
  await second.goto(base)
  await live(second)

  await byMock('tokens run out in two tabs at once: nobody notices', async () => {
    const before = mock.accounts.refreshes
    const tabs = [page, second]
    for (let round = 0; round < 4; round++) {
      const { refreshes } = mock.accounts
      mock.accounts.expireTokens()
      await Promise.all(
        tabs.map((tab) => tab.locator('[data-testid=robot-row]').nth(round).click()),
      )
      await until('nothing is refreshed', () => mock.accounts.refreshes > refreshes)
      // Both go on: each asks for its robot again and again.
      const answered = (tab) =>
        tab.waitForResponse((answer) => answer.ok() && answer.url().includes('/api/v1/robots/'))
      await Promise.all(tabs.map(answered))
    }
    expect(mock.accounts.reuses === 0, 'a refresh token was used twice')
    expect((await id(page, 'login').count()) === 0, 'the login came up')
    const used = mock.accounts.refreshes - before
    expect(used >= 4, 'nothing was refreshed')
    return `${used} refreshes`
  })

  await byMock('a restart of the server needs no login', async () => {
    mock.setDown(true)
    await until('the loss is not shown', async () => {
      return (await id(page, 'connection').getAttribute('data-connection')) === 'waiting'
    })
    // It tries again, in vain.
    try {
      await page.waitForEvent('requestfailed', (request) => request.url().endsWith('/ticket'))
    } finally {
      mock.setDown(false)
    }
    await live(page)
    expect((await id(page, 'login').count()) === 0, 'the login came up')
  })

  await byMock('when the session ends the login says why and the view is kept', async () => {
    await page.locator('[data-testid=robot-row]').nth(2).click()
    const chosen = await id(page, 'robot-panel').getAttribute('data-robot-id')
    await id(page, 'search').fill('sim')
    mock.accounts.endSessions('ada')
    for (const socket of mock.sockets()) socket.terminate()
    await id(page, 'why-out').waitFor()
    expect((await id(page, 'user').inputValue()) === 'ada', 'the name is not kept')
    expect((await focusedId(page)) === 'password', 'the password has not the focus')
    await axe(page, 'the end of a session')
    await picture(page, 'ended')
    await page.keyboard.press('Tab')
    await page.keyboard.press('Space')
    expect((await stopState(page)) === 'armed', 'a key reached the covered page')
    await id(page, 'password').fill('wrong password')
    await page.keyboard.press('Enter')
    await id(page, 'login-failure').waitFor()
    expect((await focusedId(page)) === 'password', 'the password has not the focus again')
    await axe(page, 'a wrong password')
    await id(page, 'password').fill(PASSWORD)
    await page.keyboard.press('Enter')
    await live(page)
    expect(
      (await id(page, 'robot-panel').getAttribute('data-robot-id')) === chosen,
      'the selection is lost',
    )
    expect((await id(page, 'search').inputValue()) === 'sim', 'the search is lost')
    await live(second)
  })

  await check('the password can be changed', async () => {
    await goTo(page, 'account')
    await id(page, 'old-password').fill('not the old one')
    await id(page, 'new-password').fill(OTHER_PASSWORD)
    await id(page, 'again').fill(OTHER_PASSWORD)
    await page.keyboard.press('Enter')
    await until('the old password has not the focus', async () => {
      return (await focusedId(page)) === 'old-password'
    })
    await axe(page, 'a wrong old password')
    await id(page, 'old-password').fill(PASSWORD)
    await page.keyboard.press('Enter')
    await until('it is not said', async () => {
      return (await id(page, 'password-said').textContent()).includes('changed')
    })
    await picture(page, 'account')
  })

  await check('own sessions are listed and can be ended', async () => {
    const other = await newPage(context.browser())
    await other.goto(base)
    await logIn(other, 'ada', OTHER_PASSWORD)
    await live(other)
    await goTo(page, 'account')
    await page.reload()
    const cards = page.locator('[data-testid=sessions] li')
    await until('there are not two', async () => (await cards.count()) === 2)
    await page.locator('[data-testid=sessions] li button').click()
    await until('it is still there', async () => (await cards.count()) === 1)
    await other.reload()
    await id(other, 'login').waitFor()
    await other.context().close()
  })

  await check('logging out shows in all tabs, and robots are gone from view', async () => {
    await goTo(page, 'account')
    await id(page, 'log-out').click()
    await id(page, 'login').waitFor()
    await id(second, 'login').waitFor()
    // The server may tell that tab of the end before this one does.
    await until('robots are shown', async () => {
      return (await second.locator('[data-testid=robot-row]').count()) === 0
    })
    await page.reload()
    await id(page, 'login').waitFor()
    await logIn(second, 'ada', OTHER_PASSWORD)
    await live(second)
    await live(page)
    return 'and logging in as well'
  })
  await second.close()
}

const guard = guarded()
try {
  const browser = await launch()
  const page = await newPage(browser)
  await firstAdmin(page)
  await people(page)
  await keys(page)
  await audit(page)
  await stops(page)
  await sessions(page)
  await page.context().close()
  await phone(browser)
  const visitor = await newPage(browser)
  await limits(visitor)
  await troubles(visitor)
  await openServer(visitor)
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
clearTimeout(guard)
finish()
