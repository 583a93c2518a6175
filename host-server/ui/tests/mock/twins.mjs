// Twins of the mock: robots in simulation have one, a little beside where they say they are; one of them is weak.

import { Refusal } from './accounts.mjs'

export function createTwins({ find, clock }) {
  /** Robots whose forecasts were asked for, in turn. */
  const asked = []
  /** Robots that a motor of is weak. */
  const weak = new Set()

  const pose = (x, y, theta, sigma) => ({ x, y, theta, sigma, sigma_theta: 0.02 })

  function followed(id) {
    const robot = find(id)
    if (robot.presence !== 'offline') return robot
    throw new Refusal(404, 'no_twin', `robot \`${id}\` has no twin now`)
  }

  function forecast(id) {
    asked.push(id)
    const { x, y, heading } = followed(id)
    const ahead = (metres) => [x + metres * Math.cos(heading), y + metres * Math.sin(heading)]
    return {
      robot: id,
      time: clock(),
      pose: pose(x + 0.03, y, heading, 0.012),
      forecasts: [
        { ahead_s: 1, pose: pose(...ahead(0.3), heading, 0.03) },
        { ahead_s: 10, pose: pose(...ahead(3), heading, 0.2) },
      ],
      errors: [
        { ahead_s: 1, count: 120, median: 0.005, p90: 0.012 },
        { ahead_s: 10, count: 110, median: 0.06, p90: 0.2 },
      ],
    }
  }

  function twin(id) {
    const { x, y, heading } = followed(id)
    const fault = {
      fault: 'left_weak',
      meaning: 'the left motor makes less of its duty than it did',
      since: clock() - 60_000,
      amount: 0.12,
    }
    return {
      robot: id,
      time: clock(),
      age_ms: 120,
      certificate: '0123456789abcdef',
      pose: pose(x, y, heading, 0.012),
      v: 0.3,
      w: 0,
      gains: { left: 1.01, right: 0.99 },
      gain_sigma: { left: 0.01, right: 0.01 },
      consistency: 1.1,
      coverage: 0.94,
      fixes: 1_204,
      jumps: 0,
      gaps: 0,
      refused: 0,
      faults: weak.has(id) ? [fault] : [],
    }
  }

  return {
    asked,
    weak,
    /** Status and body of an answer; `null` for what is about something else. */
    answer(method, parts) {
      if (method !== 'GET' || parts[0] !== 'robots' || parts[2] !== 'twin') return null
      if (parts[3] === undefined) return { status: 200, body: twin(parts[1]) }
      return parts[3] === 'forecast' ? { status: 200, body: forecast(parts[1]) } : null
    },
  }
}
