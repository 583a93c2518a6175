// Everything that the other checks do with a mouse, without one.

import { afresh, check, expect, until } from './checks.mjs'

const MOST_TABS = 80

const id = (page, name) => page.getByTestId(name)

/** Presses Tab until `there` holds for what has the focus. */
async function tabTo(page, what, there) {
  for (let i = 0; i < MOST_TABS; i++) {
    await page.keyboard.press('Tab')
    if (await page.evaluate(there)) return
  }
  throw new Error(`${what} cannot be reached`)
}

export async function byKeyboard(page, base, mock) {
  await check('by keyboard alone: skip the bar, go to the robots, open one', async () => {
    await afresh(page, `${base}/#/dashboard`)
    await id(page, 'verdict').waitFor()
    await page.evaluate(() => document.activeElement?.blur())
    await tabTo(page, 'the skip link', () => document.activeElement.dataset.testid === 'skip')
    await page.keyboard.press('Enter')
    expect(
      (await page.evaluate(() => document.activeElement.id)) === 'page-title',
      'nothing was skipped',
    )
    await page.evaluate(() => document.activeElement?.blur())
    await tabTo(page, 'the robots', () => document.activeElement.dataset.testid === 'go-robots')
    await page.keyboard.press('Enter')
    await page.locator('[data-testid=table-row]').first().waitFor()
    await tabTo(page, 'a row', () => document.activeElement.dataset.control === 'tick')
    for (let i = 0; i < 30; i++) await page.keyboard.press('ArrowDown')
    const row = await page.evaluate(() => document.activeElement.closest('[data-at]')?.dataset.at)
    expect(row === '30', `the focus is in row ${row}`)
    await page.keyboard.press('Enter')
    await until('it is not selected', async () => {
      return (await id(page, 'selected-count').textContent())?.startsWith('1')
    })
    await page.keyboard.press('Tab')
    await page.keyboard.press('Enter')
    await id(page, 'robot-page').waitFor()
    return id(page, 'robot-page').getAttribute('data-robot-id')
  })
  await check('by keyboard alone: command the selection, with a slide', async () => {
    await page.goto(`${base}/#/command?to=selection`)
    await tabTo(page, 'reboot', () => document.activeElement.dataset.testid === 'tell-reboot')
    await page.keyboard.press('Enter')
    await tabTo(page, 'the slide', () => document.activeElement.dataset.testid === 'send-track')
    const before = mock.commands.length
    await page.keyboard.press('End')
    expect(mock.commands.length === before, 'one key confirmed')
    await page.keyboard.press('Tab')
    await page.keyboard.press('Enter')
    await until('nothing was sent', () => mock.commands.length === before + 1)
    return mock.commands.at(-1).command
  })
  await check('by keyboard alone: Space stops on every page, and presses nothing', async () => {
    for (const place of ['dashboard', 'robots', 'command', 'simulation', 'robots/sim-0002']) {
      await page.goto(`${base}/#/${place}`)
      await page.locator('#page-title').waitFor()
      // Backwards, to a button: in a text field a space is text.
      await page.keyboard.press('Shift+Tab')
      await page.keyboard.press('Space')
      const panel = id(page, 'stop-panel')
      await until(`${place}: not stopped`, async () => {
        return (await panel.getAttribute('data-stop')) === 'stopped'
      })
      await tabTo(page, 're-arming', () => document.activeElement.dataset.testid === 'rearm')
      await page.keyboard.press('Enter')
      await until(`${place}: not re-armed`, async () => {
        return (await panel.getAttribute('data-stop')) === 'armed'
      })
    }
  })
}
