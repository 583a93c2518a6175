// `npm run screenshots -- DIR`: pictures of the pages at BASE_URL, desktop, phone and
// wall display, light and dark, to look at. LOGIN=name:password logs in and adds the
// pages for accounts, keys and the audit log. ONLY=desktop-light takes these alone.

import { mkdir } from 'node:fs/promises'
import { join } from 'node:path'
import { DESKTOP, PHONE, WALL, launch } from './browser.mjs'

const directory = process.argv[2]
const base = process.env.BASE_URL
const [user, password = ''] = process.env.LOGIN?.split(':') ?? []
if (directory === undefined || base === undefined) {
  console.error('usage: BASE_URL=http://… npm run screenshots -- DIR')
  process.exit(2)
}
await mkdir(directory, { recursive: true })
const browser = await launch()
for (const [size, viewport] of Object.entries({ desktop: DESKTOP, phone: PHONE, wall: WALL })) {
  for (const colorScheme of ['light', 'dark']) {
    if (!`${size}-${colorScheme}`.startsWith(process.env.ONLY ?? '')) continue
    const context = await browser.newContext({
      viewport,
      colorScheme,
      deviceScaleFactor: size === 'phone' ? 2 : 1,
      hasTouch: size === 'phone',
    })
    const page = await context.newPage()
    page.on('console', (message) => console.log(`${size}: ${message.text()}`))
    page.on('pageerror', (error) => console.log(`${size}: ${error.message}`))
    const shot = (name) =>
      page.screenshot({ path: join(directory, `${size}-${colorScheme}-${name}.png`) })
    await page.goto(base)
    if (user !== undefined) {
      await page.getByTestId('login').waitFor()
      await shot('login')
      await page.getByTestId('user').fill(user)
      await page.getByTestId('password').fill(password)
      await page.keyboard.press('Enter')
    }
    await page.locator('[data-testid=robot-row][data-x]').first().waitFor({ timeout: 15_000 })
    await page.waitForTimeout(1_500)
    await shot('overview')
    await page.locator('[data-testid=robot-row][data-presence=online]').nth(2).click()
    await page.waitForTimeout(1_200)
    await shot('selected')
    await page.keyboard.press('?')
    await page.waitForTimeout(200)
    await shot('help')
    await page.keyboard.press('Escape')
    await page.keyboard.press('Space')
    await page.waitForTimeout(1_500)
    await shot('stopped')
    await page.getByTestId('rearm').click()
    await page.waitForTimeout(300)
    await page.getByTestId('wander-all').click()
    const robot = await page.evaluate(() => globalThis.terracrawler.robots()[4].id)
    const places = {
      dashboard: 'dashboard',
      table: 'robots?as=table&sort=state',
      cards: 'robots?as=cards',
      robot: `robots/${robot}?range=1m`,
      parameters: `robots/${robot}?tab=parameters`,
      log: `robots/${robot}?tab=log`,
      command: 'command',
      simulation: 'simulation',
    }
    for (const [name, place] of Object.entries(places)) {
      await page.goto(`${base}/#/${place}`)
      await page.locator('#page-title').waitFor()
      await page.waitForTimeout(1_800)
      if (name === 'command') await page.getByTestId('tell-gather').click()
      await page.waitForTimeout(600)
      await shot(name)
    }
    for (const name of user === undefined ? [] : ['account', 'people', 'keys', 'audit']) {
      await page.goto(`${base}/#/${name}`)
      await page.locator(`[data-page=${name}]`).waitFor()
      await page.waitForTimeout(600)
      await shot(name)
    }
    await context.close()
  }
}
await browser.close()
