// `npm run e2e:what-if`: asks the past what if a robot had been told to stop, in a real browser. Against the server at
// BASE_URL, or the mock; the mock also has questions that fail, that are ended, and that wait for others.

import { startMock } from '../tests/mock/server.mjs'
import { DESKTOP, PHONE, launch } from './browser.mjs'
import {
  axe,
  axeDark,
  check,
  expect,
  fail,
  finish,
  guarded,
  measure,
  openPage,
  picture,
  until,
  untilOver,
} from './checks.mjs'
import { byMock } from './what-if-mock.mjs'

/** How long robots wander before anybody asks: as far as is asked ahead, and some before. */
const WANDER_MS = 14_000
const AHEAD_S = 10
const DRAWS = 10
/** A robot that was told to stop ends this near to where it was, metres: it rolls out. */
const ROLLS_OUT = 0.25
/** The robot that is asked about went at least so far, metres. */
const WENT = 0.3

const mock = process.env.BASE_URL === undefined ? await startMock({ robots: 12 }) : null
const base = mock?.url ?? process.env.BASE_URL
const id = (page, name) => page.getByTestId(name)
const data = (locator, name) => locator.getAttribute(`data-${name}`)
const api = async (path, body) => {
  const init = body === undefined ? {} : { method: 'POST', body: JSON.stringify(body) }
  const answer = await fetch(`${base}/api/v1${path}`, {
    ...init,
    headers: { 'content-type': 'application/json' },
  })
  expect(answer.ok, `${path} was answered ${answer.status}`)
  return answer.json()
}

/** The moment that is asked of, and a robot that went on from there. */
async function somethingToAsk() {
  const { to } = await api('/history')
  const at = to - AHEAD_S * 1_000 - 500
  const { robots } = await api(`/history/frames?from=${at}&to=${to}&step=500`)
  const far = ({ x, y }) => Math.hypot(x.at(-1) - x[0], y.at(-1) - y[0])
  const [first] = robots
    .filter(({ at: times }) => times.length > 10)
    .sort((a, b) => far(b) - far(a))
  expect(first !== undefined && far(first) > WENT, 'no robot went anywhere')
  return { at, robot: first.robot }
}

/** Opens the form at a moment, asks, and gives the id of the question. */
async function ask(page, { at, robot }, tell = 'tell-stop') {
  await page.goto('about:blank')
  await page.goto(`${base}/#/history?from=${at - 60_000}&to=${at + 60_000}&at=${at}&robot=${robot}`)
  await until('the record is not there', async () => {
    return ['shown', 'empty'].includes(await data(id(page, 'history'), 'here'))
  })
  await id(page, 'what-if').click()
  await id(page, 'what-if-form').waitFor()
  await id(page, 'what-if-seconds').selectOption(String(AHEAD_S))
  await id(page, 'what-if-draws').selectOption(String(DRAWS))
  await id(page, tell).click()
  await id(page, 'what-if-ask').click()
}

const answered = async (page) => {
  await id(page, 'what-if-one').waitFor()
  const state = () => data(id(page, 'what-if-one'), 'state')
  await untilOver(
    'there is no answer',
    async () => (await state()) !== 'running',
    async () => {
      const left = id(page, 'what-if-progress')
      return (await left.count()) === 0 ? 'none' : data(left, 'done').catch(() => 'none')
    },
  )
  expect((await state()) === 'done', `it is ${await state()}`)
  await id(page, 'worlds').waitFor()
}

const time = async (page) => Number(await data(id(page, 'world-line'), 't'))
const place = async (page, world) => {
  const words = id(page, `world-${world}-words`)
  const [x, y] = await Promise.all(['x', 'y'].map((name) => data(words, name)))
  return { x: Number(x), y: Number(y) }
}
const apart = (a, b) => Math.hypot(a.x - b.x, a.y - b.y)

