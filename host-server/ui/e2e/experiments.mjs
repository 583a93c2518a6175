// `npm run e2e:experiments`: experiments made, watched, compared, in a real browser, against the open
// server at BASE_URL; without one every state and size is looked at, with the mock.

import { startMock } from '../tests/mock/server.mjs'
import { launch } from './browser.mjs'
import { axe, check, expect, fail, finish, guarded } from './checks.mjs'
import { openPage, picture, until, untilOver } from './checks.mjs'
import { everyLook, troubles, viewers } from './experiments-looks.mjs'

const mock = process.env.BASE_URL === undefined ? await startMock({ robots: 12, open: true }) : null
const base = mock?.url ?? process.env.BASE_URL
const id = (page, name) => page.getByTestId(name)
const data = (locator, name) => locator.getAttribute(`data-${name}`)

const newPage = openPage

async function goTo(page, place) {
  await page.goto(`${base}/#/${place}`)
  await until('the feed is not live', async () => {
    const lamp = id(page, 'connection')
    return (await lamp.count()) > 0 && (await lamp.getAttribute('data-connection')) === 'live'
  })
  await page.locator('#page-title').waitFor()
}

/** The page of an experiment, once it is shown; gives its id. */
async function opened(page) {
  await id(page, 'experiment').waitFor()
  await page.locator('#experiment-title').waitFor()
  return decodeURIComponent(new URL(page.url()).hash.split('/')[2].split('?')[0])
}

const is = (page, state) => async () => (await data(id(page, 'experiment'), 'state')) === state
const made = []
const trained = []

async function first(page) {
  await check('nobody has one yet, and the page says what one is', async () => {
    await goTo(page, 'experiments')
    await id(page, 'experiments-empty').waitFor()
    await picture(page, 'experiments-empty')
    return axe(page, 'empty')
  })
  await check('one press runs one with the usual values', async () => {
    await goTo(page, 'experiments')
    await id(page, 'run-experiment').click()
    made.push(await opened(page))
    const title = await page.locator('#experiment-title').textContent()
    expect(title.includes('20 trials'), `it is called ${title}`)
    return title
  })
  await check('it is watched until it is done', async () => {
    await page.locator('[data-curve=success] canvas').waitFor()
    await until('it does not end', is(page, 'completed'))
    expect((await data(id(page, 'experiment'), 'done')) === '20', 'trials are missing')
    await until('not all are loaded', async () => {
      return (await data(id(page, 'experiment'), 'loaded')) === '20'
    })
    const words = await page.locator('[data-curve=success] figcaption').textContent()
    expect(words.includes('after 20 trials'), `the words are ${words}`)
    const rows = await page.locator('[data-testid=summary] tbody tr').count()
    expect(rows >= 3, `${rows} metrics are summed up`)
    const verdict = await data(id(page, 'experiment-verdict'), 'gravity')
    expect(verdict === 'good' || verdict === 'bad', `the verdict is ${verdict}`)
    await axe(page, 'completed')
    return words.trim()
  })
  await check('other curves are chosen, and stand in the address', async () => {
    await id(page, 'curve-choice').click()
    await id(page, 'curve-distance_m').click()
    await page.locator('[data-curve=distance_m] canvas').waitFor()
    await id(page, 'curve-success').click()
    expect((await page.locator('[data-curve=success]').count()) === 0, 'it is still drawn')
    await id(page, 'curves-over').selectOption('10')
    const query = page.url().split('?')[1]
    expect(query.includes('distance_m') && query.includes('over=10'), `the address has ${query}`)
    await page.reload()
    await page.locator('[data-curve=distance_m] canvas').waitFor()
  })
}

