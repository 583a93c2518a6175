// What the pages about robots, commands and the simulated world ask the server for.

import { Refusal } from './accounts.mjs'
import { createSimulator } from './simulator.mjs'
import { withExtremes } from './extremes.mjs'

const DEFAULTS = [
  ['name', '', '', null, null, null],
  ['max_speed', 0.5, 0.5, 0.05, 2, 'm/s'],
  ['safe_distance_mm', 600, 600, 100, 3_000, 'mm'],
  ['critical_distance_mm', 250, 250, 50, 1_500, 'mm'],
  ['avoidance', true, true, null, null, null],
  ['telemetry_hz', 5, 5, 0.1, 20, 'Hz'],
  ['trim_left', 1, 1, 0.7, 1, null],
]
/** Robots answer one after the other, so that progress can be seen. */
const ANSWER_EVERY_MS = 12
const LONGEST_ANSWER_MS = 1_500
const MOST_SET = 8
const PICTURE =
  '<svg xmlns="http://www.w3.org/2000/svg" width="96" height="96"><rect width="96" height="96" ' +
  'fill="#456"/><rect y="56" width="96" height="40" fill="#876"/><circle cx="40" cy="52" r="11" ' +
  'fill="#e83"/></svg>'

/** `greet` tells every viewer of the arena anew. */
export function createFleet({ world, commands, clock, greet, answering }) {
  const values = new Map()
  const pictures = clock()
  const simulator = createSimulator({ world, clock, find, greet })

  function find(id) {
    const robot = world.robots.find((one) => one.id === id)
    if (robot === undefined) throw new Refusal(404, 'unknown_robot', `no robot ${id}`)
    return robot
  }

  function parameters(id) {
    const own = values.get(id) ?? {}
    return {
      parameters: DEFAULTS.map(([name, value, usual, min, max, unit]) => {
        return { name, value: own[name] ?? value, default: usual, min, max, unit }
      }),
    }
  }

  /** Status and reason as a robot would answer. */
  function set(id, wanted) {
    if (Object.keys(wanted).length > MOST_SET) return { status: 'rejected', reason: 'out_of_range' }
    for (const [name, value] of Object.entries(wanted)) {
      const known = DEFAULTS.find(([known]) => known === name)
      if (known === undefined) return { status: 'rejected', reason: 'unknown_parameter' }
      const [, , , min, max] = known
      if (min !== null && (value < min || value > max)) {
        return { status: 'rejected', reason: 'out_of_range' }
      }
    }
    values.set(id, { ...values.get(id), ...wanted })
    return { status: 'completed', reason: null }
  }

  function view(record, robot = null) {
    const now = clock()
    const outcomes = record.outcomes.map((outcome, index) => {
      const due = record.slow ? Math.min(LONGEST_ANSWER_MS, index * ANSWER_EVERY_MS) : 0
      const answered = now >= record.timestamp + due && (!record.slow || index < answering.most)
      const { status, reason } = answered ? outcome : { status: 'pending', reason: null }
      const at = answered ? record.timestamp + due + 4 : null
      return { robot: outcome.robot, status, reason, timestamp: at }
    })
    const counts = {}
    for (const { status } of outcomes) counts[status] = (counts[status] ?? 0) + 1
    const decisive =
      outcomes.find(({ status }) => status === 'pending') ??
      outcomes.find(({ status }) => status !== 'completed')
    return {
      id: record.id,
      seq: Number(record.id),
      command: record.command,
      robot: record.to === 'swarm' ? null : record.to,
      source: record.source,
      timestamp: record.timestamp,
      status: decisive?.status ?? 'completed',
      reason: decisive?.reason ?? null,
      counts,
      outcomes: robot === null ? outcomes : outcomes.filter((one) => one.robot === robot),
    }
  }

  function listed(url) {
    const robot = url.searchParams.get('robot')
    const limit = Number(url.searchParams.get('limit') ?? 50)
    const wanted = commands.filter(({ command, outcomes }) => {
      return command !== 'drive' && (robot === null || outcomes.some((one) => one.robot === robot))
    })
    const newest = wanted.reverse().slice(0, limit)
    return { commands: newest.map((record) => view(record, robot)) }
  }

  function history(id, url) {
    const [from, to, step] = ['from', 'to', 'step'].map((name) =>
      Number(url.searchParams.get(name)),
    )
    if (!(from > 0 && to > from && step > 0 && (to - from) / step < 2_000)) {
      throw new Refusal(400, 'bad_query', 'no such stretch')
    }
    const points = []
    for (let at = Math.ceil(from / step) * step; at < to; at += step) {
      const t = at / 1_000
      points.push(
        withExtremes({
          at,
          count: 5,
          x: Math.cos(t / 20),
          y: Math.sin(t / 20),
          theta: 0,
          range_mm: Math.floor(t / 15) % 4 === 0 ? null : 900 + 600 * Math.sin(t / 7),
          battery_mv: 7_900,
          battery_percent: 80 - ((t / 60) % 30),
          rssi_dbm: -58 + 6 * Math.sin(t / 11),
          left: 0.4 + 0.2 * Math.sin(t / 3),
          right: 0.4 - 0.2 * Math.sin(t / 3),
          state: 'MOVING',
        }),
      )
    }
    return { robot: id, from, to, step, points }
  }

  function logs(id) {
    const now = clock()
    return {
      records: [
        {
          robot: id,
          seq: 3,
          timestamp: now - 2_000,
          level: 'warn',
          event: 'ranger',
          text: 'noisy',
        },
        { robot: id, seq: 2, timestamp: now - 9_000, level: 'info', event: 'link', text: 'joined' },
        { robot: id, seq: 1, timestamp: 0, level: 'info', event: 'battery', text: 'good' },
      ],
    }
  }

  /** What a GET of this path gives; `null` for paths of others. */
  function read(parts, url) {
    const [first, id, what] = parts
    if (first === 'simulator') return simulator.read(parts, url)
    if (first === 'commands' && id === undefined) return listed(url)
    if (first === 'commands') {
      const record = commands[Number(id)]
      if (record === undefined) throw new Refusal(404, 'unknown_command_id', 'no such command')
      return view(record)
    }
    if (first !== 'robots' || what === undefined) return null
    find(id)
    if (what === 'parameters') return parameters(id)
    if (what === 'telemetry') return history(id, url)
    if (what === 'logs') return logs(id)
    return null
  }

  /** Some robots are from before updates. */
  function runs({ index, board }) {
    if (index % 7 === 3) return null
    return board === 'virt' ? '9f2c1ab9' : '9f2c1ab034d5e6f7'
  }

  /** What is told of a robot beyond what moves. */
  function details(robot) {
    const eyes = robot.index % 2 === 0
    return {
      capabilities: ['drive', 'range', ...(eyes ? ['camera', 'vision'] : [])],
      boot: { count: 3, cause: 'power-on' },
      protocol: 1,
      build: runs(robot),
      models: { detector: '00112233445566778899aabbccddeeff' },
      firmware: robot.firmware,
      board: robot.board,
      link: null,
      // The first one compares a policy.
      shadow:
        robot.index === 0
          ? {
              policy: 'candidate',
              decisions: 1_200,
              agreed: 1_128,
              vetoes: 60,
              driving_vetoes: 84,
              agreement: { share: 0.94, low: 0.925, high: 0.952 },
              veto_share: { share: 0.05, low: 0.039, high: 0.064 },
              driving_veto_share: { share: 0.07, low: 0.057, high: 0.086 },
            }
          : null,
      last_seen: robot.presence === 'online' ? clock() : clock() - 60_000,
      uptime_ms: clock() - pictures + 60_000,
      pose: { x: robot.x, y: robot.y, theta: robot.heading, sigma: 0.03 },
      wheels: { left: robot.v, right: robot.v },
      image: eyes ? pictures : null,
      sees: eyes
        ? {
            timestamp: pictures,
            frame: 7,
            objects: [{ class: 'object', x: 0.42, y: 0.54, bearing: 0.1, margin: 40 }],
          }
        : null,
    }
  }

  function metrics(counts) {
    return [
      '# TYPE terracrawler_command_answers counter',
      `terracrawler_command_answers_total{status="completed"} ${counts.answered}`,
      'terracrawler_command_answers_total{status="timeout"} 0',
      ...[0.01, 0.05, 1].map((le) => {
        return `terracrawler_command_latency_seconds_bucket{le="${le}",command="stop"} ${counts.answered}`
      }),
      `terracrawler_command_latency_seconds_bucket{le="+Inf",command="stop"} ${counts.answered}`,
      'terracrawler_broker_connected 1',
      'terracrawler_broker_losses_total 0',
      `terracrawler_embedded_broker_connections ${world.robots.length + 1}`,
      'terracrawler_embedded_broker_queued 0',
      'terracrawler_data_free_bytes 54000000000',
      'terracrawler_data_size_bytes 8000000',
      'terracrawler_history_written_total 90',
      'terracrawler_history_queued 3',
      'terracrawler_history_dropped_total 0',
      'terracrawler_history_failures_total 0',
      'terracrawler_history_damaged_total 0',
      'terracrawler_robots_sharing_an_id 0',
      'terracrawler_build_info{version="0.0.0-mock"} 1',
      '# EOF',
      '',
    ].join('\n')
  }

  return { read, view, set, find, simulate: simulator.obey, details, metrics, picture: PICTURE }
}
