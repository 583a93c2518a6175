// `npm run e2e:rollouts`: rollouts begun, watched, stopped and gone back from, in a real browser, against the closed
// server at BASE_URL whose first admin's code is INVITE, with the releases GOOD, BAD and AGAIN; without one every
// state and size is looked at, with the mock.

import { DESKTOP, PHONE, launch } from './browser.mjs'
import { axe, axeDark, check, expect, fail, finish, guarded } from './checks.mjs'
import { measure, picture, until } from './checks.mjs'
import { PASSWORD, base, code, id, live, mock, newPage } from './steps.mjs'

async function go(page, place) {
  await page.goto(`${base}/#/${place}`)
  await live(page)
  await page.locator('#page-title').waitFor()
}

async function enter(page, link, user) {
  await page.goto(link)
  if ((await id(page, 'user').inputValue()) === '') await id(page, 'user').fill(user)
  await id(page, 'new-password').fill(PASSWORD)
  await id(page, 'again').fill(PASSWORD)
  await page.keyboard.press('Enter')
  await live(page)
}

/** Somebody else, who may only look. */
async function viewer(page) {
  await go(page, 'people')
  await id(page, 'invite-name').fill('bob')
  await id(page, 'invite-role').selectOption('viewer')
  await page.locator('[data-testid=invite-form] button').click()
  await id(page, 'link').waitFor()
  const other = await newPage(page.context().browser())
  await enter(other, await id(page, 'link').inputValue(), 'bob')
  return other
}

async function press(page, name) {
  await id(page, name).click()
  await id(page, 'confirm').waitFor()
  // The safe answer has the focus.
  const focused = await page.evaluate(() => document.activeElement?.dataset.testid)
  expect(focused === 'cancel', `${focused} has the focus`)
  await axe(page, `a question about ${name}`)
  await id(page, 'confirm').click()
}

const inState = (page, state) =>
  page.locator(`[data-testid=rollout][data-state=${state}]`).waitFor()

/** Nothing on the page of a rollout can be pressed that changes anything. */
async function onlyLooks(other, place) {
  await go(other, place)
  await id(other, 'rollout').waitFor()
  await other.locator('#rollout-title').waitFor()
  await other.locator('[data-testid=rollout-robots] [data-robot]').first().waitFor()
  expect((await id(other, 'rollout-controls').count()) === 0, 'it can be steered')
  const acts = await other.locator('[data-testid^=retry-], [data-testid^=skip-]').count()
  expect(acts === 0, 'robots can be retried or left out')
  await axe(other, 'a rollout, for viewers')
  await go(other, 'updates?tab=rollouts&begin=new')
  await id(other, 'rollouts-blocked').waitFor()
  expect((await id(other, 'new-rollout').count()) === 0, 'one can be begun')
  expect((await id(other, 'open-rollout').count()) === 0, 'there is a button to begin one')
  await go(other, 'updates?tab=back')
  await id(other, 'back-blocked').waitFor()
  expect((await other.locator('button[data-testid^=back-]').count()) === 0, 'one can go back')
}

async function give(page, file) {
  await go(page, 'updates')
  await id(page, 'release-file').setInputFiles(file)
  await id(page, 'send-release').click()
  await id(page, 'release-added').waitFor()
}

/** From the page of a release to the form that has it ticked. */
async function choose(page, version) {
  await page.locator('[data-release] a', { hasText: version }).click()
  await id(page, 'begin-with').click()
  await id(page, 'new-rollout').waitFor()
  expect(await page.locator('[data-choose]:checked').count(), 'the release is not chosen')
}

async function begin(page, shares) {
  for (const [place, share] of shares.entries()) {
    await id(page, `rollout-phase-${place + 1}-of`).fill(share)
    await id(page, `rollout-phase-${place + 1}-soak`).fill('0 s')
  }
  await id(page, 'begin-rollout').click()
}