async function round(page) {
  let asked = null
  await check('robots wander, and the server records it', async () => {
    const begun = Date.now()
    await api('/swarm/commands', { command: 'behave', parameters: { behaviour: 'wander' } })
    await until('nothing new is recorded', async () => {
      const { to } = await api('/history')
      return to !== null && to > begun + WANDER_MS
    })
    asked = await somethingToAsk()
    return asked.robot
  })
  await check('the history of a robot asks what if it had been told to stop', async () => {
    await page.goto(`${base}/#/robots/${asked.robot}`)
    await id(page, 'robot-history').click()
    await id(page, 'what-if').waitFor()
    await ask(page, asked)
    await until('there is no page of the question', () => page.url().includes('#/what-if?id='))
  })
  await check('the answer comes, with both worlds', async () => {
    await answered(page)
    for (const world of ['was', 'would']) {
      await id(page, `world-${world}`).waitFor()
      const problem = await data(id(page, `world-${world}`), 'problem')
      expect(problem === 'none', `the picture has a problem: ${problem}`)
      const robot = await data(id(page, `world-${world}-words`), 'robot')
      expect(robot === asked.robot, `${robot} is chosen`)
    }
    return id(page, 'null-test').textContent()
  })
  await check('the robot that is told to stop stays, in the other world it goes on', async () => {
    const line = id(page, 'world-line')
    await line.focus()
    await page.keyboard.press('Home')
    await until('it is not at the beginning', async () => (await time(page)) === 0)
    const [was, would] = [await place(page, 'was'), await place(page, 'would')]
    expect(apart(was, would) < 0.02, `they begin ${apart(was, would).toFixed(3)} m apart`)
    await page.keyboard.press('End')
    await until('it is not at the end', async () => (await time(page)) === AHEAD_S * 1_000)
    const [wasEnd, wouldEnd] = [await place(page, 'was'), await place(page, 'would')]
    const rolled = apart(would, wouldEnd)
    const row = page.locator(`[data-testid=apart] tr[data-robot="${asked.robot}"]`)
    const parted = Number(await data(row, 'apart'))
    expect(rolled < ROLLS_OUT, `it went on for ${rolled.toFixed(2)} m`)
    expect(apart(was, wasEnd) > rolled || parted > 0.05, 'it makes no difference')
    return `${apart(was, wasEnd).toFixed(2)} m, and ${rolled.toFixed(2)} m with the stop`
  })
  await check('both worlds play in step, by hand and by keys', async () => {
    const line = id(page, 'world-line')
    await line.focus()
    await page.keyboard.press('Home')
    await until('it is not at the beginning', async () => (await time(page)) === 0)
    await page.keyboard.press('Shift+ArrowRight')
    await until('a small step is another', async () => (await time(page)) === 200)
    await page.keyboard.press('PageUp')
    await until('a large step goes nowhere', async () => (await time(page)) > 1_000)
    await page.keyboard.press('Home')
    const before = await place(page, 'was')
    await id(page, 'play').click()
    await until('time does not pass', async () => (await time(page)) > 800)
    await until('nothing moves', async () => apart(before, await place(page, 'was')) > 0.02)
    await until('it plays on', async () => {
      if ((await data(id(page, 'play'), 'playing')) === 'false') return true
      await id(page, 'play').click()
      return false
    })
  })
  await check('a link shows the same time', async () => {
    await id(page, 'world-line').focus()
    await page.keyboard.press('Home')
    await page.keyboard.press('Shift+ArrowRight')
    await until('it is not in the address', () => page.url().includes('after=200'))
    await page.reload()
    await answered(page)
    await until('it is another time', async () => (await time(page)) === 200)
    return page.url().split('?').pop()
  })
  await check('the view of one world is that of the other', async () => {
    const camera = (world) => data(id(page, `world-${world}`), 'camera')
    const before = await camera('would')
    await id(page, 'world-was').focus()
    await page.keyboard.press('+')
    await page.keyboard.press('ArrowLeft')
    await until('the other stands', async () => (await camera('would')) !== before)
    await until('they differ', async () => (await camera('was')) === (await camera('would')))
    await page.keyboard.press('Home')
    await until('it does not fit', async () => (await camera('would')) === before)
  })
  await check('tables say what is different, and choose robots', async () => {
    for (const name of ['contacts', 'way_m']) {
      await page.locator(`[data-testid=measures] [data-measure=${name}]`).waitFor()
    }
    const rows = page.locator('[data-testid=apart] tbody tr')
    const apartOf = await rows.evaluateAll((all) => all.map((row) => Number(row.dataset.apart)))
    expect(
      apartOf.every((one, at) => at === 0 || one <= apartOf[at - 1]),
      'rows are not in order',
    )
    if (apartOf.length < 2) return 'one robot'
    const other = await data(rows.nth(1), 'robot')
    await rows.nth(1).getByTestId('choose-robot').click()
    for (const world of ['was', 'would']) {
      await until('another is chosen', async () => {
        return (await data(id(page, `world-${world}-words`), 'robot')) === other
      })
    }
    expect(page.url().includes(`robot=${other}`), 'it is not in the address')
    await rows.nth(0).getByTestId('choose-robot').click()
    return other
  })
  await check('the list has it, and leads back to the moment', async () => {
    const moment = await id(page, 'what-if-moment').getAttribute('href')
    expect(moment.includes(`at=${asked.at}`), `it leads to ${moment}`)
    await id(page, 'what-if-all').click()
    const row = page.locator('[data-testid=what-if-list] tbody tr').first()
    await row.waitFor()
    expect((await data(row, 'state')) === 'done', 'it is not done')
    await axe(page, 'list')
    await picture(page, 'what-if-list')
    await row.locator('th a').click()
    await id(page, 'worlds').waitFor()
  })
  return asked
}

