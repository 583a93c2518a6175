// What the browser runs share: one line per check, waiting, accessibility.

import { readFile } from 'node:fs/promises'
import { createRequire } from 'node:module'
import { join } from 'node:path'
import { DESKTOP } from './browser.mjs'

let passed = 0
let failed = 0

export async function check(name, act) {
  try {
    const detail = await act()
    passed += 1
    console.log(`ok    ${name}${typeof detail === 'string' ? ` (${detail})` : ''}`)
  } catch (error) {
    fail(`${name}: ${String(error.message).split('\n')[0]}`)
  }
}

export function fail(words) {
  failed += 1
  console.log(`FAIL  ${words}`)
}

export function expect(condition, reason) {
  if (!condition) throw new Error(reason)
}

/** Polls until `probe` gives something truthy; the last value names the failure. */
export async function until(reason, milliseconds, probe) {
  const end = performance.now() + milliseconds
  for (;;) {
    const value = await probe()
    if (value) return value
    if (performance.now() > end) throw new Error(`${reason} within ${milliseconds} ms`)
    await pause(50)
  }
}

export function pause(milliseconds) {
  return new Promise((resolve) => setTimeout(resolve, milliseconds))
}

/** For `addInitScript`, so that `axe` finds it. */
export function axeSource() {
  return readFile(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8')
}

/** A page that waits for so long, knows `axe`, and fails the run when it throws. */
export async function openPage(browser, patience, options = {}) {
  const context = await browser.newContext({ viewport: DESKTOP, ...options })
  await context.addInitScript(await axeSource())
  const page = await context.newPage()
  page.setDefaultTimeout(patience)
  page.on('pageerror', (error) => fail(`the page threw ${error.message}`))
  return page
}

export async function axe(page, name) {
  const violations = await page.evaluate(async () => {
    const result = await globalThis.axe.run(document, { resultTypes: ['violations'] })
    return result.violations.map(({ id, nodes }) => `${id} at ${nodes[0]?.target.join(' ')}`)
  })
  expect(violations.length === 0, `${name}: ${violations.join('; ')}`)
  return name
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

/** Ends everything after so long, whatever hangs. */
export function endBy(milliseconds) {
  return setTimeout(() => {
    fail(`not finished within ${milliseconds / 1_000} s`)
    finish()
  }, milliseconds)
}
