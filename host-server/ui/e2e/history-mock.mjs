// What the page about the past does when the record has gaps, is empty, or the server goes away;
// and how it looks. Needs a hand on the server, so it runs against the mock only.

import { DESKTOP, PHONE, WALL } from './browser.mjs'
import { axe, axeDark, check, expect, measure, picture, until } from './checks.mjs'

const MINUTE = 60_000
const id = (page, name) => page.getByTestId(name)
const data = (locator, name) => locator.getAttribute(`data-${name}`)

export async function byMock({ browser, page, mock, newPage, shown, reads }) {
  const base = mock.url
  const span = await (await fetch(`${base}/api/v1/history`)).json()
  const started = span.from + 10 * MINUTE
  const link = (at, more = '') =>
    `${base}/#/history?from=${started - 10 * MINUTE}&to=${started}&at=${at}${more}`
  // What stood there before is shown until the new address is taken up.
  const goTo = async (page, address) => {
    await page.goto(address)
    const wanted = new URLSearchParams(new URL(address).hash.split('?')[1]).get('at')
    await until('another moment is shown', async () => {
      return (await data(id(page, 'history'), 'at')) === wanted
    })
    await shown(page)
  }
  const at = async (page) => (await reads(page)).at

  await check('a gap in the record is shown as one', async () => {
    await goTo(page, link(started - 275_000, '&robot=sim-0005'))
    const words = id(page, 'history-summary')
    await until('the silent robot is not counted', async () => {
      return (await data(words, 'gaps')) === '1'
    })
    const text = await words.textContent()
    expect(/sim-0005: nothing recorded for 25 s/.test(text), `the words are ${text}`)
    const before = await reads(page)
    await id(page, 'step-forward').click()
    await until('nothing is shown', async () => (await reads(page)).robot === 'sim-0005')
    const after = await reads(page)
    expect(after.at === before.at + 1_000, 'a step is another')
    expect(after.x === before.x && after.y === before.y, 'motion is made up')
  })
  await check('keys move along the time line', async () => {
    const line = id(page, 'time-line')
    const middle = started - 5 * MINUTE
    await goTo(page, link(middle, '&robot=sim-0003'))
    await line.focus()
    const steps = [
      ['ArrowRight', 5_000],
      ['ArrowLeft', 0],
      ['Shift+ArrowRight', 200],
      ['Shift+ArrowLeft', 0],
      ['PageUp', 50_000],
      ['PageDown', 0],
      ['End', 5 * MINUTE],
      ['Home', -5 * MINUTE],
    ]
    for (const [key, by] of steps) {
      await page.keyboard.press(key)
      await until(`${key} went elsewhere`, async () => (await at(page)) === middle + by)
    }
    const value = await line.getAttribute('aria-valuetext')
    expect(/\d{2}:\d{2}:\d{2}/.test(value), `it is called ${value}`)
    return value
  })
  await check('hands drag along it, and the address follows', async () => {
    const box = await id(page, 'time-line').boundingBox()
    const y = box.y + 30
    await page.mouse.move(box.x + 10, y)
    await page.mouse.down()
    await page.mouse.move(box.x + box.width / 2, y, { steps: 12 })
    await page.mouse.up()
    const middle = started - 5 * MINUTE
    expect(Math.abs((await at(page)) - middle) < 2_000, 'it is elsewhere')
    await until('the address does not say', async () => {
      return page.url().includes(`at=${await at(page)}`)
    })
    await shown(page)
  })
  await check('it plays sixty times as fast, without a break', async () => {
    await id(page, 'play-speed').selectOption('60')
    await until('the speed is not in the address', () => page.url().includes('speed=60'))
    const before = await at(page)
    await id(page, 'play').click()
    await until('time does not pass', async () => (await at(page)) > before + 60_000)
    // A step pauses also where it has come to the end by now, and the button would begin anew.
    await id(page, 'step-back').click()
    expect((await data(id(page, 'play'), 'playing')) === 'false', 'it plays on')
    await id(page, 'play-speed').selectOption('1')
  })
  await check('the arena is the one of that time', async () => {
    const count = async (time) => {
      const path = `/api/v1/history/frames?from=${time}&to=${time + 1_000}&step=200`
      const { arena } = await (await fetch(base + path)).json()
      return arena.obstacles.length
    }
    const [before, then] = [await count(started - 250_000), await count(started - 200_000)]
    expect(then === before + 1, 'the mock changes nothing')
    const canvas = id(page, 'history-arena')
    for (const [time, things] of [
      [started - 250_000, before],
      [started - 200_000, then],
    ]) {
      await goTo(page, link(time))
      await until('another arena is shown', async () => {
        return (await data(canvas, 'things')) === String(things)
      })
    }
  })
  await check('robots are chosen in the picture and followed, none can be driven', async () => {
    await goTo(page, link(started - 200_000))
    const canvas = id(page, 'history-arena')
    await canvas.focus()
    await page.keyboard.press('Enter')
    await until('nobody is chosen', () => page.url().includes('robot='))
    await page.keyboard.press('f')
    await until('nobody is followed', async () => {
      return (await data(canvas, 'follow')) === 'true'
    })
    const sent = mock.commands.length
    for (const key of ['w', 'ArrowUp', 'g']) await page.keyboard.press(key)
    expect(mock.commands.length === sent, 'a key drove')
    for (const tool of ['go', 'lasso']) {
      const here = page.locator(`.history-arena [data-testid=${tool}]`)
      expect((await here.count()) === 0, `there is ${tool}`)
    }
  })
  await check('charts are in step, and a click in one changes the time', async () => {
    await goTo(page, link(started - 200_000, '&robot=sim-0003'))
    const over = page.locator('[data-chart=range] .u-over')
    await over.waitFor()
    const box = await over.boundingBox()
    await page.mouse.click(box.x + box.width * 0.25, box.y + 20)
    const quarter = started - 10 * MINUTE + 150_000
    await until('the time is another', async () => {
      return Math.abs((await at(page)) - quarter) < 5_000
    })
    const mark = await page.locator('[data-chart=range] .u-moment').boundingBox()
    expect(Math.abs(mark.x - (box.x + box.width * 0.25)) < 4, 'the line is elsewhere')
  })
  await check('events are filtered, paged, and one of the live log leads here', async () => {
    await goTo(page, link(started - 200_000, '&robot=sim-0003'))
    const entries = page.locator('.recorded-entry')
    await until('no page of events', async () => (await entries.count()) >= 200)
    await until('no current one', async () => {
      return (await page.locator('.recorded-entry[aria-current]').count()) === 1
    })
    await id(page, 'recorded-level').selectOption('error')
    await until('others are shown', async () => {
      const levels = await entries.evaluateAll((all) => all.map((one) => one.dataset.level))
      return levels.length > 0 && levels.every((level) => level === 'error')
    })
    expect(page.url().includes('level=error'), 'the level is not in the address')
    await id(page, 'recorded-level').selectOption('info')
    await id(page, 'recorded-only').click()
    await until('others are shown', async () => {
      const texts = await entries.allTextContents()
      return texts.length > 0 && texts.every((text) => text.includes('sim-0003'))
    })
    await page.goto(`${base}/#/`)
    mock.broadcastEvent('warn', 'sim-0002', 'something odd')
    await page
      .locator('.event-log .entry', { hasText: 'something odd' })
      .locator('.entry-time')
      .click()
    await shown(page)
    expect(page.url().includes('robot=sim-0002'), 'its robot is not in the address')
  })
  await check('the range is chosen, zoomed and typed', async () => {
    await goTo(page, link(started - 200_000))
    const line = id(page, 'time-line')
    const length = async () => Number(await data(line, 'to')) - Number(await data(line, 'from'))
    await id(page, 'closer').click()
    await until('it is not closer', async () => (await length()) === 5 * MINUTE)
    await id(page, 'wider').click()
    await until('it is not wider', async () => (await length()) === 10 * MINUTE)
    await id(page, 'history-range').selectOption(String(60 * MINUTE))
    await until('it is no hour', async () => (await length()) === 60 * MINUTE)
    await id(page, 'from-to').click()
    const [from, to] = [page.locator('#history-from'), page.locator('#history-to')]
    await to.fill(await from.inputValue())
    await id(page, 'show-range').click()
    expect((await page.locator('#history-order').textContent()) !== '', 'nonsense is taken')
    await axe(page, 'from and to')
    await id(page, 'from-to').click()
  })
  await troubles({ page, mock, base, link, started, goTo, at })
  await looks({ browser, page, newPage, link, started, goTo })
}

