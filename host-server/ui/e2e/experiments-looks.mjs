// How experiments look: in every state, size and colour; when the server is away; to viewers; and
// when there are very many trials.

import { POLICY } from '../tests/mock/experiments.mjs'
import { startMock } from '../tests/mock/server.mjs'
import { DESKTOP, PHONE, WALL } from './browser.mjs'
import { axe, axeDark, check, expect, measure, picture, until } from './checks.mjs'

/** Somebody has signed what the mock's trainings come to. */
const POLICY_RELEASE = {
  id: 'feedfacefeedface',
  kind: 'policy',
  name: 'mine',
  board: 'sim',
  version: '3',
  build: POLICY.slice(0, 32),
  sequence: 3,
  size: 8_552,
  withdrawn: null,
  expires_at: null,
}
/** Trials of the long experiment: as many as there can be. */
const MANY = 100_000
/** A page that does nothing for so long is frozen to whoever clicks. */
const FROZEN_MS = 1_500
const PASSWORD = 'correct horse battery'
const id = (page, name) => page.getByTestId(name)
const data = (locator, name) => locator.getAttribute(`data-${name}`)

/** One of every kind, at once; gives the places to look at. */
function fill(mock) {
  const make = (name, change) => {
    const body = { name, scenario: 'simple-navigation', seeds: 200, ...change }
    return mock.experiments.create({ thresholds: ['success>=0.9'], ...body })
  }
  const done = (one, count) => Object.assign(one, { exact: count, done: count })
  const good = done(make('Navigation, as it is', {}), 200)
  const bad = done(
    make('Navigation, harder', {
      difficulty: 'hard',
      thresholds: ['success>=0.9', 'collisions <= 2', 'time_to_goal_s<=20'],
    }),
    200,
  )
  const broken = done(make('Things break', { scenario: 'resilience' }), 120)
  const paused = done(make('To be gone on with', { seeds: 400, first_seed: 1_000 }), 130)
  const running = done(make('A long one with a name that takes up room', { seeds: 50_000 }), 9_000)
  const train = (name, change) =>
    mock.experiments.create({ kind: 'training', name, steps: 1_000_000, ...change })
  const trained = done(train('Apart, as it is', { seed: 1 }), 41)
  const other = done(train('Apart, in wilder worlds', { seed: 2, randomisation: 'wild' }), 41)
  const learning = done(train('A long one that learns', { steps: 400_000_000 }), 300)
  mock.releases.unshift({ ...mock.releases[0], ...POLICY_RELEASE })
  const created = make('Not yet', { start: false, set: ['duration_s=60'] })
  const now = Date.now()
  for (const one of [good, bad, trained, other]) {
    Object.assign(one, { state: 'completed', started_at: now - 95_000, ended_at: now - 60_000 })
  }
  Object.assign(broken, {
    state: 'failed',
    ended_at: now,
    reason: 'the records cannot be written: no space left on the device',
  })
  paused.state = 'paused'
  return {
    list: 'experiments',
    chosen: `experiments?pick=${good.id},${bad.id}`,
    completed: `experiments/${good.id}`,
    missed: `experiments/${bad.id}`,
    failed: `experiments/${broken.id}`,
    paused: `experiments/${paused.id}`,
    running: `experiments/${running.id}?curves=success,time_to_goal_s,energy_j,collisions`,
    created: `experiments/${created.id}`,
    trained: `experiments/${trained.id}`,
    learning: `experiments/${learning.id}`,
    'compared-trainings': `experiments?compare=${trained.id},${other.id}`,
    form: `experiments?from=${bad.id}`,
    compared: `experiments?compare=${good.id},${bad.id},${broken.id},${paused.id}`,
    unknown: 'experiments/nobody',
    dashboard: 'dashboard',
  }
}

