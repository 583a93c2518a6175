// `npm run mock`: a mock to develop the page against. ROBOTS and PORT set its size and address;
// CLOSED=1 gives it accounts.
import { startMock } from './server.mjs'

const mock = await startMock({
  robots: Number(process.env.ROBOTS ?? 50),
  port: Number(process.env.PORT ?? 8080),
  open: process.env.CLOSED !== '1',
})
console.log(`mock server at ${mock.url}`)
if (!mock.accounts.open) console.log(`first admin: ${mock.url}/#invite=${mock.accounts.firstCode}`)
