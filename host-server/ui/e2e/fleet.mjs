// `npm run e2e:fleet`: what an operator does on the pages about robots, commands and the
// simulated world, in a real browser; against the mock with a hundred robots.

import { startMock } from '../tests/mock/server.mjs'
import { PHONE, WALL, launch } from './browser.mjs'
import { afresh, axe, axeDark, check, expect, fail, finish, guarded, openPage } from './checks.mjs'
import { measure, picture, until } from './checks.mjs'
import { byKeyboard } from './keyboard.mjs'

const mock = await startMock({ robots: 100, open: true })
const base = mock.url
const id = (page, name) => page.getByTestId(name)

const PLACES = {
  room: '',
  dashboard: 'dashboard',
  robots: 'robots?as=table',
  cards: 'robots?as=cards',
  robot: 'robots/sim-0003?range=1m',
  parameters: 'robots/sim-0003?tab=parameters',
  log: 'robots/sim-0003?tab=log',
  command: 'command',
  simulation: 'simulation',
}

const newPage = openPage

let beside = null
/** Somebody else, who follows a link to what this page shows. */
async function colleague(page) {
  beside ??= await newPage(page.context().browser())
  await afresh(beside, page.url())
  return beside
}

async function goTo(page, place) {
  await page.goto(`${base}/#/${place}`)
  await until('the feed is not live', async () => {
    const lamp = id(page, 'connection')
    return (await lamp.count()) > 0 && (await lamp.getAttribute('data-connection')) === 'live'
  })
  if (place !== '') await page.locator('#page-title').waitFor()
}

const data = (locator, name) => locator.getAttribute(`data-${name}`)

async function dashboard(page) {
  await check('one look says what is wrong, and where', async () => {
    await goTo(page, 'dashboard')
    await until('the robots are not counted', async () => {
      return (await page.locator('[data-count=online]').textContent()) === '98'
    })
    const codes = page.locator('[data-testid=findings] li')
    await until('the findings are others', async () => {
      const found = await codes.evaluateAll((all) => all.map((one) => one.dataset.code))
      return found.sort().join(' ') === 'low offline stale'
    })
    expect((await data(id(page, 'health'), 'gravity')) === 'watch', 'the badge says otherwise')
    expect((await id(page, 'mode').textContent()) === 'Hybrid', 'the mode is another')
    return (await id(page, 'health').textContent()).trim()
  })
  await check('a lost broker turns the badge to bad, and back', async () => {
    mock.ready.broker = false
    await until('the badge did not turn', async () => {
      return (await data(id(page, 'health'), 'gravity')) === 'bad'
    })
    await picture(page, 'bad')
    mock.ready.broker = true
    await until('the badge did not turn back', async () => {
      return (await data(id(page, 'health'), 'gravity')) === 'watch'
    })
  })
  await check('a disk that takes nothing is told', async () => {
    Object.assign(mock.ready, { journal: false, audit: false })
    for (const code of ['journal', 'audit']) {
      await page.locator(`[data-testid=findings] li[data-code=${code}]`).waitFor()
    }
    await axe(page, 'a full disk')
    delete mock.ready.journal
    delete mock.ready.audit
    await until('it is told for ever', async () => {
      return (await page.locator('[data-testid=findings] li[data-code=journal]').count()) === 0
    })
  })
  await check('a finding leads to the robots that it is about', async () => {
    await page.locator('[data-testid=findings] li[data-code=stale] a').click()
    await until('others are shown', async () => {
      return (await data(id(page, 'robots-count'), 'shown')) === '1'
    })
    expect(page.url().includes('show=stale'), 'the filter is not in the address')
  })
  await check('a server that goes away is named, with the age of what is seen', async () => {
    await goTo(page, 'dashboard')
    mock.setDown(true)
    await page.locator('[data-testid=findings] li[data-code=link]').waitFor()
    await axe(page, 'offline')
    mock.setDown(false)
    await goTo(page, 'dashboard')
  })
}

