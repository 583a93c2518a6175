// What the browser runs share: one line per check, waiting, accessibility.

import { readFile } from 'node:fs/promises'
import { createRequire } from 'node:module'
import { join } from 'node:path'
import { DESKTOP } from './browser.mjs'
import { processorTime } from './processor.mjs'

/** For whatever has to happen: machines that run tests are busy. Nothing here judges how fast it was. */
export const PATIENCE_MS = 180_000
/** A round ends by then, whatever hangs. */
const DEADLINE_MS = 1_200_000

/** `TIMES=1` says of each check how long it took, and what of the processor since the one before. */
const TIMES = process.env.TIMES !== undefined

let passed = 0
let failed = 0

export async function check(name, act) {
  const began = performance.now()
  try {
    const detail = await act()
    passed += 1
    const took = TIMES ? cost(performance.now() - began) : ''
    console.log(`ok    ${name}${typeof detail === 'string' ? ` (${detail})` : ''}${took}`)
  } catch (error) {
    fail(`${name}: ${String(error.message).split('\n')[0]}`)
  }
}

function cost(milliseconds) {
  return ` [${Math.round(milliseconds)} ms, processor ${processorTime().toFixed(2)} s]`
}

export function fail(words) {
  failed += 1
  console.log(`FAIL  ${words}`)
}

export function expect(condition, reason) {
  if (!condition) throw new Error(reason)
}

/** Polls until `probe` gives something truthy; `seen` is asked for what to say when it does not. */
export async function until(reason, probe, seen = () => '') {
  const found = await within(PATIENCE_MS, probe)
  if (found) return found
  const last = String(await seen())
  throw new Error(`${reason}, for ${PATIENCE_MS / 1_000} s${last === '' ? '' : `; seen: ${last}`}`)
}

/** The same for what takes long: patience begins anew whenever `progress` gives something else. */
export async function untilOver(reason, probe, progress) {
  for (let seen = await progress(); ;) {
    let now = seen
    const moved = async () => (await probe()) || (now = await progress()) !== seen
    if (!(await within(PATIENCE_MS, moved)))
      throw new Error(`${reason}, for ${PATIENCE_MS / 1_000} s; seen: ${seen}`)
    if (now === seen) return
    seen = now
  }
}

/** `until` for so long, for what may never be: something else is tried then. */
export async function within(milliseconds, probe) {
  const end = performance.now() + milliseconds
  for (;;) {
    const value = await probe()
    if (value || performance.now() > end) return value
    await pause(50)
  }
}

/** Until the page has drawn so many pictures: it has looked at what is held or plugged in by then. */
export function frames(page, count = 2) {
  return page.evaluate(
    (left) =>
      new Promise((resolve) => {
        const next = () => (left-- > 0 ? requestAnimationFrame(next) : resolve())
        next()
      }),
    count,
  )
}

/** Until a request of the page has come back: whatever it sent before has left it by then. */
export function exchanged(page) {
  return page.evaluate(() => fetch('/readyz', { cache: 'no-store' }).then(() => undefined))
}

export function pause(milliseconds) {
  return new Promise((resolve) => setTimeout(resolve, milliseconds))
}

/** A page that is patient, and fails the run when it throws. */
export async function openPage(browser, options = {}) {
  const context = await browser.newContext({ viewport: DESKTOP, ...options })
  const page = await context.newPage()
  page.setDefaultTimeout(PATIENCE_MS)
  page.on('pageerror', (error) => fail(`the page threw ${error.message}`))
  return page
}

/** The page of whoever comes there first: it knows nothing of before. */
export async function afresh(page, address) {
  if (page.url() !== 'about:blank') {
    await page.evaluate(() => {
      localStorage.clear()
      sessionStorage.clear()
    })
    await page.goto('about:blank')
  }
  await page.goto(address)
}

/** What does not hold in one colour scheme may in another; all other rules are about the page. */
const OF_COLOURS = ['color-contrast', 'link-in-text-block']

/** Looks for violations of accessibility, by these rules alone or by all. */
export async function axe(page, name, rules = null) {
  if (!(await page.evaluate(() => 'axe' in globalThis))) await page.evaluate(await axeSource())
  const violations = await page.evaluate(async (values) => {
    const only = values === null ? {} : { runOnly: { type: 'rule', values } }
    const result = await globalThis.axe.run(document, { resultTypes: ['violations'], ...only })
    return result.violations.map(({ id, nodes }) => `${id} at ${nodes[0]?.target.join(' ')}`)
  }, rules)
  expect(violations.length === 0, `${name}: ${violations.join('; ')}`)
  return name
}

/** Looks at the colours of a page that has been looked at in light, and leaves it in light. */
export async function axeDark(page, name, then = () => undefined) {
  await page.emulateMedia({ colorScheme: 'dark' })
  try {
    await frames(page)
    await axe(page, `${name}, dark`, OF_COLOURS)
    await then()
  } finally {
    await page.emulateMedia({ colorScheme: 'light' })
  }
  return name
}

function axeSource() {
  return readFile(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8')
}

/** Side of what a finger can press, pixels. */
const TOUCH = 44

/** On a phone: nothing is cut off, every target is large, nothing violates accessibility. */
export async function measure(page, name) {
  const { width } = page.viewportSize()
  const wide = await page.evaluate(() => document.documentElement.scrollWidth)
  expect(wide <= width, `${name} is ${wide} pixels wide`)
  const small = await page.evaluate((least) => {
    return [...document.querySelectorAll('button, select, input, a[href], summary')]
      .map((element) => {
        // What belongs to a tick box is its label: a finger may press anywhere on it.
        const target = element.type === 'checkbox' ? element.closest('label') : element
        return { element, box: target.getBoundingClientRect() }
      })
      .filter(({ box }) => box.width > 1 && box.height > 1)
      .filter(({ element }) => !element.disabled && element.closest('[inert]') === null)
      .filter(({ box }) => box.height < least - 2 || box.width < least - 2)
      .map(({ element, box }) => {
        const words = element.dataset.testid ?? element.textContent.trim()
        return `${words} ${Math.round(box.width)}×${Math.round(box.height)}`
      })
  }, TOUCH)
  expect(small.length === 0, `${name}: too small: ${small.join(', ')}`)
  await axe(page, name)
}

/** Keeps a picture where SCREENSHOTS names a folder. */
export async function picture(page, name) {
  const directory = process.env.SCREENSHOTS
  if (directory !== undefined) await page.screenshot({ path: join(directory, `${name}.png`) })
}

/** Prints the sum and ends the process with it. */
export function finish() {
  console.log(`${passed} passed, ${failed} failed`)
  process.exit(failed === 0 && passed > 0 ? 0 : 1)
}

/** Ends everything at last, whatever hangs. */
export function guarded() {
  return setTimeout(() => {
    fail(`not finished within ${DEADLINE_MS / 1_000} s`)
    finish()
  }, DEADLINE_MS)
}
