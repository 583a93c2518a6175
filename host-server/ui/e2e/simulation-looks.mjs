// The page of the simulation as it looks: every state, light and dark, phone to wall, and to
// those who may only watch. Against the mock, which can be put into any state.

import { DESKTOP, PHONE, WALL } from './browser.mjs'
import { afresh, axe, axeDark, check, expect, measure, picture, until } from './checks.mjs'

const BOOKMARKS = 16
const id = (page, name) => page.getByTestId(name)

/** Does to the mock what an operator could. */
async function tell(mock, command) {
  const answer = await fetch(`${mock.url}/api/v1/simulator/commands`, {
    method: 'POST',
    headers: { 'content-type': 'application/json' },
    body: JSON.stringify(command),
  })
  expect(answer.ok, `${command.command}: ${answer.status} ${await answer.clone().text()}`)
}

/** A world with everything in it that the page can show. */
async function furnish(mock) {
  await tell(mock, { command: 'load', scenario: 'dynamic-environment', robots: 6 })
  const middle = mock.world.robots.slice(0, 6)
  const colours = ['red', 'green', 'blue', 'yellow', 'orange', 'purple', 'white', 'black']
  let count = 0
  for (let x = -2.6; x < 2.7; x += 0.65) {
    const y = x % 1.3 < 0.1 ? 2 : -2
    if (middle.some((robot) => Math.hypot(robot.x - x, robot.y - y) < 0.5)) continue
    const colour = colours[count % colours.length]
    const shape = ['cylinder', 'box', 'ball', 'cone'][count % 4]
    await tell(mock, { command: 'drop', object: { shape, colour, x, y, size: 0.3 } })
    count += 1
  }
  await tell(mock, { command: 'snapshot', name: 'a-name-of-thirty-two-characters-' })
}

const STATES = {
  rest: async () => undefined,
  placing: async (page) => {
    await id(page, 'thing-kind').selectOption('cone')
    await id(page, 'thing-x').fill('1')
    await id(page, 'thing-y').fill('1')
    await page.locator('.ghost').waitFor({ state: 'attached' })
  },
  refused: async (page) => {
    await id(page, 'thing-x').fill('90')
    await id(page, 'thing-y').fill('0')
    await id(page, 'put').click()
    await page.locator('#things-trouble').waitFor()
  },
  preview: async (page) => {
    await page.locator('.scenario-card[data-scenario=search]').click()
    await until('it is not shown', async () => {
      return (await id(page, 'scenario-choice').getAttribute('data-name')) === 'search'
    })
    await id(page, 'scenario-robots').fill('many')
    await page.locator('#scenario-trouble').waitFor()
  },
  'going-back': async (page) => {
    await id(page, 'restore').first().click()
    await id(page, 'going-back').waitFor()
  },
  forgetting: async (page) => {
    await id(page, 'forget').first().click()
    await id(page, 'confirm').waitFor()
  },
}

async function settle(page) {
  await page.locator('.scenario-card[data-drawn=true]').nth(3).waitFor()
  await id(page, 'faults').waitFor()
}

export async function looks({ browser, page, mock, newPage, goTo }) {
  await furnish(mock)
  await page.emulateMedia({ reducedMotion: 'reduce' })
  for (const [state, reach] of Object.entries(STATES)) {
    await check(`no accessibility violations: ${state}, light`, async () => {
      await goTo(page, 'simulation')
      await settle(page)
      await reach(page)
      await axe(page, state)
    })
    await check(`no accessibility violations: ${state}, dark`, () => axeDark(page, state))
  }
  const phone = await newPage(browser, {
    viewport: PHONE,
    hasTouch: true,
    isMobile: true,
    deviceScaleFactor: 2,
  })
  for (const [state, reach] of Object.entries(STATES)) {
    await check(`on a phone: ${state}`, async () => {
      // From another page: nothing is left of the state before.
      await goTo(phone, 'account')
      await goTo(phone, 'simulation')
      await settle(phone)
      await reach(phone)
      await measure(phone, state)
      await picture(phone, `phone-simulation-${state}`)
      const box = await id(phone, 'stop-all').boundingBox()
      expect(box !== null && box.y + box.height <= PHONE.height, 'the stop is not in reach')
    })
  }
  await check('on a phone: a tap puts it there', async () => {
    await goTo(phone, 'simulation')
    await settle(phone)
    const before = mock.world.arena.objects.length
    await id(phone, 'thing-kind').selectOption('cube')
    const map = id(phone, 'things').getByTestId('world-map')
    const said = id(phone, 'things-said')
    // Robots may stand where the tap goes; they do not stand everywhere.
    for (const [x, y] of [
      [0.5, 0.5],
      [0.4, 0.55],
      [0.6, 0.45],
    ]) {
      const box = await map.boundingBox()
      await map.tap({ position: { x: box.width * x, y: box.height * y } })
      // Said that it is there, or why it is not.
      const told = () =>
        until('nothing is said', async () => {
          const words = (await said.textContent()).trim()
          if (words !== '') return 'put'
          return (await phone.locator('#things-trouble').count()) > 0 && 'refused'
        })
      if ((await told()) === 'put') break
    }
    expect(mock.world.arena.objects.length === before + 1, 'nothing was put in')
  })
  await check('the live room leads to putting things in', async () => {
    await goTo(phone, '')
    await id(phone, 'layers').click()
    await id(phone, 'put-in').click()
    await until('the focus is elsewhere', async () => {
      return (await phone.evaluate(() => document.activeElement.id)) === 'things-title'
    })
  })
  await phone.context().close()
  await check('on a wall', async () => {
    await page.setViewportSize(WALL)
    await goTo(page, 'command')
    await goTo(page, 'simulation')
    await settle(page)
    await axe(page, 'wall')
    await picture(page, 'wall-simulation')
  })
  await page.setViewportSize(DESKTOP)
  await full(page, mock, goTo)
  await viewer(page, mock)
}

