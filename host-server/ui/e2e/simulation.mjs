// `npm run e2e:simulation`: an operator loads a scenario, puts things into it, keeps a bookmark and
// goes back to it, by mouse and by keyboard, against the server at BASE_URL; without one every state
// and size is looked at, with the mock.

import { startMock } from '../tests/mock/server.mjs'
import { launch } from './browser.mjs'
import { axe, check, expect, fail, finish, guarded, openPage } from './checks.mjs'
import { picture, until, within } from './checks.mjs'
import { looks } from './simulation-looks.mjs'

/** A robot that has been driven away is at least this far, metres. */
const AWAY = 0.35
/** For a robot to get there before another way is tried. */
const OTHER_WAY_MS = 12_000
/** Back at its place: it may believe to be a little beside it. */
const BACK = 0.12
const ROBOTS = 4

const mock = process.env.BASE_URL === undefined ? await startMock({ robots: 24, seed: 3 }) : null
const base = mock?.url ?? process.env.BASE_URL
const id = (page, name) => page.getByTestId(name)
const soon = until
const data = (locator, name) => locator.getAttribute(`data-${name}`)
const robots = (page) => page.evaluate(() => globalThis.terracrawler.robots())
const focused = (page) => page.evaluate(() => document.activeElement?.dataset?.testid ?? '')

const newPage = openPage

