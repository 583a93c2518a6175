// Twins of the mock: robots in simulation have one, a little beside where they say they are; one of them is weak.

import { Refusal } from './accounts.mjs'

export function createTwins({ find, list, clock }) {
  /** Robots whose forecasts were asked for, in turn. */
  const asked = []
  /** Robots that a motor of is weak. */
  const weak = new Set()
  /** Robots whose certificate does not hold any more. */
  const stale = new Set()

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
      drift: {
        deviations: { left: 0.4, right: stale.has(id) ? 4.2 : 0.3 },
        stale_since: stale.has(id) ? clock() - 3_600_000 : null,
      },
      consistency: 1.1,
      coverage: 0.94,
      fixes: 1_204,
      jumps: 0,
      gaps: 0,
      refused: 0,
      faults: weak.has(id) ? [fault] : [],
    }
  }

  /** How far robots are from their bodies: the first ones further than others, the last has driven too little. */
  function gap() {
    const pair = (median) => ({ median, p90: 2.4 * median })
    const measures = (own, count = 240) => ({
      whole: own !== null,
      errors: [1, 10].map((ahead_s) => {
        const far = own === null ? 0 : own * (ahead_s === 1 ? 0.4 : 1)
        return {
          ahead_s,
          count,
          way: own === null ? null : 0.3 * ahead_s,
          own: own === null ? null : pair(far),
          nominal: own === null ? null : pair(6 * far),
          ratio: own === null ? null : 1 / 6,
          floor: own === null ? null : pair(0.012),
          coverage: own === null ? null : { within_50: 0.47, within_95: 0.93 },
        }
      }),
      innovations: {
        count,
        coverage: own === null ? null : { within_50: 0.52, within_95: 0.96 },
      },
      displacements: {
        over_s: 2,
        count: Math.round(count / 2),
        own: own === null ? null : own / 100,
        nominal: own === null ? null : own / 20,
        floor: own === null ? null : 0.00012,
      },
    })
    const seen = list().filter(({ presence }) => presence !== 'offline')
    const some = seen.slice(0, 8)
    return {
      time: clock(),
      fleet: measures(0.04, 1_680),
      robots: some.map(({ id }, at) => ({
        robot: id,
        certificate: at % 3 === 0 ? null : '0123456789abcdef',
        since: at === 7 ? null : clock() - 240_000,
        measures: at === 7 ? measures(null, 3) : measures(0.02 + 0.01 * ((at * 3) % 7)),
      })),
    }
  }

  /** Calibrations of all robots, the newest first. Each look at one that goes on brings it further. */
  const calibrations = []
  /** Robots that may not be calibrated, and why. */
  const refused = new Map()

  function permit(id, around) {
    const { x, y } = followed(id)
    const why = refused.get(id) ?? null
    const small = around !== null && around < 1
    const leaves = { code: 'leaves', detail: 'the robot may come too near to the edge', at: [x, y] }
    return {
      robot: id,
      refused: small ? leaves : why,
      seconds: 79.7,
      size: [1.2, 1.3],
      area: Array.from({ length: 24 }, (_, k) => {
        const angle = (k * Math.PI) / 12
        return [x + 0.6 * Math.cos(angle), y + 0.65 * Math.sin(angle)]
      }),
    }
  }

  function begin(id, body, by) {
    if (body.confirmed !== true) {
      throw new Refusal(422, 'invalid_calibration', '`/confirmed` must be true')
    }
    const why = permit(id, body.around ?? null).refused
    if (why !== null) throw new Refusal(409, 'not_permitted', `${why.code}: ${why.detail}`)
    const one = {
      number: calibrations.length + 1,
      robot: id,
      by,
      floor: body.floor ?? '',
      begun: clock(),
      ended: null,
      state: 'preparing',
      seconds: 79.7,
      begun_legs: 0,
      legs: 82,
      area: permit(id, null).area,
      reason: null,
      certificate: null,
      errors: [],
      took_s: null,
    }
    calibrations.unshift(one)
    return one
  }

  function bring(one) {
    if (one.ended !== null) return
    one.begun_legs = Math.min(one.legs, one.begun_legs + 14)
    one.state = one.begun_legs > 55 ? 'held_out' : 'baseline'
    if (one.begun_legs < one.legs) return
    const pair = (median) => ({ median, p90: 2.5 * median })
    const errors = { own: pair(0.041), nominal: pair(0.52), previous: null }
    Object.assign(one, {
      state: 'certified',
      ended: clock(),
      certificate: '0123456789abcdef',
      took_s: 0.3,
      errors: [
        { ...errors, ahead_s: 1 },
        { ...errors, ahead_s: 10 },
      ],
    })
  }

  function stop(id, number, by) {
    const one = calibrations.find((one) => one.robot === id && String(one.number) === number)
    if (one === undefined) throw new Refusal(404, 'unknown_calibration', 'no such calibration')
    if (one.ended !== null) throw new Refusal(409, 'wrong_state', 'this calibration is over')
    const reason = { code: 'stopped', detail: `${by} stopped it` }
    Object.assign(one, { state: 'broken_off', ended: clock(), reason })
  }

  function calibrated(method, parts, url, body, name) {
    const id = parts[1]
    if (parts[3] === 'permit') {
      const around = url.searchParams.get('around')
      return { status: 200, body: permit(id, around === null ? null : Number(around)) }
    }
    if (parts[3] !== 'calibrations') return null
    if (method === 'POST') return { status: 202, body: begin(id, body, name) }
    if (method === 'DELETE') {
      stop(id, parts[4], name)
      return { status: 204, body: undefined }
    }
    const own = calibrations.filter(({ robot }) => robot === id)
    own.forEach(bring)
    return { status: 200, body: { calibrations: own } }
  }

  return {
    asked,
    weak,
    stale,
    calibrations,
    refused,
    /** Status and body of an answer; `null` for what is about something else. */
    answer(method, parts, url, body, name) {
      if (method === 'GET' && parts.join('/') === 'fleet/gap') return { status: 200, body: gap() }
      if (parts[0] !== 'robots' || parts[2] !== 'twin') return null
      const found = calibrated(method, parts, url, body, name)
      if (found !== null || method !== 'GET') return found
      if (parts[3] === undefined) return { status: 200, body: twin(parts[1]) }
      return parts[3] === 'forecast' ? { status: 200, body: forecast(parts[1]) } : null
    },
  }
}