async function full(page, mock, goTo) {
  await check('sixteen bookmarks are all there can be, and the page says so', async () => {
    for (let at = 1; at < BOOKMARKS; at++) await tell(mock, { command: 'snapshot', name: `b${at}` })
    await goTo(page, 'simulation')
    await page
      .locator('tr[data-bookmark]')
      .nth(BOOKMARKS - 1)
      .waitFor()
    expect(await id(page, 'keep').isDisabled(), 'one more may be kept')
    expect((await page.locator('#bookmark-trouble').textContent()).includes('16'), 'no reason')
    await axe(page, 'full')
  })
  await check(
    'another arena on the same connection is taken, and the connection stays',
    async () => {
      let opened = 0
      page.on('websocket', () => (opened += 1))
      const map = id(page, 'things').getByTestId('world-map')
      for (const scenario of ['search', 'empty', 'search']) {
        await tell(mock, { command: 'load', scenario, robots: 5 })
        const wanted = mock.world.arena.obstacles.length + mock.world.arena.objects.length
        await until(`${scenario} is not shown`, async () => {
          return (await map.getAttribute('data-things')) === String(wanted)
        })
      }
      expect(opened === 0, 'the page connected again')
      const known = await page.evaluate(() => globalThis.terracrawler.robots().length)
      expect(known === mock.world.robots.length, `${known} robots are known`)
    },
  )
  await check('in the live room the view fits itself to another world', async () => {
    await goTo(page, '')
    await id(page, 'zoom-in').click()
    await tell(mock, { command: 'load', scenario: 'corridor', robots: 5 })
    const width = mock.world.arena.width
    const arena = id(page, 'arena')
    const share = await until('the view does not fit', async () => {
      const [x, , scale] = (await arena.getAttribute('data-camera')).split(' ').map(Number)
      const taken = (scale * width) / (await arena.boundingBox()).width
      return Math.abs(x) < 0.1 && taken > 0.8 && taken <= 1 && taken
    })
    await until('the overview stays', async () => {
      return (await id(page, 'minimap').getAttribute('data-shown')) === 'false'
    })
    await goTo(page, 'simulation')
    return `${Math.round(100 * share)} % of its width`
  })
  await check('a server that refuses the list says so, and it can be tried again', async () => {
    await page.route('**/simulator/scenarios', (route) => route.fulfill({ status: 503, body: '' }))
    await page.reload()
    await id(page, 'scenarios').getByTestId('load-error').waitFor()
    await axe(page, 'no scenarios')
    await page.unroute('**/simulator/scenarios')
    await id(page, 'scenarios').getByRole('button').click()
    await settle(page)
  })
}

async function viewer(page, mock) {
  await check('a viewer sees everything, and why nothing can be changed', async () => {
    mock.accounts.addUser('vera', 'viewer', 'correct horse battery')
    mock.accounts.setOpen(false)
    await afresh(page, `${mock.url}/#/simulation`)
    await id(page, 'user').fill('vera')
    await id(page, 'password').fill('correct horse battery')
    await page.keyboard.press('Enter')
    await settle(page)
    const sent = []
    page.on('request', (request) => {
      if (request.method() === 'POST') sent.push(request.url())
    })
    const open = await page
      .locator('.simulation-page :is(button, input[type=range])')
      .evaluateAll((all) => all.filter((one) => !one.disabled).map((one) => one.outerHTML))
    expect(open.length === 0, `can be pressed: ${open[0]}`)
    const bare = await page.locator('.simulation-page button').evaluateAll((all) => {
      return all.filter((one) => one.title === '').map((one) => one.textContent.trim())
    })
    expect(bare.length === 0, `without a reason: ${bare.join(', ')}`)
    await id(page, 'things').getByTestId('world-map').focus()
    await page.keyboard.press('Enter')
    await id(page, 'things').getByTestId('world-map').click()
    expect(sent.filter((url) => url.includes('simulator')).length === 0, `sent ${sent[0]}`)
    await axe(page, 'viewer')
    await picture(page, 'simulation-viewer')
    // Looking at scenarios changes nothing.
    await page.locator('.scenario-card[data-scenario=corridor]').click()
    await until('it is not shown', async () => {
      return (await id(page, 'scenario-choice').getAttribute('data-name')) === 'corridor'
    })
  })
  mock.accounts.setOpen(true)
}