async function real(page) {
  await check('there are none yet', async () => {
    await go(page, 'updates?tab=rollouts')
    await id(page, 'rollouts-empty').waitFor()
    return axe(page, 'empty')
  })
  await check('what is wrong is said at its field, and by the server', async () => {
    await give(page, process.env.GOOD)
    await choose(page, '0.4.0')
    await id(page, 'rollout-phase-1-of').fill('0')
    await id(page, 'begin-rollout').click()
    const wrong = page.locator('[data-field=phase-1-of] .trouble')
    await wrong.waitFor()
    const focused = await page.evaluate(() => document.activeElement?.dataset.testid)
    expect(focused === 'rollout-phase-1-of', `${focused} has the focus`)
    await axe(page, 'a wrong field')
    for (const phase of [1, 2]) {
      await id(page, `rollout-phase-${phase}-by`).selectOption('kind')
      await id(page, `rollout-phase-${phase}-of`).selectOption('simulated')
    }
    await id(page, 'begin-rollout').click()
    await id(page, 'rollout-refused').waitFor()
    const words = await id(page, 'rollout-refused').textContent()
    expect(words.includes('phase 2: an earlier phase selects the same'), `it says ${words}`)
    for (const phase of [1, 2]) await id(page, `rollout-phase-${phase}-by`).selectOption('share')
    return words.trim()
  })
  await check('a good release reaches every robot, phase by phase', async () => {
    // Robots that are there when it begins are in its first phase.
    await until('robots are not online', async () => {
      const online = await page.evaluate(() =>
        globalThis.terracrawler.robots().filter(({ presence }) => presence === 'online'),
      )
      return online.length === 4
    })
    await begin(page, ['50', '100'])
    await page.locator('[data-phase="1"][data-state=active]').waitFor()
    await picture(page, 'rollout-real')
    await axe(page, 'it runs')
    await page.locator('[data-phase="1"][data-state=passed]').waitFor()
    await inState(page, 'done')
    const done = await page.locator('[data-figure=done] dd').textContent()
    expect(done === '4 of 4', `${done} are confirmed`)
    await picture(page, 'rollout-real-done')
    return axe(page, 'it is done')
  })
  await check('every robot says that it runs the new build', async () => {
    await go(page, 'updates?tab=robots')
    await page.locator('[data-build=good-1][data-robots="4"]').waitFor()
    const words = await page.locator('[data-build=good-1]').textContent()
    expect(words.includes('0.4.0') && words.includes('sequence 1'), `it says ${words}`)
    return axe(page, 'what robots run')
  })
  await check('a bad one stops by itself, and says why', async () => {
    await give(page, process.env.BAD)
    await choose(page, '0.5.0')
    await begin(page, ['50', '100'])
    await page.locator('[data-testid=rollout-reason][data-reason=failures]').waitFor()
    await page.locator('[data-testid=failures] .failure-kinds [data-reason=panic]').waitFor()
    const failed = page.locator('[data-testid=failures] [data-state=rolled_back]')
    await until('two robots went back', async () => (await failed.count()) === 2)
    const robot = await failed.first().getAttribute('data-robot')
    await failed.first().getByTestId(`log-${robot}`).click()
    const log = id(page, `trial-${robot}`)
    await log.locator('[data-step=trial]').waitFor()
    await log.locator('[data-step=rolled_back]').waitFor()
    await picture(page, 'rollout-real-stopped')
    return axe(page, 'it has stopped')
  })
  await check('whoever may only look is offered nothing', async () => {
    const other = await viewer(page)
    await onlyLooks(other, 'updates?rollout=2')
    await other.context().close()
  })
  await check('it is aborted, with a question before', async () => {
    await go(page, 'updates?rollout=2')
    await press(page, 'rollout-abort')
    await inState(page, 'aborted')
  })
  await check('the way back is prepared, and goes out at one press when it is signed', async () => {
    await go(page, 'updates?tab=back')
    await id(page, 'prepare-good-1').click()
    const command = await id(page, 'sign-command').inputValue()
    for (const told of ['release sign', '--board sim', '--build good-1', '--sequence 3']) {
      expect(command.includes(told), `${told} is not in ${command}`)
    }
    await axe(page, 'the way back')
    await give(page, process.env.AGAIN)
    await go(page, 'updates?tab=back')
    await press(page, 'back-good-1')
    await id(page, 'rollout').waitFor()
    await page.locator('[data-testid=rollout-robots] [data-state=confirmed]').first().waitFor()
    const title = await page.locator('#rollout-title').textContent()
    expect(title === '0.4.0 for sim', `it is ${title}`)
  })
}

const PLACES = [
  ['rollouts', 'updates?tab=rollouts', 'rollouts'],
  ['rollout-form', 'updates?tab=rollouts&begin=new', 'new-rollout'],
  ['rollout-runs', 'updates?rollout=3', 'rollout-robots'],
  ['rollout-stopped', 'updates?rollout=2', 'failures'],
  ['rollout-done', 'updates?rollout=1', 'rollout-robots'],
  ['rollout-unknown', 'updates?rollout=99', 'rollout-unknown'],
  ['builds', 'updates?tab=robots', 'runs'],
  ['way-back', 'updates?tab=back', 'back-page'],
]

