// `cargo xtask bench ui`: what the page costs the browser's main thread. Options:
//   --robots 1000,10000  sizes of the fleet      --rate 25     snapshots a second
//   --seconds 60         measured for each size  --memory 180  seconds for memory, largest fleet
//   --url URL            a running server to measure too (`terracrawler up --robots 1000`)
// Costs are processor time of the main thread, so that other work on the machine does not count.
// Drawing itself is left out (draw calls are dropped, uploads are not): here it would be done by
// the processor, on a user's machine it is the graphics card's.

import { fork } from 'node:child_process'
import { cpus, loadavg } from 'node:os'
import { fileURLToPath } from 'node:url'
import { parseArgs } from 'node:util'
import { gzipSync } from 'node:zlib'
import { launch } from '../e2e/browser.mjs'

const { values } = parseArgs({
  options: {
    robots: { type: 'string', default: '1000,10000' },
    rate: { type: 'string', default: '25' },
    seconds: { type: 'string', default: '60' },
    memory: { type: 'string', default: '180' },
    url: { type: 'string' },
  },
})
const sizes = values.robots.split(',').map(Number)
const [rate, seconds, memory] = [values.rate, values.seconds, values.memory].map(Number)
if (![...sizes, rate, seconds, memory].every((value) => Number.isFinite(value) && value > 0)) {
  console.error('robots, rate, seconds and memory are numbers above zero')
  process.exit(2)
}

const VIEW = { width: 1440, height: 900 }
const PRESSES = 200
const LOADS = 5
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms))
const table = []
const row = (what, goal, measured) => table.push(`| ${what} | ${goal} | ${measured} |`)

/** Runs in the page before anything else. */
function prepare() {
  const gl = WebGL2RenderingContext.prototype
  const parameter = gl.getParameter
  gl.getParameter = function (name) {
    // Otherwise the page spares a machine without a graphics card.
    const value = parameter.call(this, name)
    return typeof value === 'string' && /swiftshader/i.test(value) ? 'bench' : value
  }
  gl.drawArrays = () => undefined
  const bench = { long: [], pictures: 0, keys: [], usable: null }
  globalThis.bench = bench
  new PerformanceObserver((list) => {
    for (const { duration } of list.getEntries()) bench.long.push(duration)
  }).observe({ type: 'longtask', buffered: true })
  addEventListener(
    'keydown',
    (event) => bench.keys.push(performance.timeOrigin + event.timeStamp),
    {
      capture: true,
    },
  )
  const clear = gl.clear
  gl.clear = function (bits) {
    bench.pictures += 1
    clear.call(this, bits)
  }
  // Usable: rows are there, and the main thread has come to rest once after that.
  const watch = new MutationObserver(() => {
    if (document.querySelector('[data-testid=robot-row][data-x]') === null) return
    watch.disconnect()
    requestAnimationFrame(() => setTimeout(() => (bench.usable = performance.now()), 0))
  })
  watch.observe(document, { childList: true, subtree: true, attributes: true })
}

function serve(robots) {
  const script = fileURLToPath(new URL('live.mjs', import.meta.url))
  const child = fork(script, [JSON.stringify({ robots, rate })])
  const ask = () =>
    new Promise((resolve) => {
      child.once('message', resolve)
      child.send('report')
    })
  return new Promise((resolve) => {
    child.once('message', ({ url }) => resolve({ url, ask, close: () => child.disconnect() }))
  })
}

async function open(browser, url) {
  const context = await browser.newContext({ viewport: VIEW })
  await context.addInitScript(prepare)
  const page = await context.newPage()
  page.on('pageerror', (error) => console.error(`the page threw ${error.message}`))
  const bodies = []
  page.on('response', (response) => {
    if (!response.url().includes('/api/')) bodies.push(response.body().catch(() => null))
  })
  await page.goto(url)
  await page.waitForFunction(() => globalThis.bench.usable !== null, null, { timeout: 60_000 })
  return { context, page, bodies }
}

async function select(page) {
  await page.locator('[data-testid=robot-row]').nth(2).click()
  await pause(500)
}

/** Processor time of the main thread so far, in seconds by what it was for. */
async function costs(session) {
  const { metrics } = await session.send('Performance.getMetrics')
  return Object.fromEntries(metrics.map(({ name, value }) => [name, value]))
}

async function frames(page, robots, source) {
  const session = await page.context().newCDPSession(page)
  await session.send('Performance.enable', { timeDomain: 'threadTicks' })
  await pause(3_000)
  const look = () =>
    page.evaluate(() => ({
      long: globalThis.bench.long.length,
      pictures: globalThis.bench.pictures,
    }))
  const [before, seen] = [await costs(session), await look()]
  await pause(seconds * 1_000)
  const [after, then] = [await costs(session), await look()]
  const pictures = then.pictures - seen.pictures
  const per = (name) => ((after[name] - before[name]) / pictures) * 1_000
  const goal = robots > 1_000 ? '4 ms' : '2 ms'
  const parts = `script ${per('ScriptDuration').toFixed(2)}, layout and style ${(per('LayoutDuration') + per('RecalcStyleDuration')).toFixed(2)}`
  row(
    `main thread for a picture, ${robots} robots, ${source}`,
    goal,
    `${per('TaskDuration').toFixed(2)} ms (${parts}); ${(pictures / seconds).toFixed(0)} pictures/s`,
  )
  const minutes = seconds / 60
  row(
    `tasks above 50 ms by the clock, ${robots} robots, ${source}`,
    '0 a minute',
    `${((then.long - seen.long) / minutes).toFixed(1)} a minute`,
  )
  await tasks(page.context().browser(), robots, source)
}

