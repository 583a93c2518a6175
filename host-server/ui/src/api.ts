/** The calls that watching and steering robots take. */

import type { CommandRecord, CommandRequest, RobotBody, RobotsBody } from './api-types'
import { quickClient } from './client'
import type { RobotSummary } from './fleet/order'
import type { Readiness } from './fleet/health'
import type { Send } from './http'
import { ApiError, SLOW_MS, fields, numeric, payloadOf, request, text, told } from './http'

export { ApiError, problemText } from './http'

export interface Command {
  command: string
  parameters?: Record<string, number | string | boolean | readonly (readonly [number, number])[]>
}

/** As the interface describes it: pages hold what a person chose as names and values. */
export function asRequest(command: Command): CommandRequest {
  return command as CommandRequest
}

/** One thing that a robot saw. */
export interface Seen {
  kind: string
  /** From where it headed, in radians, positive to the left. */
  bearing: number
  /** Where in the picture, as shares of width and height; `null` where it is not told. */
  at: { x: number; y: number } | null
}

/** A share of decisions, and the interval in which the true one lies with 95 %. */
export interface Share {
  share: number
  low: number
  high: number
}

/** How a policy that does not drive compares with the one that does, on the same observations. */
export interface Shadow {
  policy: string
  decisions: number
  /** Both chose the same; `null` before there is a decision. */
  agreement: Share | null
  /** The shield would have taken something from what the candidate chose. */
  vetoes: Share | null
  /** The same of the policy that drives. */
  drivingVetoes: Share | null
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
  /** Duty of the wheels, −1 to 1. */
  wheels: { left: number; right: number } | null
  /** How sure it is of where it is, in metres. */
  sigma: number | null
  uptime: number | null
  /** Unix milliseconds. */
  lastSeen: number | null
  boot: { count: number; cause: string } | null
  protocol: number | null
  /** What names the program that it runs; `null` for robots before updates. */
  build: string | null
  /** The models that it has loaded, and what names their contents. */
  models: readonly (readonly [string, string])[]
  capabilities: readonly string[]
  /** What it compares; `null` while nobody has asked for that. */
  shadow: Shadow | null
  /** What the broker thinks of how much it sends; `null` when all is well. */
  link: string | null
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
  summaries(): Promise<Map<string, RobotSummary>>
  readiness(): Promise<Readiness>
  /** What the server says of itself, as OpenMetrics. */
  metrics(): Promise<string>
  /** The newest picture of a robot; `image` is when it arrived. */
  picture(id: string, image: number): Promise<Blob>
}