async function looks(page) {
  for (const [name, place, ready] of PLACES) {
    await check(`${name} on a desktop and a phone`, async () => {
      await page.setViewportSize(DESKTOP)
      await go(page, place)
      await id(page, ready).waitFor()
      await until('it still loads', async () => {
        return (await page.locator('.empty[role=status]').count()) === 0
      })
      if (name === 'way-back') await page.locator('[data-testid^=prepare-]').first().click()
      if (name === 'rollout-stopped') {
        await page.locator('[data-testid=failures] [data-testid^=log-]').first().click()
        await page.locator('[data-step=trial]').waitFor()
      }
      await axeDark(page, name, () => picture(page, `${name}-dark`))
      await axe(page, name)
      await picture(page, name)
      await page.setViewportSize(PHONE)
      await measure(page, `${name} on a phone`)
      await picture(page, `${name}-phone`)
      await axeDark(page, name, () => picture(page, `${name}-phone-dark`))
    })
  }
  await page.setViewportSize(DESKTOP)
  await steers(page)
  await check('whoever may only look is offered nothing', async () => {
    const other = await viewer(page)
    await onlyLooks(other, 'updates?rollout=2')
    await picture(other, 'rollout-viewer')
    await other.context().close()
  })
}

async function steers(page) {
  await check('what runs says how fast and how long', async () => {
    await go(page, 'updates?rollout=3')
    await until('nothing is measured', async () => {
      const words = await page.locator('[data-figure=rate] dd').textContent()
      return /\d [KM]?i?B\/s$/.test(words)
    })
    const left = await page.locator('[data-figure=left] dd').textContent()
    expect(/^about \d+ (s|min|h)$/.test(left), `it says ${left}`)
  })
  await check('it pauses, goes on and ends as it is told', async () => {
    await press(page, 'rollout-pause')
    await page.locator('[data-testid=rollout-reason][data-reason=person]').waitFor()
    const left = await page.locator('[data-figure=left] dd').textContent()
    expect(left.startsWith('unknown'), `it says ${left}`)
    await press(page, 'rollout-resume')
    await inState(page, 'running')
    // The safe answer leaves everything, and the focus where it was.
    await id(page, 'rollout-abort').click()
    await page.keyboard.press('Escape')
    const focused = await page.evaluate(() => document.activeElement?.dataset.testid)
    expect(focused === 'rollout-abort', `${focused} has the focus`)
    await press(page, 'rollout-abort')
    await inState(page, 'aborted')
    expect((await page.locator('[data-testid=rollout-controls] button').count()) === 0, 'and again')
  })
  await check('a robot is tried again, another left out', async () => {
    await go(page, 'updates?rollout=2')
    const failures = id(page, 'failures')
    const name = await failures.locator('[data-state=failed]').getAttribute('data-robot')
    await failures.getByTestId(`retry-${name}`).click()
    await id(page, 'confirm').click()
    const robots = id(page, 'rollout-robots')
    await robots.locator(`[data-robot=${name}][data-state=waiting]`).waitFor()
    await robots.getByTestId(`skip-${name}`).click()
    await id(page, 'confirm').click()
    await robots.locator(`[data-robot=${name}][data-state=skipped]`).waitFor()
  })
  await check('robots are looked through by state', async () => {
    await id(page, 'rollout-state').selectOption('rolled_back')
    await until('others are shown', async () => {
      const all = page.locator('[data-testid=rollout-robots] [data-robot]')
      const back = page.locator('[data-testid=rollout-robots] [data-state=rolled_back]')
      return (await all.count()) === 2 && (await back.count()) === 2
    })
    expect(page.url().includes('state=rolled_back'), `the address is ${page.url()}`)
  })
  await check('a plan that the server refuses says why, and a good one begins', async () => {
    await go(page, 'updates?tab=rollouts')
    await id(page, 'open-rollout').click()
    await id(page, 'begin-rollout').click()
    await page.locator('#rollout-releases-error').waitFor()
    await page.locator('[data-choose]').first().check()
    await id(page, 'rollout-limits').click()
    await id(page, 'rollout-parallel').fill('13')
    await id(page, 'begin-rollout').click()
    await id(page, 'rollout-refused').waitFor()
    const words = await id(page, 'rollout-refused').textContent()
    expect(words.includes('13'), `it says ${words}`)
    await axe(page, 'refused')
    await picture(page, 'rollout-refused')
    await id(page, 'rollout-parallel').fill('20')
    await id(page, 'add-phase').click()
    const focused = await page.evaluate(() => document.activeElement?.dataset.testid)
    expect(focused === 'rollout-phase-3-by', `${focused} has the focus`)
    await id(page, 'drop-phase-3').click()
    await id(page, 'begin-rollout').click()
    await inState(page, 'running')
  })
  await check('one press goes back where a release of it is ready', async () => {
    await go(page, 'updates?tab=back')
    await page.locator('[data-earlier="9f2c1ab8"][data-ready=true]').waitFor()
    await press(page, 'back-9f2c1ab8')
    await inState(page, 'running')
  })
}

const deadline = guarded()
const browser = await launch()
try {
  const page = await newPage(browser)
  await enter(page, `${base}/#invite=${code}`, 'ada')
  await (mock === null ? real(page) : looks(page))
} catch (error) {
  fail(`the run ended early: ${error.message}`)
} finally {
  await browser.close()
  await mock?.close()
  clearTimeout(deadline)
}
finish()
