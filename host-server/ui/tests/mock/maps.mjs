// Maps of the mock: a robot on its way has one, with a wall between it and its goal.

import { Refusal } from './accounts.mjs'

const COLUMNS = 96
const ROWS = 80
const CELL = 0.1
/** How far ahead a plan is told. */
const POINTS = 16

export function createMaps({ find, clock }) {
  /** Robots that were asked, in turn. */
  const asked = []

  function cells() {
    return Array.from({ length: ROWS }, (_, row) => {
      const line = '.'.repeat(COLUMNS).split('')
      // A wall with a gap, and what was looked through beside it.
      if (row > 20 && row < 60 && (row < 36 || row > 42)) line.fill('#', 50, 52)
      if (row > 30 && row < 34) line.fill('o', 44, 47)
      return line.join('')
    })
  }

  function map(id) {
    const robot = find(id)
    asked.push(id)
    if (robot.presence === 'offline') throw new Refusal(409, 'robot_offline', 'it is offline')
    const { goal } = robot
    if (goal == null) throw new Refusal(404, 'no_map', `robot \`${id}\` has no map`)
    const [dx, dy] = [goal.x - robot.x, goal.y - robot.y]
    const way = Array.from({ length: POINTS }, (_, at) => {
      const share = (at + 1) / POINTS
      return [robot.x + share * dx, robot.y + share * dy]
    })
    return {
      timestamp: clock(),
      resolution: CELL,
      origin: [robot.x - (COLUMNS / 2) * CELL, robot.y - (ROWS / 2) * CELL],
      columns: COLUMNS,
      rows: cells(),
      goal: [goal.x, goal.y],
      next: way[2],
      way,
    }
  }

  return {
    asked,
    /** Status and body of an answer; `null` for what is about something else. */
    answer(method, parts) {
      const about = method === 'GET' && parts[0] === 'robots' && parts[2] === 'map'
      return about ? { status: 200, body: map(parts[1]) } : null
    },
  }
}
