/** Where a time line is marked: at round times of the local clock, also where that is put forward or back. */

const SECOND = 1_000
const MINUTE = 60 * SECOND
const HOUR = 60 * MINUTE
const DAY = 24 * HOUR

/** Distances between marks, each a round part of the next larger unit. */
const STEPS = [
  ...[1, 2, 5, 10, 15, 30].map((count) => count * SECOND),
  ...[1, 2, 5, 10, 15, 30].map((count) => count * MINUTE),
  ...[1, 2, 3, 6, 12].map((count) => count * HOUR),
  ...[1, 2, 7, 14, 28, 56, 112, 182, 364].map((count) => count * DAY),
]

interface Tick {
  /** Unix milliseconds. */
  at: number
  label: string
  /** The date, at the first mark and where it changes. */
  day: string | null
}

/** Marks between two times, at most so many. */
export function ticks(from: number, to: number, most: number): Tick[] {
  const step = STEPS.find((one) => (to - from) / one <= most) ?? (STEPS.at(-1) as number)
  const found = step >= DAY ? days(from, to, step / DAY) : hours(from, to, step)
  let before: Date | null = null
  return found.map((at) => {
    const now = new Date(at)
    const another = before !== null && before.getTimezoneOffset() !== now.getTimezoneOffset()
    const fresh = before === null || before.toDateString() !== now.toDateString()
    before = now
    return {
      at,
      label: step >= DAY ? dayOf(now) : clock(now, step < MINUTE, another),
      day: fresh && step < DAY ? dayOf(now) : null,
    }
  })
}

/** Every so many days, at their local beginning, which is not always at midnight. */
function days(from: number, to: number, every: number): number[] {
  const found: number[] = []
  const day = new Date(from)
  day.setHours(0, 0, 0, 0)
  // Days are counted from one that all windows share, so that marks stay when the window moves.
  const number = Math.round(Date.UTC(day.getFullYear(), day.getMonth(), day.getDate()) / DAY)
  day.setDate(day.getDate() - (number % every))
  for (; day.getTime() <= to; day.setDate(day.getDate() + every)) {
    if (day.getTime() >= from) found.push(day.getTime())
  }
  return found
}

/** Every so much of a day. An hour that comes twice is marked twice only where hours are all marked. */
function hours(from: number, to: number, step: number): number[] {
  const found: number[] = []
  const unit = Math.min(step, HOUR)
  const taken = new Set<string>()
  for (let at = aligned(from, unit); at <= to; at = aligned(at + 1, unit)) {
    const local = new Date(at)
    if (step > HOUR) {
      const name = `${local.toDateString()} ${String(local.getHours())}`
      if (local.getHours() % (step / HOUR) !== 0 || taken.has(name)) continue
      taken.add(name)
    }
    found.push(at)
  }
  return found
}

/** The first time from `at` on at which the local clock shows a multiple of `unit`. */
function aligned(at: number, unit: number): number {
  const offset = new Date(at).getTimezoneOffset() * MINUTE
  const found = Math.ceil((at - offset) / unit) * unit + offset
  const there = new Date(found).getTimezoneOffset() * MINUTE
  // The clock was changed on the way there.
  return there === offset ? found : Math.ceil((found - there) / unit) * unit + there
}

function clock(at: Date, seconds: boolean, zone: boolean): string {
  return at.toLocaleTimeString('en-GB', {
    hour: '2-digit',
    minute: '2-digit',
    ...(seconds ? { second: '2-digit' } : {}),
    ...(zone ? { timeZoneName: 'short' } : {}),
  })
}

function dayOf(at: Date): string {
  return at.toLocaleDateString('en-GB', { day: 'numeric', month: 'short', year: 'numeric' })
}

/** How far an arrow key goes on a time line: about a hundredth of it, and a round time. */
export function arrowStep(length: number): number {
  return STEPS.find((one) => one >= length / 150) ?? DAY
}
