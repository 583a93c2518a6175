/** Calls of the HTTP interface, and errors as the server words them. */

export interface Command {
  command: string
  parameters?: Record<string, number | string | boolean>
}

/** What went wrong, in words that can be shown. */
export class ApiError extends Error {
  constructor(
    message: string,
    /** HTTP status; 0 when the server was not reached. */
    readonly status: number,
  ) {
    super(message)
  }
}

/** One thing that a robot saw. */
export interface Seen {
  kind: string
  /** From where it headed, in radians, positive to the left. */
  bearing: number
}

/** Details of one robot that the live feed does not carry. */
export interface RobotDetails {
  behaviour: string | null
  batteryPercent: number | null
  batteryMillivolts: number | null
  temperature: number | null
  rssi: number | null
  /** It can take pictures. */
  camera: boolean
  /** When its newest picture arrived, in Unix milliseconds. */
  image: number | null
  /** What it saw last; `null` when it has no eyes or told of nothing yet. */
  sees: Seen[] | null
  /** Two robots seem to use this id. */
  duplicate: boolean
}

/** Where a command stands: the least finished, then the worst, of its outcomes. */
export interface Outcome {
  /** `pending` and `accepted` are not final. */
  status: string | null
  reason: string | null
  /** Robots that have done it, and robots it went to. */
  completed: number
  expected: number
}

const TIMEOUT_MS = 2_000
const BASE = '/api/v1'

export interface Api {
  commandRobot(id: string, command: Command): Promise<string | null>
  commandSwarm(command: Command): Promise<string | null>
  outcome(commandId: string): Promise<Outcome>
  robot(id: string): Promise<RobotDetails>
  batteries(): Promise<Map<string, number>>
}

export function createApi(send: typeof fetch = (...args) => fetch(...args)): Api {
  async function call(method: string, path: string, body?: unknown): Promise<unknown> {
    let response: Response
    try {
      response = await send(BASE + path, {
        method,
        headers: body === undefined ? {} : { 'content-type': 'application/json' },
        ...(body === undefined ? {} : { body: JSON.stringify(body) }),
        // A stop sent while the page goes away must still leave the machine.
        keepalive: method === 'POST',
        cache: 'no-store',
        signal: AbortSignal.timeout(TIMEOUT_MS),
      })
    } catch (error) {
      const late = error instanceof DOMException && error.name === 'TimeoutError'
      throw new ApiError(
        late ? 'the server did not answer in time' : 'the server cannot be reached',
        0,
      )
    }
    const payload: unknown = await response.json().catch(() => null)
    if (!response.ok) throw new ApiError(problemText(payload, response.status), response.status)
    return payload
  }

  return {
    async commandRobot(id, command) {
      return commandId(await call('POST', `/robots/${encodeURIComponent(id)}/commands`, command))
    },
    async commandSwarm(command) {
      return commandId(await call('POST', '/swarm/commands', command))
    },
    async outcome(id) {
      const body = fields(await call('GET', `/commands/${encodeURIComponent(id)}`))
      const counts = Object.entries(fields(body['counts'])).map(
        ([name, count]) => [name, numeric(count) ?? 0] as const,
      )
      return {
        status: text(body['status']),
        reason: text(body['reason']),
        completed: counts.find(([name]) => name === 'completed')?.[1] ?? 0,
        expected: counts.reduce((sum, [, count]) => sum + count, 0),
      }
    },
    async robot(id) {
      return details(await call('GET', `/robots/${encodeURIComponent(id)}`))
    },
    async batteries() {
      const body = fields(await call('GET', '/robots'))
      const list = body['robots']
      const found = new Map<string, number>()
      if (!Array.isArray(list)) return found
      for (const item of list) {
        const id = text(fields(item)['id'])
        const percent = details(item).batteryPercent
        if (id !== null && percent !== null) found.set(id, percent)
      }
      return found
    },
  }
}

/** Address of the newest picture of a robot; another one for each picture. */
export function imageAddress(id: string, image: number): string {
  return `${BASE}/robots/${encodeURIComponent(id)}/image?received=${String(image)}`
}

/** Words of an RFC 9457 problem document, or the bare status without one. */
export function problemText(payload: unknown, status: number): string {
  const body = fields(payload)
  const words = [text(body['title']), text(body['detail'])].filter((part) => part !== null)
  return words.length > 0 ? words.join(': ') : `the server answered ${String(status)}`
}

function details(value: unknown): RobotDetails {
  const body = fields(value)
  const battery = fields(body['battery'])
  return {
    behaviour: text(body['behaviour']),
    batteryPercent: numeric(battery['percent']),
    batteryMillivolts: numeric(battery['mv']),
    temperature: numeric(body['temperature_c']),
    rssi: numeric(body['rssi_dbm']),
    camera: Array.isArray(body['capabilities']) && body['capabilities'].includes('camera'),
    image: numeric(body['image']),
    sees: seen(body['sees']),
    duplicate: body['duplicate'] === true,
  }
}

function seen(value: unknown): Seen[] | null {
  const objects = fields(value)['objects']
  if (!Array.isArray(objects)) return null
  return objects.map(fields).flatMap((object) => {
    const [kind, bearing] = [text(object['class']), numeric(object['bearing'])]
    return kind === null || bearing === null ? [] : [{ kind, bearing }]
  })
}

function commandId(value: unknown): string | null {
  const id = fields(value)['id']
  return typeof id === 'number' ? String(id) : text(id)
}

function fields(value: unknown): Record<string, unknown> {
  return typeof value === 'object' && value !== null ? (value as Record<string, unknown>) : {}
}

function text(value: unknown): string | null {
  return typeof value === 'string' && value !== '' ? value : null
}

function numeric(value: unknown): number | null {
  return typeof value === 'number' && Number.isFinite(value) ? value : null
}