/** What a page shows last. */
const LAST = {
  list: '[data-testid=experiments-table] tbody tr',
  chosen: '[data-testid=compare]',
  completed: '[data-curve=time_to_goal_s] canvas',
  missed: '[data-curve=time_to_goal_s] canvas',
  failed: '[data-curve=time_to_goal_s] canvas',
  paused: '[data-curve=time_to_goal_s] canvas',
  running: '[data-curve=collisions] canvas',
  created: '[data-testid=experiment-start]',
  trained: '[data-testid=roll-out]',
  learning: '[data-curve=clipped] canvas',
  'compared-trainings': '[data-testid=runs-together]',
  form: '[data-testid=usual-values]',
  compared: '[data-curve=time_to_goal_s] canvas',
  unknown: '[data-testid=experiment-unknown]',
  dashboard: '[data-testid=experiments-tile] progress',
}

export async function everyLook({ browser, page, mock, newPage, goTo }) {
  mock.experiments.settings.perSecond = 40
  const places = fill(mock)
  const touch = { hasTouch: true, isMobile: true, deviceScaleFactor: 2 }
  const phone = await newPage(browser, { viewport: PHONE, reducedMotion: 'reduce', ...touch })
  await page.emulateMedia({ reducedMotion: 'reduce' })
  for (const [size, viewport] of Object.entries({ desktop: DESKTOP, wall: WALL, phone: PHONE })) {
    const here = size === 'phone' ? phone : page
    await here.setViewportSize(viewport)
    for (const [name, place] of Object.entries(places)) {
      await check(`${size}, light: ${name}`, async () => {
        await goTo(here, place)
        await here.locator(LAST[name]).first().waitFor()
        if (name === 'compared') await allLoaded(here)
        if (name === 'missed') await id(here, 'curve-choice').click()
        await (size === 'phone' ? measure(here, name) : axe(here, name))
        await pictures(here, `experiments-${size}-light-${name}`)
        const box = await id(here, 'stop-all').boundingBox()
        expect(box !== null && box.y + box.height <= viewport.height, 'the stop is out of reach')
      })
      await check(`${size}, dark: ${name}`, () => {
        return axeDark(here, name, () => pictures(here, `experiments-${size}-dark-${name}`))
      })
    }
  }
  await phone.context().close()
  await page.setViewportSize(DESKTOP)
}

/** 200, 200, 120 and 130 trials. */
async function allLoaded(page) {
  await page.locator('[data-curve=success][data-loaded="650"] canvas').waitFor()
}

/** What is below the edge, too. */
async function pictures(page, name) {
  if (process.env.SCREENSHOTS === undefined) return
  const body = page.locator('.page-body')
  await body.evaluate((element) => element.scrollTo(0, 0))
  await picture(page, name)
  for (let part = 2; part < 7; part++) {
    const end = await body.evaluate((element) => {
      element.scrollTop += element.clientHeight - 40
      return element.scrollTop + element.clientHeight >= element.scrollHeight - 1
    })
    await picture(page, `${name}-${String(part)}`)
    if (end) return
  }
}

