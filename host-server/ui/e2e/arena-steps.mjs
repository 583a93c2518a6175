// What the rounds in the arena share: a page on the mock, where things are, who stands where.

import { startMock } from '../tests/mock/server.mjs'
import { PHONE, launch } from './browser.mjs'
import { afresh, openPage, until } from './checks.mjs'

export const mock = await startMock({ robots: 24, seed: 5 })
export const browser = await launch()
export const id = (page, name) => page.getByTestId(name)
export const soon = until

/** One for a desk, one for a hand: each is made once, and shows every round the room afresh. */
const OPTIONS = {
  desk: {},
  phone: {
    viewport: PHONE,
    hasTouch: true,
    isMobile: true,
    deviceScaleFactor: 2,
    colorScheme: 'dark',
    reducedMotion: 'reduce',
  },
}
const pages = {}

/** The page at an address, as whoever comes first finds it. */
export async function openAt(address, kind = 'desk') {
  pages[kind] ??= await openPage(browser, OPTIONS[kind])
  const page = pages[kind]
  await afresh(page, address)
  return page
}

export async function open(kind) {
  const page = await openAt(mock.url, kind)
  await page.locator('[data-testid=robot-row][data-x]').first().waitFor()
  await soon('no picture', async () => Number(await arena(page, 'drawn')) > 0)
  return page
}

export const arena = (page, name) => id(page, 'arena').getAttribute(`data-${name}`)

export async function camera(page) {
  const [x, y, scale] = (await arena(page, 'camera')).split(' ').map(Number)
  return { x, y, scale }
}

/** Where a point of the world is on the page. */
export async function onPage(page, x, y) {
  const [view, box] = [await camera(page), await id(page, 'arena').boundingBox()]
  return [
    box.x + box.width / 2 + (x - view.x) * view.scale,
    box.y + box.height / 2 - (y - view.y) * view.scale,
  ]
}

export const stand = () => {
  for (const robot of mock.world.robots) mock.world.obey(robot, { command: 'stop' }, Date.now())
}

/** All robots stand, and the page shows them where they do. */
export async function standing(page) {
  stand()
  let last = ''
  await until(
    'robots are shown elsewhere',
    async () => {
      const shown = await page.evaluate(() => globalThis.terracrawler.robots())
      const places = new Map(shown.map(({ id, x, y }) => [id, { x, y }]))
      const off = mock.world.robots.find(({ id, x, y }) => {
        const place = places.get(id)
        return place === undefined || Math.hypot(place.x - x, place.y - y) > 0.01
      })
      last = JSON.stringify([off?.id, off?.x, off?.y, places.get(off?.id)])
      return off === undefined
    },
    () => last,
  )
}

/** The view has come to where it was going. */
export async function settled(page) {
  let before = ''
  await until('the view goes on moving', async () => {
    const now = await arena(page, 'camera')
    const same = now === before
    before = now
    return same
  })
}

export const sent = (command) => mock.commands.filter((entry) => entry.command === command)
export const selected = (page) => id(page, 'robot-panel').getAttribute('data-robot-id')
export const online = () => mock.world.robots.filter(({ presence }) => presence === 'online')

/** A robot that stands apart from others, so that a click means it alone. */
export function apart() {
  const far = (robot) =>
    Math.min(
      ...mock.world.robots
        .filter((other) => other !== robot)
        .map((other) => Math.hypot(other.x - robot.x, other.y - robot.y)),
    )
  return online().sort((a, b) => far(b) - far(a))[0]
}

export async function lasso(page, middle, radius) {
  const points = Array.from({ length: 16 }, (_, i) => {
    const angle = (i / 16) * 2 * Math.PI
    return [middle[0] + radius * Math.cos(angle), middle[1] + radius * Math.sin(angle)]
  })
  await page.mouse.move(...points[0])
  await page.mouse.down()
  for (const point of points.slice(1)) await page.mouse.move(...point)
  await page.mouse.up()
}

export const goals = async (page) => {
  const element = id(page, 'goals')
  return (await element.count()) === 0 ? [] : JSON.parse(await element.getAttribute('data-goals'))
}
