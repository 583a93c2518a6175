// What this process and all below it took of the processor: what a browser costs the machine is
// the same however busy it is. From /proc, so on Linux only.

import { readFileSync, readdirSync } from 'node:fs'

/** Clock ticks a second, as `getconf CLK_TCK` says everywhere. */
const TICKS = 100

/** Seconds so far, by process; those that ended between two calls are not told of. */
function seconds() {
  const all = new Map()
  for (const id of readdirSync('/proc').filter((name) => /^\d+$/.test(name))) {
    try {
      // The name, which comes first, may contain blanks and brackets.
      const fields = readFileSync(`/proc/${id}/stat`, 'utf8').split(') ').at(-1).split(' ')
      const [parent, user, system] = [1, 11, 12].map((at) => Number(fields[at]))
      all.set(Number(id), { parent, seconds: (user + system) / TICKS })
    } catch {
      // It ended meanwhile.
    }
  }
  const mine = new Map()
  const take = (id) => {
    mine.set(id, all.get(id)?.seconds ?? 0)
    for (const [child, { parent }] of all) if (parent === id) take(child)
  }
  take(process.pid)
  return mine
}

let before = new Map()

/** Seconds of all of them since the last call. */
export function processorTime() {
  const now = seconds()
  let sum = 0
  for (const [id, time] of now) sum += time - (before.get(id) ?? 0)
  before = now
  return sum
}