async function another(page) {
  await check('what is wrong stands at its field, and the first one has the focus', async () => {
    await goTo(page, 'experiments')
    await id(page, 'experiment-seeds').fill('none')
    await id(page, 'more-choices').click()
    await id(page, 'experiment-thresholds').fill('success')
    await id(page, 'run-experiment').click()
    await page.locator('#experiment-thresholds-error').waitFor()
    const focused = await page.evaluate(() => document.activeElement?.id)
    expect(focused === 'experiment-seeds', `${focused} has the focus`)
    await axe(page, 'wrong')
    await picture(page, 'experiments-wrong')
    await id(page, 'experiment-seeds').fill('5')
    await id(page, 'experiment-thresholds').fill('success>=0.1')
  })
  await check('what only the server can know, it says at the field, too', async () => {
    await id(page, 'experiment-set').fill('no_such_key=1')
    await id(page, 'run-experiment').click()
    const words = page.locator('#experiment-set-error')
    await words.waitFor()
    const focused = await page.evaluate(() => document.activeElement?.id)
    expect(focused === 'experiment-set', `${focused} has the focus`)
    return (await words.textContent()).trim()
  })
  await check('one is made without being started, started, and removed', async () => {
    await id(page, 'experiment-set').fill('')
    await id(page, 'experiment-name').fill('By and by')
    await id(page, 'experiment-start').uncheck()
    await id(page, 'run-experiment').click()
    await opened(page)
    expect(await is(page, 'created')(), 'it has begun')
    await axe(page, 'created')
    await id(page, 'experiment-start').click()
    await until('it does not end', is(page, 'completed'))
    await id(page, 'experiment-remove').click()
    await page.getByTestId('confirm').waitFor()
    await axe(page, 'a question')
    await page.getByTestId('confirm').click()
    await id(page, 'experiments-table').waitFor()
    expect(
      (await page.locator('tr', { hasText: 'By and by' }).count()) === 0,
      'it is still in the list',
    )
  })
  await check('one is done again with changes, paused, resumed and stopped', async () => {
    await goTo(page, `experiments/${encodeURIComponent(made[0])}`)
    await id(page, 'experiment-duplicate').click()
    await until('the form is not filled in', async () => {
      const name = id(page, 'experiment-name')
      return (await name.count()) > 0 && (await name.inputValue()).includes('20 trials')
    })
    await id(page, 'experiment-name').fill('Many of them')
    // Enough for the fastest machine not to be done before it is told to pause.
    await id(page, 'experiment-seeds').fill('100000')
    await id(page, 'run-experiment').click()
    made.push(await opened(page))
    await id(page, 'experiment-pause').click()
    await until('it does not pause', is(page, 'paused'))
    await axe(page, 'paused')
    await id(page, 'experiment-resume').click()
    await until('it does not go on', is(page, 'running'))
    const before = Number(await data(id(page, 'experiment'), 'done'))
    await until('nothing is done', async () => {
      return Number(await data(id(page, 'experiment'), 'done')) > Math.max(2, before)
    })
    await axe(page, 'running')
    await id(page, 'experiment-stop').click()
    await page.getByTestId('confirm').click()
    await until('it does not stop', is(page, 'stopped'))
    return `${await data(id(page, 'experiment'), 'done')} trials`
  })
  await check('the same is run again by one press', async () => {
    await goTo(page, `experiments/${encodeURIComponent(made[0])}`)
    await id(page, 'experiment-again').click()
    await until('it is the same page', async () => {
      return !page.url().endsWith(`/${encodeURIComponent(made[0])}`)
    })
    made.push(await opened(page))
    await until('it does not end', is(page, 'completed'))
  })
}

/** A training takes as long as the machine is slow: what counts is that its rounds go on. */
function learnt(page) {
  return untilOver('it does not go on', is(page, 'completed'), () =>
    id(page, 'training-live').evaluateAll(([one]) => `round ${one?.dataset.round}`),
  )
}

