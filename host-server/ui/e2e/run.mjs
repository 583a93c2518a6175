// `npm run e2e`: what an operator does, in a real browser, against the server
// at BASE_URL. Prints one line per check and a closing 'N passed, N failed';
// exits non-zero when anything failed. SCREENSHOTS=DIR keeps pictures.

import { DESKTOP, PHONE, launch } from './browser.mjs'
import { PATIENCE_MS, axe, check, exchanged, expect, fail } from './checks.mjs'
import { finish, guarded, picture, until, within } from './checks.mjs'
import { fenced } from './fence-check.mjs'

/**
 * Standing: no further than this over the time watched, metres. The slowest drive is twice as
 * fast; a robot that has just stopped is still put right by a few centimetres.
 */
const STILL_METRES = 0.05
/** How often the server says how many robots there are, while it is watched that none moves. */
const STILL_FOR = 2
/** For a robot to get somewhere before the other way is tried. */
const OTHER_WAY_MS = 10_000
/** For robots to get going before they are told once more. */
const AGAIN_MS = 10_000
/** Moving: at least this far, metres. */
const MOVED_METRES = 0.06
const STATES_AT_REST = new Set(['IDLE', 'ERROR'])

const base = process.env.BASE_URL
if (base === undefined) {
  console.error('BASE_URL is not set: give the address of a running server')
  process.exit(2)
}

function robots(page) {
  return page.evaluate(() => globalThis.terracrawler.robots())
}

/** The farthest that any robot is from where it was, and which one. */
function farthest(before, after) {
  const then = new Map(before.map((robot) => [robot.id, robot]))
  let most = { id: 'none', metres: 0 }
  for (const robot of after) {
    const old = then.get(robot.id)
    if (old === undefined) continue
    const metres = Math.hypot(robot.x - old.x, robot.y - old.y)
    if (metres > most.metres) most = { id: robot.id, metres }
  }
  return most
}

function moved(before, after, metres = MOVED_METRES) {
  const then = new Map(before.map((robot) => [robot.id, robot]))
  return after.filter((robot) => {
    const old = then.get(robot.id)
    return old !== undefined && Math.hypot(robot.x - old.x, robot.y - old.y) > metres
  })
}

async function one(page, id) {
  const found = (await robots(page)).find((robot) => robot.id === id)
  expect(found !== undefined, `${id} is no longer in the fleet`)
  return found
}

/** A reachable robot that is not about to run into something. */
function withRoom(list) {
  const online = list.filter((robot) => robot.presence === 'online')
  const lonely = (robot) =>
    Math.min(
      ...list
        .filter((other) => other.id !== robot.id)
        .map((other) => Math.hypot(other.x - robot.x, other.y - robot.y)),
    )
  const ranked = online
    .filter(({ state }) => state === 'IDLE')
    .sort((a, b) => lonely(b) - lonely(a))
  return ranked[0] ?? online[0]
}

