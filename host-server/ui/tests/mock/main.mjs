// `npm run mock`: a mock to develop the page against. ROBOTS and PORT set its size and address.
import { startMock } from './server.mjs'

const mock = await startMock({
  robots: Number(process.env.ROBOTS ?? 50),
  port: Number(process.env.PORT ?? 8080),
})
console.log(`mock server at ${mock.url}`)