async function learned(page) {
  await check('a policy is trained, watched, paused, and judged', async () => {
    await goTo(page, 'experiments')
    await id(page, 'training-steps').fill('60000')
    await id(page, 'more-of-training').click()
    await id(page, 'training-name').fill('Learns')
    await id(page, 'training-worlds').fill('8')
    await id(page, 'training-units').fill('8')
    await id(page, 'run-training').click()
    const one = await opened(page)
    await page.locator('[data-curve=success] canvas').waitFor()
    await until('it does not learn', async () => {
      return Number(await data(id(page, 'training-live'), 'round')) > 2
    })
    await id(page, 'experiment-pause').click()
    await until('it does not pause', is(page, 'paused'))
    await axe(page, 'a training that stands')
    await id(page, 'experiment-resume').click()
    await learnt(page)
    await id(page, 'training-score').waitFor()
    await until('not all is drawn', async () => {
      return (await data(page.locator('[data-curve=entropy]'), 'loaded')) === '20'
    })
    const coming = page.waitForEvent('download')
    await id(page, 'file-policy.tcpo').click()
    expect((await coming).suggestedFilename() === 'policy.tcpo', 'it has another name')
    const command = await id(page, 'sign-command').inputValue()
    expect(command.includes('--kind policy --name learns '), `it is ${command}`)
    await axe(page, 'a training that is over')
    await picture(page, 'training')
    trained.push(one)
    return (await id(page, 'training-score').textContent()).trim()
  })
  await check('it is trained once more, and both are compared', async () => {
    await id(page, 'experiment-again').click()
    await until('it is the same page', async () => !page.url().endsWith(`/${trained[0]}`))
    trained.push(await opened(page))
    await learnt(page)
    await goTo(page, `experiments?compare=${trained.join(',')}`)
    await id(page, 'runs-together').waitFor()
    await page.locator('[data-curve=reward] canvas').waitFor()
    const row = page.locator('[data-testid=compare-table] tr[data-metric=success] td')
    expect((await data(row.nth(1), 'standing')) === 'same', 'the same run is not the same')
    await axe(page, 'compared trainings')
    return (await id(page, 'runs-together').textContent()).trim()
  })
}

async function several(page) {
  await check('the list is searched and filtered, and the address says how', async () => {
    await goTo(page, 'experiments')
    await page.locator(`[data-experiment="${made[1]}"]`).waitFor()
    await id(page, 'experiments-show').selectOption('stopped')
    const rows = page.locator('[data-testid=experiments-table] tbody tr')
    await until('others are shown', async () => (await rows.count()) === 1)
    await id(page, 'experiments-search').fill('no such thing')
    await id(page, 'experiments-unmatched').waitFor()
    await axe(page, 'nothing matches')
    expect(page.url().includes('state=stopped'), 'the filter is not in the address')
    await id(page, 'experiments-unmatched').getByRole('button').click()
    await until('not all are shown', async () => (await rows.count()) >= 3)
  })
  await check('three are chosen and compared', async () => {
    for (const one of made) await id(page, `pick-${one}`).click()
    await id(page, 'compare').click()
    await page.locator('[data-curve=success] canvas').waitFor()
    const words = await page.locator('[data-curve=success] figcaption').textContent()
    expect(/A: .*B: .*C: /.test(words), `the words are ${words}`)
    const row = page.locator('[data-testid=compare-table] tr[data-metric=success] td')
    expect((await row.count()) === 3, 'there are not three columns')
    // The first and the third have the same seeds: whoever runs them again gets the same.
    expect((await data(row.nth(2), 'standing')) === 'same', 'the same is not the same')
    const told = await page.locator('[data-testid=compare-table]').textContent()
    expect(told.includes('intervals overlap'), 'it does not say whether intervals overlap')
    await page.locator('[data-testid=differing] [data-setting=seeds]').waitFor()
    await axe(page, 'compared')
    await picture(page, 'experiments-compared')
    expect(page.url().includes('compare='), 'the choice is not in the address')
  })
  await check('going back keeps the choice', async () => {
    await page.goBack()
    await id(page, 'picked-count').waitFor()
    expect((await id(page, 'picked-count').textContent()).startsWith('3'), 'the choice is lost')
  })
}

async function byKeys(page) {
  await check('all of it works by keyboard', async () => {
    await goTo(page, 'experiments')
    await id(page, 'experiment-scenario').focus()
    await page.keyboard.press('Tab')
    await page.keyboard.press('Control+a')
    await page.keyboard.type('3')
    await page.keyboard.press('Enter')
    const one = await opened(page)
    await until('the title has not the focus', () =>
      page.evaluate(() => document.activeElement?.id === 'experiment-title'),
    )
    await until('it does not end', is(page, 'completed'))
    await goTo(page, 'experiments')
    await id(page, `pick-${one}`).focus()
    await page.keyboard.press('Enter')
    await id(page, 'picked-count').waitFor()
  })
}

const guard = guarded()
try {
  const browser = await launch()
  const page = await newPage(browser)
  if (mock === null) for (const part of [first, another, several, learned, byKeys]) await part(page)
  else {
    const hands = { browser, page, mock, newPage, goTo }
    await everyLook(hands)
    await troubles(hands)
    await viewers(page)
  }
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
clearTimeout(guard)
await mock?.close()
finish()