async function findOne(page) {
  await check('a robot is found among a hundred', async () => {
    await goTo(page, 'robots?as=table')
    const rows = await id(page, 'table-row').count()
    expect(rows > 5 && rows < 60, `${rows} rows are rendered`)
    await id(page, 'robots-search').fill('rover')
    const row = page.locator('[data-testid=table-row][data-robot-id=rover-1]')
    await row.waitFor()
    expect((await data(id(page, 'robots-count'), 'shown')) === '1', 'others are shown')
    expect(page.url().includes('q=rover'), 'the search is not in the address')
    await row.locator('a').click()
    await page.locator('[data-testid=robot-page][data-robot-id=rover-1]').waitFor()
    await page.goBack()
    expect((await id(page, 'robots-search').inputValue()) === 'rover', 'the search is lost')
  })
  await check('the table sorts, both ways', async () => {
    await goTo(page, 'robots?as=table')
    await id(page, 'sort-battery').click()
    const first = page.locator('[data-testid=table-row]').first()
    await until('the weakest is not first', async () => {
      return (await data(first, 'robot-id')) === 'sim-0006'
    })
    const head = page.locator('[role=columnheader].col-battery')
    expect((await head.getAttribute('aria-sort')) === 'ascending', 'the order is not told')
    await id(page, 'sort-battery').click()
    await until('the order did not turn', async () => {
      return (await head.getAttribute('aria-sort')) === 'descending'
    })
  })
}

async function oneRobot(page) {
  await check('its page shows charts, and the same in words', async () => {
    await goTo(page, 'robots/sim-0003')
    const canvas = page.locator('[data-chart=range] canvas')
    await canvas.waitFor()
    const words = await page.locator('[data-chart=battery] figcaption').textContent()
    expect(/mean/.test(words), `the words are ${words}`)
    await id(page, 'chart-range').selectOption('1h')
    expect(page.url().includes('range=1h'), 'the range is not in the address')
    await id(page, 'chart-earlier').click()
    await id(page, 'chart-live').waitFor()
    expect(/from=\d+&to=\d+/.test(page.url()), 'the stretch is not in the address')
    await picture(page, 'robot')
    const copy = await colleague(page)
    await id(copy, 'chart-live').waitFor()
    await id(page, 'chart-live').click()
    return words.trim()
  })
  await check('dragging across a chart looks closer', async () => {
    const box = await page.locator('[data-chart=range] .u-over').boundingBox()
    await page.mouse.move(box.x + box.width * 0.3, box.y + 20)
    await page.mouse.down()
    await page.mouse.move(box.x + box.width * 0.6, box.y + 20, { steps: 4 })
    await page.mouse.up()
    await until('nothing was zoomed', () => page.url().includes('from='))
  })
  await check('the camera shows what the robot recognises', async () => {
    await id(page, 'camera').waitFor()
    expect((await page.locator('[data-testid=overlay] rect').count()) === 1, 'nothing is marked')
    await id(page, 'overlay-toggle').click()
    expect((await id(page, 'overlay').count()) === 0, 'the marks stay')
  })
  await check('a parameter is changed, and nonsense is not sent', async () => {
    await goTo(page, 'robots/sim-0003?tab=parameters')
    const field = page.locator('#p-safe_distance_mm')
    await field.fill('20')
    expect(await id(page, 'send-parameters').isDisabled(), 'a value out of range can be sent')
    await field.fill('650')
    await page.keyboard.press('Enter')
    await id(page, 'parameters-said').waitFor()
    await page.reload()
    await until('it is not kept', async () => (await field.inputValue()) === '650')
    await id(page, 'compare').fill('sim-0002')
    await until('the difference is not told', async () => {
      const told = id(page, 'differences')
      return (await told.count()) > 0 && (await told.textContent()).includes('one value')
    })
    const download = page.waitForEvent('download')
    await id(page, 'export').click()
    return (await download).suggestedFilename()
  })
  await check('its last commands and what became of them are listed', async () => {
    await goTo(page, 'robots/sim-0003')
    await page.locator('[data-command=set][data-status=completed]').waitFor()
    await id(page, 'page-stop').click()
    await page.locator('[data-command=stop][data-status=completed]').waitFor()
  })
}

/** Slides a handle to its end. */
async function slide(page, name) {
  const track = id(page, `${name}-track`)
  await track.scrollIntoViewIfNeeded()
  const box = await track.boundingBox()
  const y = box.y + box.height / 2
  await page.mouse.move(box.x + 24, y)
  await page.mouse.down()
  await page.mouse.move(box.x + box.width + 30, y, { steps: 25 })
  await page.mouse.up()
}