export function createApi(send: Send = (...args) => fetch(...args)): Api {
  const ask = quickClient(send)

  return {
    async commandRobot(id, command) {
      const body = asRequest(command)
      return commandId(await ask('post', '/robots/{id}/commands', { path: { id }, body }))
    },
    async commandSwarm(command) {
      return commandId(await ask('post', '/swarm/commands', { body: asRequest(command) }))
    },
    async outcome(id) {
      const body = told<CommandRecord>(await ask('get', '/commands/{id}', { path: { id } }))
      const counts = Object.entries(fields(body.counts)).map(
        ([name, count]) => [name, numeric(count) ?? 0] as const,
      )
      return {
        status: text(body.status),
        reason: text(body.reason),
        completed: counts.find(([name]) => name === 'completed')?.[1] ?? 0,
        expected: counts.reduce((sum, [, count]) => sum + count, 0),
      }
    },
    async robot(id) {
      return details(await ask('get', '/robots/{id}', { path: { id } }))
    },
    async summaries() {
      const list = told<RobotsBody>(await ask('get', '/robots')).robots
      const found = new Map<string, RobotSummary>()
      if (!Array.isArray(list)) return found
      for (const item of list.map((one) => told<RobotBody>(one))) {
        const id = text(item.id)
        if (id === null) continue
        found.set(id, {
          battery: numeric(fields(item.battery)['percent']),
          rssi: numeric(item.rssi_dbm),
          behaviour: text(item.behaviour),
          lastSeen: numeric(item.last_seen),
        })
      }
      return found
    },
    async readiness() {
      // Not ready is an answer too.
      const response = await bare(send, '/readyz')
      const body = fields(await response.json().catch(() => null))
      if (typeof body['broker'] !== 'boolean') throw new ApiError('an odd answer', response.status)
      const simulation = body['simulation']
      return {
        broker: body['broker'],
        simulation: typeof simulation === 'boolean' ? simulation : null,
        // Told of only when they fail.
        journal: body['journal'] !== false,
        audit: body['audit'] !== false,
      }
    },
    async metrics() {
      const response = await bare(send, '/metrics')
      if (!response.ok) await payloadOf(response)
      return response.text()
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

/** What lies outside the API. */
async function bare(send: Send, path: string): Promise<Response> {
  try {
    return await send(path, { cache: 'no-store', signal: AbortSignal.timeout(SLOW_MS) })
  } catch {
    throw new ApiError('the server cannot be reached', 0)
  }
}

function details(value: unknown): RobotDetails {
  const body = told<RobotBody>(value)
  const battery = fields(body.battery)
  const [left, right] = [
    numeric(fields(body.wheels)['left']),
    numeric(fields(body.wheels)['right']),
  ]
  const boot = fields(body.boot)
  const count = numeric(boot['count'])
  return {
    behaviour: text(body.behaviour),
    batteryPercent: numeric(battery['percent']),
    batteryMillivolts: numeric(battery['mv']),
    temperature: numeric(body.temperature_c),
    rssi: numeric(body.rssi_dbm),
    camera: Array.isArray(body.capabilities) && body.capabilities.includes('camera'),
    image: numeric(body.image),
    sees: seen(body.sees),
    wheels: left === null || right === null ? null : { left, right },
    sigma: numeric(fields(body.pose)['sigma']),
    uptime: numeric(body.uptime_ms),
    lastSeen: numeric(body.last_seen),
    boot: count === null ? null : { count, cause: text(boot['cause']) ?? '' },
    protocol: numeric(body.protocol),
    build: text(body.build),
    models: Object.entries(fields(body.models)).flatMap(([name, build]) =>
      typeof build === 'string' ? [[name, build] as const] : [],
    ),
    capabilities: Array.isArray(body.capabilities)
      ? body.capabilities.filter((name): name is string => typeof name === 'string')
      : [],
    shadow: shadow(body.shadow),
    link: text(body.link),
    duplicate: body.duplicate === true,
  }
}

function shadow(value: unknown): Shadow | null {
  const body = fields(value)
  const [policy, decisions] = [text(body['policy']), numeric(body['decisions'])]
  if (policy === null || decisions === null) return null
  return {
    policy,
    decisions,
    agreement: share(body['agreement']),
    vetoes: share(body['veto_share']),
    drivingVetoes: share(body['driving_veto_share']),
  }
}

function share(value: unknown): Share | null {
  const body = fields(value)
  const [mean, low, high] = ['share', 'low', 'high'].map((name) => numeric(body[name]))
  if (mean == null || low == null || high == null) return null
  return { share: mean, low, high }
}

function seen(value: unknown): Seen[] | null {
  const objects = fields(value)['objects']
  if (!Array.isArray(objects)) return null
  return objects.map(fields).flatMap((object) => {
    const [kind, bearing] = [text(object['class']), numeric(object['bearing'])]
    const [x, y] = [numeric(object['x']), numeric(object['y'])]
    const at = x === null || y === null ? null : { x, y }
    return kind === null || bearing === null ? [] : [{ kind, bearing, at }]
  })
}

function commandId(value: unknown): string | null {
  const id = fields(value)['id']
  return typeof id === 'number' ? String(id) : text(id)
}