async function looks(browser, page, asked) {
  const address = page.url()
  const touch = { hasTouch: true, isMobile: true, reducedMotion: 'reduce' }
  const phone = await openPage(browser, { viewport: PHONE, ...touch })
  for (const [size, viewport] of Object.entries({ desktop: DESKTOP, phone: PHONE })) {
    const here = size === 'phone' ? phone : page
    await check(`no accessibility violations: ${size}`, async () => {
      await here.setViewportSize(viewport)
      await here.goto('about:blank')
      await here.goto(address)
      await id(here, 'worlds').waitFor()
      await until('nothing is drawn', async () => {
        return (await data(id(here, 'world-would-words'), 'robot')) === asked.robot
      })
      await (size === 'phone' ? measure : axe)(here, 'what if')
      await picture(here, `what-if-${size}-light`)
      await axeDark(here, 'what if', () => picture(here, `what-if-${size}-dark`))
      await id(here, 'apart').scrollIntoViewIfNeeded()
      await picture(here, `what-if-${size}-tables`)
    })
    await check(`no accessibility violations: ${size}, the form`, async () => {
      await here.goto('about:blank')
      const { at, robot } = asked
      await here.goto(
        `${base}/#/history?from=${at - 60_000}&to=${at + 60_000}&at=${at}&robot=${robot}`,
      )
      await id(here, 'what-if').click()
      await id(here, 'tell-wander').click()
      await (size === 'phone' ? measure : axe)(here, 'form')
      await picture(here, `what-if-${size}-form`)
      await here.keyboard.press('Escape')
      await id(here, 'what-if-form').waitFor({ state: 'detached' })
    })
  }
  await phone.context().close()
}

const guard = guarded()
try {
  const browser = await launch()
  const page = await openPage(browser)
  const asked = await round(page)
  await looks(browser, page, asked)
  if (mock !== null) await byMock({ browser, page, mock, ask, asked })
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
clearTimeout(guard)
await mock?.close()
finish()