async function swarm(page) {
  await check('a selection is commanded, robot by robot, and kept as a group', async () => {
    await goTo(page, 'robots?as=table&q=sim-000')
    for (const robot of ['sim-0001', 'sim-0002', 'sim-0003']) {
      await page.locator(`[data-robot-id=${robot}] [role=checkbox]`).click()
    }
    await id(page, 'act').click()
    await id(page, 'tell-identify').click()
    const progress = id(page, 'progress').first()
    await until('not all are done', async () => (await data(progress, 'done')) === '3')
    await id(page, 'group-name').fill('Left wing')
    await id(page, 'save-group').click()
    await page.locator('[data-group="Left wing"]').waitFor()
    await page.reload()
    await page.locator('[data-group="Left wing"]').waitFor()
  })
  await check('a command to all asks where physical robots are, and shows progress', async () => {
    await goTo(page, 'command')
    const before = mock.commands.length
    await id(page, 'tell-gather').click()
    await id(page, 'asking').waitFor()
    await axe(page, 'a question')
    expect(mock.commands.length === before, 'it was sent unasked')
    // Some answer, the others are silent for as long as it takes to see that.
    mock.answering.most = 40
    await slide(page, 'send')
    const progress = id(page, 'progress').first()
    await until('nothing is under way', async () => {
      return Number(await data(progress, 'open')) > 0 && Number(await data(progress, 'done')) > 0
    })
    await picture(page, 'progress')
    mock.answering.most = Number.POSITIVE_INFINITY
    await until('not all are done', async () => (await data(progress, 'done')) === '98')
  })
  await check('a tap on the slide does nothing but offer a button', async () => {
    const before = mock.commands.length
    await id(page, 'tell-disperse').click()
    const box = await id(page, 'send-track').boundingBox()
    await page.mouse.click(box.x + box.width - 8, box.y + box.height / 2)
    await id(page, 'send-confirm').waitFor()
    expect(mock.commands.length === before, 'it was sent')
    await id(page, 'send-confirm').click()
    await until('it was not sent', () => mock.commands.length > before)
  })
  await check('everything is stopped without a question, and re-armed', async () => {
    await id(page, 'stop-all').click()
    const panel = id(page, 'stop-panel')
    await until('not stopped', async () => (await data(panel, 'stop')) === 'stopped')
    await until('the badge does not say', async () => {
      return (await id(page, 'health').getAttribute('title')).includes('Emergency stop')
    })
    await id(page, 'rearm').click()
    await until('not re-armed', async () => (await data(panel, 'stop')) === 'armed')
  })
}

async function shared(page) {
  await check(
    'the live room in a link: robot, search, filter; and a selection to act on',
    async () => {
      await goTo(page, '')
      await id(page, 'search').fill('sim-001')
      const rows = page.locator('[data-testid=robot-row]')
      await until('the list is not narrowed', async () => (await rows.count()) === 10)
      await rows.nth(1).click()
      await rows.nth(2).click({ modifiers: ['Shift'] })
      await id(page, 'list-chosen').waitFor()
      const chosen = await data(id(page, 'robot-panel'), 'robot-id')
      expect(page.url().includes(`robot=${chosen}`), 'the robot is not in the address')
      const copy = await colleague(page)
      await until('the link shows another robot', async () => {
        return (await data(id(copy, 'robot-panel'), 'robot-id')) === chosen
      })
      expect((await id(copy, 'search').inputValue()) === 'sim-001', 'the search is not in the link')
      return page.url().split('#')[1]
    },
  )
}