export async function troubles({ page, mock, goTo }) {
  await check('a finished training leads to a rollout of its policy', async () => {
    await goTo(page, 'experiments')
    await page.locator('tr', { hasText: 'Apart, as it is' }).getByRole('link').click()
    await id(page, 'sign-command').waitFor()
    const command = await id(page, 'sign-command').inputValue()
    expect(command.includes('--kind policy --name apart-as-it-is '), `it is ${command}`)
    expect(command.includes('--sequence 4 '), `it is ${command}`)
    const coming = page.waitForEvent('download')
    await id(page, 'file-policy.tcpo').click()
    const name = (await coming).suggestedFilename()
    expect(name === 'policy.tcpo', `it is called ${name}`)
    await id(page, 'roll-out').click()
    const ticked = page.locator('.new-rollout input[type=checkbox]:checked')
    await until('nothing is chosen', async () => (await ticked.count()) === 1)
  })
  await check('what a server has against a training stands at its field', async () => {
    await goTo(page, 'experiments')
    await id(page, 'more-of-training').click()
    await id(page, 'training-worlds').fill('1')
    await id(page, 'training-steps').fill('10000000')
    await id(page, 'run-training').click()
    await page.locator('#training-steps-error').waitFor()
    await axe(page, 'a wrong training')
    await id(page, 'training-steps').fill('1000')
    await id(page, 'training-seed').fill('13')
    await id(page, 'run-training').click()
    const words = page.locator('#training-seed-error')
    await words.waitFor()
    const focused = await page.evaluate(() => document.activeElement?.id)
    expect(focused === 'training-seed', `${focused} has the focus`)
    return (await words.textContent()).trim()
  })
  await check('a hundred thousand trials are drawn, and the page answers meanwhile', async () => {
    const many = mock.experiments.create({
      name: 'Very many',
      scenario: 'resilience',
      seeds: MANY,
    })
    Object.assign(many, { exact: MANY, done: MANY, state: 'completed', ended_at: Date.now() })
    await goTo(page, 'experiments')
    await page.evaluate(() => {
      let last = performance.now()
      globalThis.longest = 0
      const tick = () => {
        const now = performance.now()
        globalThis.longest = Math.max(globalThis.longest, now - last)
        last = now
        setTimeout(tick, 0)
      }
      tick()
    })
    await page.evaluate((place) => (location.hash = place), `#/experiments/${many.id}`)
    await until('not all are loaded', async () => {
      const shown = id(page, 'experiment')
      return (await shown.count()) > 0 && (await data(shown, 'loaded')) === String(MANY)
    })
    await page.locator(`[data-curve=success][data-loaded="${String(MANY)}"] canvas`).waitFor()
    const longest = await page.evaluate(() => Math.round(globalThis.longest))
    const points = Number(await data(page.locator('[data-curve=success]'), 'points'))
    expect(points <= 3 * 800, `${points} points are drawn`)
    const listed = await page.locator('[data-testid=failures] li').count()
    expect(listed === 10, `${listed} failures are listed`)
    // Said, and not judged: the machine may be busy.
    return `longest pause ${longest} ms${longest > FROZEN_MS ? ', which is long' : ''}`
  })
  await check('a server that goes away is named, and what was seen stays', async () => {
    await goTo(page, 'experiments')
    await id(page, 'experiments-table').waitFor()
    mock.setDown(true)
    await id(page, 'load-error').waitFor()
    expect((await id(page, 'experiments-table').count()) === 1, 'the list is gone')
    await until('it can be run', () => id(page, 'run-experiment').isDisabled())
    await axe(page, 'away')
    await picture(page, 'experiments-away')
    mock.setDown(false)
    // The page asks again by itself, too: whoever is first.
    await id(page, 'load-error').evaluateAll(([shown]) => shown?.querySelector('button').click())
    await id(page, 'load-error').waitFor({ state: 'detached' })
  })
  await check('without a list of scenarios their names are typed', async () => {
    mock.experiments.settings.listsScenarios = false
    await page.reload()
    await page.locator('input#experiment-scenario').waitFor()
    await axe(page, 'unlisted')
    mock.experiments.settings.listsScenarios = true
  })
  await check('a server that runs none says so', async () => {
    mock.experiments.settings.exists = false
    await page.reload()
    await id(page, 'no-experiments').waitFor()
    await axe(page, 'none')
    await picture(page, 'experiments-none')
    mock.experiments.settings.exists = true
  })
}

/** On a closed server, where somebody may only watch. */
export async function viewers(page) {
  const mock = await startMock({ robots: 4, open: false })
  mock.accounts.addUser('vera', 'viewer', PASSWORD)
  const one = mock.experiments.create({ name: 'Slow', scenario: 'resilience', seeds: 10_000 })
  await check('viewers watch, and are told why they cannot change anything', async () => {
    await page.goto(`${mock.url}/#/experiments/${one.id}`)
    await id(page, 'user').fill('vera')
    await id(page, 'password').fill(PASSWORD)
    await page.keyboard.press('Enter')
    await page.locator('[data-curve=success] canvas').waitFor()
    for (const act of ['pause', 'stop', 'again']) {
      expect(await id(page, `experiment-${act}`).isDisabled(), `${act} can be pressed`)
    }
    const words = (await id(page, 'blocked').textContent()).trim()
    await axe(page, 'a viewer')
    await picture(page, 'experiments-viewer')
    await page.goto(`${mock.url}/#/experiments`)
    await id(page, 'new-blocked').waitFor()
    expect(await id(page, 'run-experiment').isDisabled(), 'it can be run')
    await axe(page, 'a viewer')
    return words
  })
  await mock.close()
}
