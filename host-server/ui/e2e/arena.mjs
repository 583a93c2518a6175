// `npm run e2e:arena`: the arena and driving, by mouse, finger, keyboard and gamepad, against the
// mock, which can be cut off. Prints one line per check; exits non-zero when anything failed.

import { byFinger, byGamepad, byKeyboard } from './arena-hands.mjs'
import { byMouse, byThousands, cutOff } from './arena-mouse.mjs'
import { browser, mock } from './arena-steps.mjs'
import { fail, finish, guarded } from './checks.mjs'
import { byFences } from './fences.mjs'
import { byMaps } from './maps.mjs'
import { byTwins } from './twins.mjs'

const ALL = [
  byMouse,
  byKeyboard,
  byGamepad,
  cutOff,
  byFinger,
  byThousands,
  byFences,
  byMaps,
  byTwins,
]
/** `ROUND=byFences` takes this alone. */
const ROUNDS = ALL.filter(({ name }) => [undefined, name].includes(process.env.ROUND))

const guard = guarded()
try {
  for (const round of ROUNDS) await round()
  await browser.close()
} catch (error) {
  fail(`the browser: ${String(error.message).split('\n')[0]}`)
}
await mock.close()
clearTimeout(guard)
finish()