async function troubles({ page, mock, base, link, started, goTo, at }) {
  await check('a record that cannot be read is named, and read again', async () => {
    mock.record.setFailing(500)
    await page.goto(link(started - 400_000))
    await id(page, 'history-retry').waitFor()
    const left = await data(id(page, 'history-summary'), 'shown')
    expect(left === null, 'another moment is shown in its place')
    await axe(page, 'failed')
    await picture(page, 'history-failed')
    mock.record.setFailing(null)
    await id(page, 'history-retry').click()
    await until('it is not shown', async () => {
      return (await data(id(page, 'history'), 'here')) === 'shown'
    })
  })
  await check('while the server is away, what is loaded can be looked at', async () => {
    // Well inside a piece of the record: what is beside it is there as well.
    await goTo(page, link(Math.floor((started - 400_000) / MINUTE) * MINUTE + 15_000))
    mock.setDown(true)
    try {
      await id(page, 'history-offline').waitFor()
      const before = await at(page)
      await id(page, 'step-back').click()
      // The moment goes into the address a moment later, and what is loaded must outlast that.
      const back = String(before - 1_000)
      await until('the moment is not in the address', () => page.url().includes(`at=${back}`))
      expect((await at(page)) === before - 1_000, 'another moment is shown')
      expect((await data(id(page, 'history'), 'here')) === 'shown', 'it is gone')
      await axe(page, 'offline')
    } finally {
      mock.setDown(false)
    }
    await until('it is not back', async () => {
      return (await id(page, 'history-offline').count()) === 0
    })
  })
  await check('where nothing was recorded, the way to the record is shown', async () => {
    await page.goto(`${base}/#/history?from=${started - 7_200_000}&to=${started - 7_000_000}`)
    await id(page, 'to-record').click()
    await until('it is not shown', async () => {
      return (await data(id(page, 'history'), 'here')) === 'shown'
    })
  })
  await check('a server that never recorded anything says so', async () => {
    mock.record.setEmpty(true)
    // Another page first: only then is the server asked anew.
    await page.goto(`${base}/#/dashboard`)
    await page.locator('#page-title').waitFor()
    await page.goto(`${base}/#/history`)
    await id(page, 'nothing-recorded').waitFor()
    await axe(page, 'nothing')
    await picture(page, 'history-nothing')
    mock.record.setEmpty(false)
  })
}