async function goTo(page, place) {
  await page.goto(`${base}/#/${place}`)
  await soon('the feed is not live', async () => {
    const lamp = id(page, 'connection')
    return (await lamp.count()) > 0 && (await data(lamp, 'connection')) === 'live'
  })
  if (place.startsWith('simulation')) await id(page, 'scenario-choice').waitFor()
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

/** Presses Tab until that has the focus. */
async function tabTo(page, name) {
  for (let i = 0; i < 60; i++) {
    await page.keyboard.press('Tab')
    if ((await focused(page)) === name) return
  }
  throw new Error(`${name} cannot be reached`)
}

/** What slides, without a hand that can drag. */
async function confirmByKeys(page, name) {
  await tabTo(page, `${name}-track`)
  await page.keyboard.press('End')
  await page.keyboard.press('Tab')
  expect((await focused(page)) === `${name}-confirm`, 'the button is not next')
  await page.keyboard.press('Enter')
}

const map = (page) => id(page, 'things').getByTestId('world-map')
const dropped = async (page) => {
  const list = id(page, 'dropped')
  return (await list.count()) === 0 ? 0 : Number(await data(list, 'count'))
}
/** What stands in the arena, as the live feed tells. */
const standing = async (page) => Number(await data(map(page), 'things'))
/** The command has been answered: the list and the feed may show what it did before that. */
const answered = (page, words) =>
  soon(`${words} is not said`, async () => {
    return (await id(page, 'things-said').textContent()).includes(words)
  })

/** A place in the middle of the arena that robots are far from. */
async function freePlace(page, besides = []) {
  const taken = [...(await robots(page)), ...besides]
  let best = { x: 0, y: 0, room: -1 }
  for (let x = -2; x <= 2; x += 0.5) {
    for (let y = -2; y <= 2; y += 0.5) {
      const room = Math.min(...taken.map((one) => Math.hypot(one.x - x, one.y - y)))
      if (room > best.room) best = { x, y, room }
    }
  }
  return best
}

/** Where a point of the world is on the page. */
async function onMap(page, { x, y }) {
  const element = map(page)
  await element.scrollIntoViewIfNeeded()
  return element.evaluate(
    (svg, at) => {
      const point = new DOMPoint(at.x, -at.y).matrixTransform(svg.getScreenCTM())
      return [point.x, point.y]
    },
    { x, y },
  )
}

/** Robots of the world that runs, once they have all come. */
async function present(page) {
  return soon('the robots did not come', async () => {
    const online = (await robots(page)).filter(({ presence }) => presence === 'online')
    return online.length === ROBOTS && online.every(({ state }) => state === 'IDLE') && online
  })
}

async function scenario(page) {
  await check('scenarios are drawn before they are loaded', async () => {
    await goTo(page, 'simulation')
    const cards = page.locator('.scenario-card')
    await soon('not all are drawn', async () => {
      const drawn = await page.locator('.scenario-card[data-drawn=true]').count()
      return drawn > 3 && drawn === (await cards.count())
    })
    await picture(page, 'simulation')
    return `${await cards.count()} of them`
  })
  await check('one is looked at with other robots and another seed, and loaded', async () => {
    await page.locator('.scenario-card[data-scenario=empty]').click()
    const choice = id(page, 'scenario-choice')
    await soon('it is not shown', async () => (await data(choice, 'name')) === 'empty')
    expect(page.url().includes('scenario=empty'), 'it is not in the address')
    await id(page, 'scenario-robots').fill(String(ROBOTS))
    await id(page, 'scenario-seed').fill('7')
    await soon('the preview is another', async () => {
      return (
        (await data(choice, 'robots')) === String(ROBOTS) && (await data(choice, 'seed')) === '7'
      )
    })
    await slide(page, 'load')
    await soon('it is not loaded', async () => {
      return (await id(page, 'scenarios-said').textContent()).includes('empty is loaded')
    })
    expect((await id(page, 'world-scenario').textContent()) === 'empty', 'another world runs')
    await soon('the arena is another', async () => (await standing(page)) === 0)
    await present(page)
  })
}

async function things(page) {
  await check('a box is dropped by a click, and stands in the arena', async () => {
    await goTo(page, 'simulation')
    await id(page, 'thing-kind').selectOption('wall')
    const place = await freePlace(page)
    await page.mouse.move(...(await onMap(page, place)))
    await map(page).locator('.ghost').waitFor({ state: 'attached' })
    await page.mouse.click(...(await onMap(page, place)))
    await soon('nothing is listed', async () => (await dropped(page)) === 1)
    await soon('the arena does not show it', async () => (await standing(page)) === 1)
    await answered(page, 'Put into the world: box')
    await page.mouse.move(5, 5)
    await goTo(page, '')
    await page.locator('[data-testid=arena]').waitFor()
    await picture(page, 'simulation-arena')
    return id(page, 'arena').getAttribute('data-camera')
  })
  await check('what does not fit is refused in words, and drawn as refused', async () => {
    await goTo(page, 'simulation')
    const before = await standing(page)
    await id(page, 'thing-x').fill('80')
    await id(page, 'thing-y').fill('0')
    await id(page, 'put').click()
    const why = page.locator('#things-trouble')
    await why.waitFor()
    await map(page).locator('.ghost.refused').waitFor({ state: 'attached' })
    expect((await standing(page)) === before, 'it was put there all the same')
    await axe(page, 'a refusal')
    return (await why.textContent()).trim()
  })
  await check('by keyboard alone: a red ball is put in, and the box taken away', async () => {
    await goTo(page, 'simulation')
    const box = await data(page.locator('[data-item]').first(), 'item')
    await id(page, 'thing-kind').focus()
    // Typing chooses: the name of what is wanted.
    await page.keyboard.type('Ball')
    await tabTo(page, 'thing-x')
    const place = await freePlace(page, [await freePlace(page)])
    await page.keyboard.type(String(place.x))
    await tabTo(page, 'thing-y')
    await page.keyboard.type(String(place.y))
    await map(page).focus()
    await page.keyboard.press('ArrowRight')
    await page.keyboard.press('ArrowLeft')
    await page.keyboard.press('Enter')
    await soon('it is not put in', async () => (await dropped(page)) === 2)
    await soon('the arena does not show it', async () => (await standing(page)) === 2)
    await answered(page, 'Put into the world: red ball')
    await page.locator(`[data-item="${box}"] button`).focus()
    await page.keyboard.press('Enter')
    await soon('it is not taken away', async () => (await standing(page)) === 1)
    await answered(page, 'Taken away: box')
    await soon('the focus is lost', () =>
      page.evaluate((gone) => {
        const item = document.activeElement.closest('[data-item]')
        return item !== null && item.dataset.item !== gone
      }, box),
    )
    return page.locator('[data-item] span').first().textContent()
  })
}

/** Drives the selected robot until it is somewhere else. */
async function driveAway(page, robot) {
  const start = (await robots(page)).find((one) => one.id === robot)
  for (const key of ['ArrowUp', 'ArrowDown', 'ArrowUp']) {
    await id(page, 'drive-pad').focus()
    await page.keyboard.down(key)
    const far = await within(OTHER_WAY_MS, async () => {
      const now = (await robots(page)).find((one) => one.id === robot)
      return Math.hypot(now.x - start.x, now.y - start.y) > AWAY
    })
    await page.keyboard.up(key)
    if (far) return
  }
  throw new Error(`${robot} cannot be driven away`)
}

async function back(page, robot, place) {
  return soon(`${robot} is not back at its place`, async () => {
    const now = (await robots(page)).find((one) => one.id === robot)
    const metres = Math.hypot(now.x - place.x, now.y - place.y)
    return now.presence === 'online' && now.state === 'IDLE' && metres < BACK && metres.toFixed(3)
  })
}

async function bookmarks(page) {
  let place
  const away = async () => {
    await goTo(page, `?robot=${place.id}`)
    await soon('it is not selected', async () => {
      return (await data(id(page, 'robot-panel'), 'robot-id')) === place.id
    })
    await driveAway(page, place.id)
  }
  await check('this moment is kept under a good name, and under no other', async () => {
    place = (await present(page)).sort((a, b) => Math.hypot(a.x, a.y) - Math.hypot(b.x, b.y))[0]
    await goTo(page, 'simulation')
    await id(page, 'bookmark-name').fill('Not good')
    await page.keyboard.press('Enter')
    expect((await page.locator('#bookmark-trouble').textContent()).trim() !== '', 'no reason')
    expect((await page.locator('tr[data-bookmark]').count()) === 0, 'a bad name was taken')
    await axe(page, 'a bad name')
    await id(page, 'bookmark-name').fill('before')
    await page.keyboard.press('Enter')
    await page.locator('tr[data-bookmark=before]').waitFor()
    return (await page.locator('tr[data-bookmark=before]').innerText()).replace(/\s+/g, ' ')
  })
  await check('a robot is driven away, and is back at its place after going back', async () => {
    await away()
    await goTo(page, 'simulation')
    // What was put in since then goes, what was there then comes back.
    await page.locator('[data-item] button').first().click()
    await soon('it is not taken away', async () => (await standing(page)) === 0)
    await answered(page, 'Taken away: red ball')
    await page.locator('tr[data-bookmark=before]').getByTestId('restore').click()
    await axe(page, 'going back')
    await picture(page, 'simulation-going-back')
    await slide(page, 'go-back')
    await soon('the thing is not back', async () => (await standing(page)) === 1)
    const metres = await back(page, place.id, place)
    await present(page)
    return `${place.id}, ${metres} m beside it`
  })
  await check('by keyboard alone: the same, and the bookmark is forgotten', async () => {
    await away()
    await goTo(page, 'simulation')
    await id(page, 'bookmark-name').focus()
    await tabTo(page, 'restore')
    await page.keyboard.press('Enter')
    await confirmByKeys(page, 'go-back')
    const metres = await back(page, place.id, place)
    await soon('the focus is lost', async () => (await focused(page)) === 'restore')
    await page.keyboard.press('Tab')
    await page.keyboard.press('Enter')
    await soon('nothing is asked', async () => (await focused(page)) === 'cancel')
    await page.keyboard.press('Shift+Tab')
    await page.keyboard.press('Enter')
    await page.locator('tr[data-bookmark=before]').waitFor({ state: 'detached' })
    return `${metres} m beside it`
  })
  await check('by keyboard alone: another scenario is chosen and loaded', async () => {
    await goTo(page, 'simulation?scenario=corridor')
    const choice = id(page, 'scenario-choice')
    await soon('it is not shown', async () => (await data(choice, 'name')) === 'corridor')
    await page.locator('.scenario-card input:checked').focus()
    await page.keyboard.press('ArrowDown')
    await soon('another is not shown', async () => (await data(choice, 'name')) !== 'corridor')
    await page.keyboard.press('ArrowUp')
    await soon(
      'the first is not shown again',
      async () => (await data(choice, 'name')) === 'corridor',
    )
    await confirmByKeys(page, 'load')
    await soon('it is not loaded', async () => {
      return (await id(page, 'world-scenario').textContent()) === 'corridor'
    })
    await soon('its walls are not shown', async () => (await standing(page)) === 2)
    expect((await dropped(page)) === 0, 'what was put in is still listed')
  })
}

const guard = guarded()
try {
  const browser = await launch()
  const page = await newPage(browser)
  if (mock === null) for (const part of [scenario, things, bookmarks]) await part(page)
  else await looks({ browser, page, mock, newPage, goTo })
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
clearTimeout(guard)
await mock?.close()
finish()