async function operate(page) {
  let poseFrames = 0
  let metricsFrames = 0
  page.on('websocket', (socket) => {
    socket.on('framereceived', ({ payload }) => {
      if (typeof payload === 'string') return
      if (payload[0] === 2) poseFrames += 1
      if (payload[0] === 4) metricsFrames += 1
    })
  })
  // The server tells the time once a second, behind everything that it told before.
  const later = async (count = 1) => {
    const before = metricsFrames
    await until('the server is silent', () => metricsFrames >= before + count)
  }
  const requests = []
  page.on('request', (request) => {
    if (request.method() === 'POST') requests.push(`${request.url()} ${request.postData()}`)
  })

  await check('the page loads and shows robots', async () => {
    const response = await page.goto(base)
    expect(response?.ok() === true, `the page answered ${response?.status()}`)
    const rows = page.locator('[data-testid=robot-row][data-x]')
    await rows.first().waitFor()
    await until('the feed is not live', async () => {
      return (await page.getByTestId('connection').getAttribute('data-connection')) === 'live'
    })
    return `${(await robots(page)).length} robots`
  })

  await check('robots move', async () => {
    const before = await robots(page)
    const wanted = Math.min(3, before.length)
    // A fleet that stands after an earlier run is set going as an operator would.
    if ((await page.getByTestId('stop-panel').getAttribute('data-stop')) === 'stopped') {
      await page.getByTestId('rearm').click()
    }
    await later(2)
    if (moved(before, await robots(page), 0.03).length < wanted) {
      await page.getByTestId('wander-all').click()
    }
    const found = await until(`fewer than ${wanted} robots moved`, async () => {
      const list = moved(before, await robots(page))
      return list.length >= wanted ? list : null
    })
    return `${found.length} of ${before.length} robots`
  })

  await check('the arena is drawn', async () => {
    const canvas = page.getByTestId('arena')
    expect((await canvas.getAttribute('data-problem')) === 'none', 'the arena reports a problem')
    const first = Number(await canvas.getAttribute('data-drawn'))
    await until('no new picture', async () => {
      return Number(await canvas.getAttribute('data-drawn')) > first
    })
  })
  await picture(page, 'moving')

  await check('no accessibility violations while moving', () => axe(page, 'axe-core'))

  await check('a space in the search field is text', async () => {
    const search = page.getByTestId('search')
    await search.click()
    await page.keyboard.type('a b')
    expect((await search.inputValue()) === 'a b', 'the field did not take the space')
    expect(
      !requests.some((text) => text.includes('estop')),
      'a space in the field stopped the fleet',
    )
    await search.fill('')
    await page.keyboard.press('Escape')
  })

  await check('Space stops all robots, and clicks nothing', async () => {
    // The hazard: focus on a button that Space would press.
    await page.getByTestId('wander-all').focus()
    const sentBefore = requests.length
    await page.keyboard.press('Space')
    await until('the page does not show the stop', async () => {
      return (await page.getByTestId('stop-panel').getAttribute('data-stop')) !== 'armed'
    })
    let odd
    await until(
      'not all robots stand',
      async () => {
        odd = (await robots(page)).find(
          ({ state, presence }) => presence === 'online' && !STATES_AT_REST.has(state),
        )
        return odd === undefined
      },
      () => `${odd?.id} reports ${odd?.state}`,
    )
    // The last words of robots that rolled out.
    await later()
    const before = await robots(page)
    await later(STILL_FOR)
    const after = await robots(page)
    const worst = farthest(before, after)
    expect(worst.metres <= STILL_METRES, `${worst.id} still moved ${worst.metres.toFixed(3)} m`)
    const sent = requests.slice(sentBefore)
    expect(
      sent.some((text) => text.includes('"estop"')),
      'no emergency stop was sent',
    )
    expect(!sent.some((text) => text.includes('behave')), 'Space also clicked the focused button')
    await until('the stop is not shown as delivered', async () => {
      return (await page.getByTestId('stop-panel').getAttribute('data-stop')) === 'stopped'
    })
    return `${after.length} robots, farthest ${(worst.metres * 1_000).toFixed(1)} mm`
  })
  await picture(page, 'stopped')

  await check('nothing is drawn while nothing changes', async () => {
    const pictures = async () => Number(await page.getByTestId('arena').getAttribute('data-drawn'))
    await later()
    const [frames, before] = [poseFrames, await pictures()]
    await later(STILL_FOR)
    const [news, drawn] = [poseFrames - frames, (await pictures()) - before]
    // Sensors are noisy: robots at rest may still report, and then there is something to draw.
    expect(news > 0 || drawn === 0, `${drawn} pictures without any news`)
    return `${drawn} pictures, ${news} reports`
  })

  let chosen = ''
  await check('while stopped, driving is refused with a reason', async () => {
    chosen = withRoom(await robots(page)).id
    await page.getByTestId('search').fill(chosen)
    await page.locator(`[data-robot-id="${chosen}"][data-testid=robot-row]`).click()
    const pad = page.getByTestId('drive-pad')
    expect((await pad.getAttribute('data-blocked')) === 'stopped', 'the pad is not blocked')
    const before = requests.length
    await page.keyboard.down('ArrowUp')
    await later()
    await page.keyboard.up('ArrowUp')
    await exchanged(page)
    expect(
      !requests.slice(before).some((text) => text.includes('"drive"')),
      'a drive command went out',
    )
    return (await page.getByTestId('drive-words').textContent())?.trim()
  })

  await check('re-arming moves nothing', async () => {
    const before = await robots(page)
    await page.getByTestId('rearm').click()
    await until('still latched', async () => {
      return (await page.getByTestId('stop-panel').getAttribute('data-stop')) === 'armed'
    })
    await later(STILL_FOR)
    const worst = farthest(before, await robots(page))
    expect(worst.metres <= STILL_METRES, `${worst.id} moved ${worst.metres.toFixed(3)} m`)
  })

  await check('a held arrow key drives the selected robot, and only it', async () => {
    const everyone = await robots(page)
    chosen = withRoom(everyone).id
    await page.getByTestId('search').fill(chosen)
    await page.locator(`[data-robot-id="${chosen}"][data-testid=robot-row]`).click()
    await page.getByTestId('search').fill('')
    await page.getByTestId('drive-pad').focus()
    const before = await one(page, chosen)
    const distance = async () => {
      const now = await one(page, chosen)
      return Math.hypot(now.x - before.x, now.y - before.y)
    }
    let metres = 0
    // Whatever stands in the way ahead does not stand behind.
    for (const key of ['ArrowUp', 'ArrowDown']) {
      await page.keyboard.down(key)
      await within(OTHER_WAY_MS, async () => {
        metres = await distance()
        return metres >= 2 * MOVED_METRES
      })
      if (metres >= 2 * MOVED_METRES) break
      await page.keyboard.up(key)
    }
    const words = await page.getByTestId('drive-words').textContent()
    expect(
      metres >= MOVED_METRES,
      `${chosen} moved ${metres.toFixed(3)} m; the page says: ${words}`,
    )
    const others = moved(everyone, await robots(page)).filter(({ id }) => id !== chosen)
    expect(others.length === 0, `${others[0]?.id} moved too`)
    return `${chosen}, ${metres.toFixed(2)} m`
  })

  await check('letting go stops it', async () => {
    const before = requests.length
    await page.keyboard.up('ArrowUp')
    await page.keyboard.up('ArrowDown')
    await until('no stop was sent', async () => {
      return requests.slice(before).some((text) => text.includes(chosen) && text.includes('"stop"'))
    })
    await until('it does not come to rest', async () => {
      return STATES_AT_REST.has((await one(page, chosen)).state)
    })
    await later()
    const first = await one(page, chosen)
    await later(STILL_FOR)
    const second = await one(page, chosen)
    const metres = Math.hypot(second.x - first.x, second.y - first.y)
    expect(metres <= STILL_METRES, `${chosen} still moved ${metres.toFixed(3)} m`)
  })

  await check('losing the window stops it', async () => {
    await page.keyboard.down('ArrowLeft')
    await until('driving did not start', async () => {
      return (await page.getByTestId('drive-pad').getAttribute('data-driving')) === 'true'
    })
    const before = requests.length
    await page.evaluate(() => globalThis.dispatchEvent(new Event('blur')))
    await until('no stop was sent', async () => {
      return requests.slice(before).some((text) => text.includes('"stop"'))
    })
    await later()
    await exchanged(page)
    const tail = requests.slice(before).map((text) => /"command":"(\w+)"/.exec(text)?.[1])
    expect(tail.at(-1) === 'stop', `${tail.at(-1)} went out after the stop`)
    await page.keyboard.up('ArrowLeft')
  })
  await picture(page, 'driven')

  await check('Wander sets the fleet going again', async () => {
    const before = await robots(page)
    const enough = Math.min(3, before.length)
    let asked = Number.NEGATIVE_INFINITY
    // On a busy machine it may come later than robots obey a command; a person would press again.
    const going = async () => {
      if (performance.now() - asked > AGAIN_MS) {
        await page.getByTestId('wander-all').click()
        asked = performance.now()
      }
      return moved(before, await robots(page)).length >= enough
    }
    await until('too few robots moved', going, async () => {
      const states = (await robots(page)).map(({ id, state }) => `${id} ${state}`)
      return `${states.join(', ')}; ${requests.length} requests`
    })
  })

  await fenced(page)

  await check('the arena survives a lost graphics context', async () => {
    const canvas = page.getByTestId('arena')
    await canvas.evaluate((element) => {
      globalThis.lostContext = element.getContext('webgl2').getExtension('WEBGL_lose_context')
      globalThis.lostContext.loseContext()
    })
    await until('the loss is not shown', async () => {
      return (await canvas.getAttribute('data-problem')) === 'lost'
    })
    const before = Number(await canvas.getAttribute('data-drawn'))
    await page.evaluate(() => globalThis.lostContext.restoreContext())
    await until('nothing is drawn after the restore', async () => {
      const drawn = Number(await canvas.getAttribute('data-drawn'))
      return (await canvas.getAttribute('data-problem')) === 'none' && drawn > before
    })
  })
}