/** Longest task of the page's main thread, and how many took above 50 ms, by processor time. */
async function tasks(browser, robots, source) {
  const session = await browser.newBrowserCDPSession()
  const events = []
  session.on('Tracing.dataCollected', ({ value }) => events.push(...value))
  await session.send('Tracing.start', { traceConfig: { includedCategories: ['toplevel'] } })
  await pause(seconds * 1_000)
  const complete = new Promise((resolve) => session.once('Tracing.tracingComplete', resolve))
  await session.send('Tracing.end')
  await complete
  await session.detach()
  const mains = new Set(
    events
      .filter(({ name, args }) => name === 'thread_name' && args.name === 'CrRendererMain')
      .map(({ pid, tid }) => `${pid} ${tid}`),
  )
  const costs = events
    .filter(({ ph, pid, tid }) => ph === 'X' && mains.has(`${pid} ${tid}`))
    .map(({ tdur }) => (tdur ?? 0) / 1_000)
  const longest = costs.reduce((most, cost) => Math.max(most, cost), 0)
  const long = costs.filter((cost) => cost > 50).length
  row(
    `tasks above 50 ms of processor time, ${robots} robots, ${source}`,
    '0 a minute',
    `${((long * 60) / seconds).toFixed(1)} a minute; the longest took ${longest.toFixed(1)} ms`,
  )
}

async function keys(page, server, robots) {
  await page.getByTestId('drive-pad').focus()
  await server.ask()
  await page.evaluate(() => globalThis.bench.keys.splice(0))
  for (let i = 0; i < PRESSES; i++) {
    await page.keyboard.down('ArrowUp')
    await pause(30)
    await page.keyboard.up('ArrowUp')
    await pause(40 + (i % 7) * 3)
  }
  await pause(300)
  const pressed = await page.evaluate(() => globalThis.bench.keys)
  const drives = (await server.ask()).received.filter(({ command }) => command === 'drive')
  // The first `drive` after each press; a press whose drive is missing would be a failure.
  const delays = pressed.map((at) => (drives.find((drive) => drive.at >= at)?.at ?? Infinity) - at)
  delays.sort((a, b) => a - b)
  const share = (part) => delays[Math.min(delays.length - 1, Math.floor(part * delays.length))]
  row(
    `key press to its command at the server, ${robots} robots, ${pressed.length} presses`,
    'p99 20 ms',
    `p50 ${share(0.5).toFixed(1)} ms, p99 ${share(0.99).toFixed(1)} ms, longest ${share(1).toFixed(1)} ms`,
  )
}

async function remember(page, robots) {
  const session = await page.context().newCDPSession(page)
  const used = async () => {
    await session.send('HeapProfiler.collectGarbage')
    const { usedSize } = await session.send('Runtime.getHeapUsage')
    return usedSize / 2 ** 20
  }
  const start = await used()
  const half = (memory * 1_000) / 2
  await pause(half)
  const middle = await used()
  await pause(half)
  const end = await used()
  row(
    `heap after ${memory} s, ${robots} robots (at the start, half-way, at the end)`,
    'no growth',
    `${start.toFixed(1)}, ${middle.toFixed(1)}, ${end.toFixed(1)} MiB`,
  )
}

async function load(browser, url, robots) {
  const times = []
  let bytes = 0
  for (let i = 0; i < LOADS; i++) {
    const { context, page, bodies } = await open(browser, url)
    times.push(await page.evaluate(() => globalThis.bench.usable))
    const found = (await Promise.all(bodies)).filter((body) => body !== null)
    bytes = found.reduce((sum, body) => sum + gzipSync(body, { level: 9 }).length, 0)
    await context.close()
  }
  times.sort((a, b) => a - b)
  row('first view, all files, gzip', '150 kB', `${(bytes / 1_000).toFixed(1)} kB`)
  row(
    `usable after, ${robots} robots, loopback, empty cache, median of ${LOADS}`,
    '1 s',
    `${(times[LOADS >> 1] / 1_000).toFixed(2)} s (longest ${(times.at(-1) / 1_000).toFixed(2)} s)`,
  )
}

const browser = await launch()
for (const robots of sizes) {
  const server = await serve(robots)
  if (robots === sizes[0]) await load(browser, server.url, robots)
  const { context, page } = await open(browser, server.url)
  await select(page)
  await frames(page, robots, `${rate} snapshots/s`)
  if (robots === sizes[0]) await keys(page, server, robots)
  const { sent } = await server.ask()
  row(
    `bytes for a robot in a snapshot, ${robots} robots`,
    '10',
    (sent.bytes / sent.frames / robots).toFixed(2),
  )
  if (robots === sizes.at(-1)) await remember(page, robots)
  await context.close()
  server.close()
}
if (values.url !== undefined) {
  const { context, page } = await open(browser, values.url)
  const robots = await page.evaluate(() => globalThis.terracrawler.robots().length)
  await select(page)
  await frames(page, robots, 'a real server')
  await context.close()
}
console.log(
  `Chromium ${browser.version()}, ${VIEW.width} × ${VIEW.height}; ${cpus().length} cores (${cpus()[0]?.model}), load ${loadavg()[0].toFixed(1)}\n`,
)
console.log(['| what | goal | measured |', '|---|---:|---:|', ...table].join('\n'))
await browser.close()
process.exit(0)
