// A fence around everything, put up and taken down in the page, against whichever server there is.

import { axe, check, expect, picture, until } from './checks.mjs'

export function fenced(page) {
  return check('a fence is put up, finds who is beyond it, and is taken down', async () => {
    const id = (name) => page.getByTestId(name)
    // One of a run that was broken off may still be there.
    const name = `end to end ${Date.now() % 100_000}`
    const row = page.locator(`[data-testid=fence][data-fence="${name}"]`)
    await id('fences').click()
    await id('fence-enter').click()
    await id('fence-name').fill(name)
    await id('fence-kind').selectOption('keep_out')
    await id('fence-corners').fill('-900, -900\n900, -900\n900, 900\n-900, 900')
    await id('fence-save').click()
    await row.waitFor()
    const beyond = await until('nobody is beyond it', async () => {
      return Number(await row.getAttribute('data-beyond'))
    })
    await until('the list of robots does not say so', async () => {
      return page.locator(`[data-testid=robot-row][data-fence="${name}"]`).count()
    })
    await axe(page, 'axe-core with a fence')
    await picture(page, 'fenced')
    await row.getByTestId('fence-remove').click()
    await id('confirm').click()
    await row.waitFor({ state: 'detached' })
    await until('robots are still beyond it', async () => {
      return (await page.locator(`[data-testid=robot-row][data-fence="${name}"]`).count()) === 0
    })
    await id('fence-close').click()
    expect((await id('fence-panel').count()) === 0, 'the list stays')
    return `${beyond} robots`
  })
}
