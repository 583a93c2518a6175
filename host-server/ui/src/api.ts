/** The calls that watching and steering robots take. */

import type { Send } from './http'
import { call as callWith, fields, numeric, payloadOf, request, text } from './http'

export { ApiError, problemText } from './http'

export interface Command {
  command: string
  parameters?: Record<string, number | string | boolean>
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

export interface Api {
  commandRobot(id: string, command: Command): Promise<string | null>
  commandSwarm(command: Command): Promise<string | null>
  outcome(commandId: string): Promise<Outcome>
  robot(id: string): Promise<RobotDetails>
  batteries(): Promise<Map<string, number>>
  /** The newest picture of a robot; `image` is when it arrived. */
  picture(id: string, image: number): Promise<Blob>
}

export function createApi(send: Send = (...args) => fetch(...args)): Api {
  const call = (method: string, path: string, body?: unknown) => callWith(send, method, path, body)

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
    async picture(id, image) {
      const response = await request(send, 'GET', picturePath(id, image))
      if (!response.ok) await payloadOf(response)
      return response.blob()
    },
  }
}

/** Where the newest picture of a robot is; another address for each picture. */
export function picturePath(id: string, image: number): string {
  return `/robots/${encodeURIComponent(id)}/image?received=${String(image)}`
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