async function phone(browser) {
  const context = await browser.newContext({
    viewport: PHONE,
    hasTouch: true,
    isMobile: true,
    colorScheme: 'dark',
    deviceScaleFactor: 2,
  })
  const page = await context.newPage()
  await check('on a phone nothing is cut off and nothing violates accessibility', async () => {
    await page.goto(base)
    const row = page.locator('[data-testid=robot-row][data-presence=online]').first()
    await row.waitFor()
    await row.tap()
    const wide = await page.evaluate(() => document.documentElement.scrollWidth)
    expect(wide <= PHONE.width, `the page is ${wide} pixels wide`)
    for (const id of ['stop-all', 'pad-forward', 'pad-backward', 'speed']) {
      const box = await page.getByTestId(id).boundingBox()
      expect(box !== null && box.y + box.height <= PHONE.height, `${id} is not on the screen`)
    }
    return axe(page, 'axe-core, dark')
  })
  await picture(page, 'phone')
  await context.close()
}

const guard = guarded()

try {
  const browser = await launch()
  const context = await browser.newContext({ viewport: DESKTOP })
  const page = await context.newPage()
  page.setDefaultTimeout(PATIENCE_MS)
  const errors = []
  page.on('pageerror', (error) => errors.push(error.message))
  await operate(page)
  await check('the page threw no errors', () => {
    expect(errors.length === 0, errors[0])
  })
  await context.close()
  await phone(browser)
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
clearTimeout(guard)
finish()
