// `npm run e2e:history`: looks at the past in a real browser. Against the server at BASE_URL, whose
// robots are let move for some seconds first; without it against the mock, which has a past of its own.

import { startMock } from '../tests/mock/server.mjs'
import { launch } from './browser.mjs'
import {
  check,
  expect,
  fail,
  finish,
  guarded,
  openPage,
  picture,
  until,
  within,
} from './checks.mjs'
import { byMock } from './history-mock.mjs'

/** How far the picture may be from what the server recorded, metres: it blends between points. */
const NEAR = 0.05
/** How long robots move before anybody looks back. */
const MOVE_MS = 7_000

const mock = process.env.BASE_URL === undefined ? await startMock({ robots: 50 }) : null
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

const newPage = openPage

/** Points that are further apart than this have a gap between them, in which nothing is made up. */
const GAP_MS = 2_000
/** Whoever was silent for longer is not asked about here. */
const SILENT_MS = 30_000

/** Where a robot was, as the server tells it: blended between the points around a moment. */
async function whereWas(robot, at) {
  const query = `from=${at - SILENT_MS}&to=${at + GAP_MS}&step=100&robots=${robot}`
  const [track] = (await api(`/history/frames?${query}`)).robots
  const i = track?.at.findLastIndex((time) => time <= at) ?? -1
  expect(i >= 0, `nothing is recorded of ${robot} before ${at}`)
  const apart = (track.at[i + 1] ?? Number.POSITIVE_INFINITY) - track.at[i]
  const share = apart <= GAP_MS ? (at - track.at[i]) / apart : 0
  const blend = (column) => column[i] + (share > 0 ? (column[i + 1] - column[i]) * share : 0)
  return { x: blend(track.x), y: blend(track.y) }
}

const shown = (page) =>
  until('no moment is shown', async () => {
    return (await data(id(page, 'history'), 'here')) === 'shown'
  })

/** What the page says of the chosen robot at the moment. */
async function reads(page) {
  const words = id(page, 'history-summary')
  const [robot, x, y] = await Promise.all(['robot', 'x', 'y'].map((name) => data(words, name)))
  const at = Number(await data(id(page, 'time-line'), 'at'))
  return { robot, at, x: Number(x), y: Number(y) }
}

async function agrees(page, robot) {
  const seen = await until('the robot is not shown', async () => {
    const found = await reads(page)
    return found.robot === robot && found
  })
  const was = await whereWas(robot, seen.at)
  const off = Math.hypot(seen.x - was.x, seen.y - was.y)
  expect(off < NEAR, `${robot} is shown ${off.toFixed(3)} m from where it was`)
  return seen
}

async function scrub(browser, page) {
  let robot = ''
  let begun = 0
  await check('robots move, and the server records it', async () => {
    await page.goto(base)
    const row = page.locator('[data-testid=robot-row][data-presence=online]').first()
    await row.waitFor()
    robot = await data(row, 'robot-id')
    begun = Date.now()
    await api('/swarm/commands', { command: 'behave', parameters: { behaviour: 'wander' } })
    // Nobody needs to watch: a page in which all robots move draws all the time.
    await page.goto('about:blank')
    await until('nothing new is recorded', async () => {
      const { to } = await api('/history')
      return to !== null && to > begun + MOVE_MS
    })
    return robot
  })
  await check('the page of a robot leads to its past', async () => {
    await page.goto(`${base}/#/robots/${robot}`)
    await id(page, 'robot-history').click()
    await shown(page)
    expect(page.url().includes(`robot=${robot}`), 'the robot is not in the address')
    await agrees(page, robot)
    expect(!(await page.locator('#drive-pad').isVisible()), 'it can be driven')
    expect(await id(page, 'stop-all').isVisible(), 'the stop is out of reach')
  })
  let late = null
  await check('scrubbing back shows where it was, as the server has it', async () => {
    late = await agrees(page, robot)
    const line = id(page, 'time-line')
    await line.focus()
    for (let i = 0; i < 3; i++) await page.keyboard.press('ArrowLeft')
    await until('the time did not change', async () => {
      return (await reads(page)).at <= late.at - 3_000
    })
    await shown(page)
    const early = await agrees(page, robot)
    await picture(page, 'history')
    return `${((late.at - early.at) / 1_000).toFixed(1)} s back, ${Math.hypot(late.x - early.x, late.y - early.y).toFixed(2)} m away`
  })
  await check('a link shows a colleague the same moment and robot', async () => {
    await id(page, 'copy-moment').click()
    const here = await reads(page)
    const copy = await newPage(browser)
    await copy.goto(page.url())
    await shown(copy)
    const there = await agrees(copy, robot)
    expect(there.at === here.at, `another moment: ${there.at - here.at} ms later`)
    expect(Math.hypot(there.x - here.x, there.y - here.y) < 0.002, 'it is shown elsewhere')
    await copy.context().close()
  })
  await check('it plays on from there, and stands when told to', async () => {
    const before = (await reads(page)).at
    await id(page, 'play').click()
    await until('time does not pass', async () => {
      return (await reads(page)).at > before + 800
    })
    // It may have come to the end meanwhile, where the button begins anew.
    await until('it plays on', async () => {
      if ((await data(id(page, 'play'), 'playing')) === 'false') return true
      await id(page, 'play').click()
      return false
    })
    await shown(page)
    await agrees(page, robot)
  })
  await check('a command stands among the recorded events, and leads to its time', async () => {
    await page.goto(`${base}/#/history?from=${begun - 30_000}&to=${Date.now()}`)
    const entry = page.locator('.recorded-entry').first()
    await entry.waitFor()
    // What is shown first may be of the stretch before yet, and go with it.
    await until('the time is another', async () => {
      await entry.getByTestId('recorded-entry').click()
      const time = Number(await data(entry, 'time'))
      return within(1_000, async () => (await reads(page)).at === time)
    })
    expect((await entry.getAttribute('aria-current')) === 'time', 'it is not the current one')
  })
}

const guard = guarded()
try {
  const browser = await launch()
  const page = await newPage(browser)
  if (mock === null) await scrub(browser, page)
  else await byMock({ browser, page, mock, newPage, shown, reads })
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
clearTimeout(guard)
await mock?.close()
finish()
