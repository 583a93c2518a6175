// Fences of the mock: kept, and held against the places of its robots.

import { Refusal } from './accounts.mjs'

const MARGIN = 0.1
const MOST = 64
const KINDS = ['keep_in', 'keep_out']
const ACTIONS = ['warn', 'stop']

export function createFences({ world, clock, crossed }) {
  const fences = []
  let made = 0

  function check({ name, kind, action, corners }, id) {
    const invalid = (why) => new Refusal(422, 'invalid_fence', why)
    if (typeof name !== 'string' || name.trim() === '' || name.length > 32) {
      throw invalid('`name` must have 1 to 32 characters')
    }
    if (!KINDS.includes(kind) || !ACTIONS.includes(action)) throw invalid('no such kind or action')
    if (!Array.isArray(corners) || corners.length < 3 || corners.length > 32) {
      throw invalid('a fence has 3 to 32 corners')
    }
    if (fences.some((fence) => fence.name === name && fence.id !== id)) {
      throw new Refusal(409, 'exists', 'there is a fence of that name already')
    }
    return { name, kind, action, corners }
  }

  /** Status and body of an answer; `null` for what is about something else. */
  function answer(method, parts, body, by) {
    if (parts[0] !== 'fences') return null
    if (method === 'GET') return { status: 200, body: { fences } }
    if (method === 'POST') {
      if (fences.length >= MOST) throw new Refusal(409, 'too_many', 'there are 64 fences already')
      made += 1
      const fence = { id: `f${made}`, ...check(body, null), by, made_at: clock() }
      fences.push(fence)
      return { status: 201, body: fence }
    }
    const at = fences.findIndex(({ id }) => id === parts[1])
    if (at < 0) throw new Refusal(404, 'unknown_fence', 'there is no such fence')
    if (method === 'DELETE') {
      const [{ name }] = fences.splice(at, 1)
      for (const robot of world.robots) if (robot.fence === name) set(robot, null)
      return { status: 204 }
    }
    Object.assign(fences[at], check(body, parts[1]))
    return { status: 200, body: fences[at] }
  }

  function set(robot, fence) {
    const before = robot.fence ?? null
    if (before === fence) return
    robot.fence = fence
    crossed(robot, fences.find(({ name }) => name === (fence ?? before)) ?? null, fence === null)
  }

  /** Looks where everybody is. */
  function watch() {
    if (fences.length === 0) return
    for (const robot of world.robots) {
      const beyond = fences.find((fence) => violated(fence, robot, robot.fence === fence.name))
      set(robot, beyond?.name ?? null)
    }
  }

  return { answer, watch, fences }
}

function violated({ kind, corners }, { x, y }, was) {
  const inside = holds(corners, x, y)
  if ((kind === 'keep_in') !== inside) return true
  return was && toEdge(corners, x, y) < MARGIN
}

function edges(corners) {
  return corners.map((corner, at) => [corner, corners[(at + 1) % corners.length]])
}

function holds(corners, x, y) {
  let inside = false
  for (const [[ax, ay], [bx, by]] of edges(corners)) {
    if (ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax)) inside = !inside
  }
  return inside
}

function toEdge(corners, x, y) {
  const far = edges(corners).map(([[ax, ay], [bx, by]]) => {
    const [dx, dy] = [bx - ax, by - ay]
    const share = Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)))
    return Math.hypot(x - ax - share * dx, y - ay - share * dy)
  })
  return Math.min(...far)
}