async function looks({ browser, page, newPage, link, started, goTo }) {
  const options = { viewport: PHONE, hasTouch: true, isMobile: true, reducedMotion: 'reduce' }
  const phone = await newPage(browser, options)
  await page.emulateMedia({ reducedMotion: 'reduce' })
  for (const [size, viewport] of Object.entries({ desktop: DESKTOP, wall: WALL, phone: PHONE })) {
    const here = size === 'phone' ? phone : page
    await check(`no accessibility violations: ${size}, light`, async () => {
      await here.setViewportSize(viewport)
      await goTo(here, link(started - 275_000, '&robot=sim-0003'))
      await here.locator('[data-chart=wheels] canvas').waitFor()
      if (size === 'phone') {
        await measure(here, 'history')
        const box = await id(here, 'stop-all').boundingBox()
        expect(box !== null && box.y + box.height <= viewport.height, 'no stop in reach')
        const line = await id(here, 'time-line').boundingBox()
        expect(line.y + line.height <= box.y, 'the time line is out of reach')
      } else {
        await axe(here, 'history')
      }
      await picture(here, `history-${size}-light`)
    })
    await check(`no accessibility violations: ${size}, dark`, () => {
      return axeDark(here, 'history', () => picture(here, `history-${size}-dark`))
    })
  }
  await phone.context().close()
}
