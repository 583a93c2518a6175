// `npm run e2e:mock`: the same end-to-end run against the mock server, for work
// on the page alone.

import { spawn } from 'node:child_process'
import { fileURLToPath } from 'node:url'
import { startMock } from '../tests/mock/server.mjs'

const mock = await startMock({ robots: Number(process.env.ROBOTS ?? 50) })
const run = spawn(process.execPath, [fileURLToPath(new URL('run.mjs', import.meta.url))], {
  stdio: 'inherit',
  env: { ...process.env, BASE_URL: mock.url },
})
run.on('exit', async (code) => {
  await mock.close()
  process.exit(code ?? 1)
})