async function simulation(page) {
  await check('the world is paused, stepped, sped up and begun again', async () => {
    await goTo(page, 'simulation')
    const world = id(page, 'world')
    const is = (state) => async () => (await data(world, 'state')) === state
    await id(page, 'pause').click()
    await until('it did not pause', is('paused'))
    await id(page, 'step').click()
    await id(page, 'resume').click()
    await until('it did not go on', is('running'))
    await world.getByTestId('speed').selectOption('5')
    // Paused, its beginning stays in sight.
    await id(page, 'pause').click()
    await until('it did not pause', is('paused'))
    await slide(page, 'reset')
    await until('it did not begin again', async () => {
      return (await id(page, 'world-time').textContent()).trim() === '0 s'
    })
    await id(page, 'resume').click()
    await until('it did not go on', is('running'))
  })
  await check('robots are added, and broken and healed', async () => {
    await id(page, 'add-many').fill('3')
    await id(page, 'add-robots').click()
    await until('it is not said', async () => {
      return (await id(page, 'population-said').textContent()).includes('3 robots')
    })
    await id(page, 'fault').selectOption('motor-weak')
    await id(page, 'fault-robot').fill('sim-0002')
    await id(page, 'inject').click()
    await until('nothing is broken', () => mock.faults.length === 1)
    expect(mock.faults[0].fault.strength === 0.5, 'the number is missing')
    await id(page, 'heal').click()
    await until('nothing is healed', () => mock.faults.length === 2)
  })
}

async function events(page) {
  await check('events are searched, filtered and pinned', async () => {
    await goTo(page, 'dashboard')
    mock.broadcastEvent('error', 'sim-0002', 'a wheel fell off')
    const entry = page.locator('[data-testid=log] .entry', { hasText: 'a wheel fell off' })
    await entry.waitFor()
    await entry.locator('.pin').click()
    mock.broadcastEvent('info', 'sim-0001', 'all is well here')
    await id(page, 'log-level').selectOption('warn')
    await id(page, 'log-search-toggle').click()
    await id(page, 'log-search').fill('no such thing')
    await until('others are shown', async () => {
      return (await page.locator('[data-testid=log] .entry').count()) === 1
    })
    expect(
      page.url().includes('log=warn') && page.url().includes('events=no'),
      'the filter is not in the address',
    )
    const copy = await colleague(page)
    await id(copy, 'log-search').waitFor()
    expect((await id(copy, 'log-level').inputValue()) === 'warn', 'the link shows other events')
    await axe(page, 'events')
    await id(page, 'log-search-toggle').click()
    await id(page, 'log-level').selectOption('info')
  })
}

async function everywhere(browser, page) {
  await page.emulateMedia({ reducedMotion: 'reduce' })
  for (const [name, place] of Object.entries(PLACES)) {
    await check(`no accessibility violations: ${name}, light`, async () => {
      await goTo(page, place)
      await settle(page, name)
      await axe(page, name)
    })
    await check(`no accessibility violations: ${name}, dark`, () => axeDark(page, name))
  }
  const phone = await newPage(browser, {
    viewport: PHONE,
    hasTouch: true,
    isMobile: true,
    deviceScaleFactor: 2,
  })
  for (const [name, place] of Object.entries(PLACES)) {
    await check(`on a phone: ${name}`, async () => {
      await goTo(phone, place)
      await settle(phone, name)
      await measure(phone, name)
      await picture(phone, `phone-${name}`)
      const box = await id(phone, 'stop-all').boundingBox()
      expect(box !== null && box.y + box.height <= PHONE.height, 'the stop is not in reach')
    })
  }
  await phone.context().close()
  await check('on a wall display everything is in view', async () => {
    await page.setViewportSize(WALL)
    await goTo(page, 'dashboard')
    await settle(page, 'dashboard')
    const cut = await page.locator('.page-body').evaluate((body) => {
      return body.scrollHeight - body.clientHeight
    })
    expect(cut <= 0, `${cut} pixels are out of view`)
    await picture(page, 'wall')
  })
}

/** What a page shows last. */
async function settle(page, name) {
  const last = {
    room: '[data-testid=robot-row]',
    dashboard: '[data-testid=findings] li',
    robots: '[data-testid=table-row]',
    cards: '[data-testid=robot-card]',
    robot: '[data-chart=wheels] canvas',
    parameters: '#p-max_speed',
    log: '.log-records li',
    command: '[data-testid=tell-gather]',
    simulation: '[data-testid=faults]',
  }
  await page.locator(last[name]).first().waitFor()
}

const guard = guarded()
try {
  const browser = await launch()
  const page = await newPage(browser)
  for (const part of [dashboard, findOne, oneRobot, swarm, shared, simulation, events])
    await part(page)
  await byKeyboard(page, base, mock)
  await everywhere(browser, page)
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
clearTimeout(guard)
await mock.close()
finish()
