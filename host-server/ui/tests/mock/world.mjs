// A toy fleet for tests of the page: points that wander between walls and obey
// commands. It is no model of a robot; the simulator is.

const WANDER_SPEED = 0.25
const FAILSAFE_MS = 500
const LOW_BATTERY = 20
const REACHED = 0.05
const MOST_OBSTACLES = 24
/** Robots look ahead every so many steps, in turns: a thousand of them cost too much otherwise. */
const LOOK_EVERY = 10

/** A small generator of repeatable numbers in [0, 1). */
function generator(seed) {
  let state = seed >>> 0
  return () => {
    state = (state + 0x6d2b79f5) >>> 0
    let t = state
    t = Math.imul(t ^ (t >>> 15), t | 1)
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61)
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32
  }
}

export function createWorld({ robots: count = 50, seed = 1 } = {}) {
  const random = generator(seed)
  const side = Math.max(4, Math.sqrt(2 * count))
  const arena = { width: round(side * 1.25), height: round(side * 0.8), obstacles: [] }
  const between = (low, high) => low + random() * (high - low)
  const anywhere = () => [
    between(-arena.width / 2 + 0.5, arena.width / 2 - 0.5),
    between(-arena.height / 2 + 0.5, arena.height / 2 - 0.5),
  ]
  for (let i = 0; i < Math.min(MOST_OBSTACLES, Math.ceil(count / 6)); i++) {
    const [x, y] = anywhere()
    arena.obstacles.push(
      i % 2 === 0
        ? { shape: 'circle', x, y, r: between(0.15, 0.35) }
        : { shape: 'box', x, y, w: between(0.3, 0.9), h: between(0.2, 0.5), theta: between(0, 3) },
    )
  }
  const robots = []
  let steps = 0
  for (let i = 0; i < count; i++) {
    let [x, y] = anywhere()
    while (blocked(x, y)) [x, y] = anywhere()
    const kind = i === 3 ? 'physical' : i === 7 ? 'emulated' : 'simulated'
    robots.push({
      index: i,
      id:
        kind === 'physical'
          ? 'rover-1'
          : kind === 'emulated'
            ? 'virt-0001'
            : `sim-${String(i + 1).padStart(4, '0')}`,
      kind,
      firmware: '0.1.0',
      board: kind === 'physical' ? 'xiao-s3' : kind === 'emulated' ? 'virt' : 'sim',
      x,
      y,
      heading: between(0, 2 * Math.PI),
      v: 0,
      w: 0,
      state: 'IDLE',
      behaviour: 'wander',
      presence: i === 11 ? 'stale' : i === 12 ? 'offline' : 'online',
      rangeMm: null,
      battery: i === 5 ? 14 : 60 + Math.floor(random() * 40),
      lowBattery: i === 5,
      estopped: false,
      drivenAt: -Infinity,
      avoiding: 0,
    })
  }

  function blocked(x, y) {
    const reach = 0.12
    if (Math.abs(x) > arena.width / 2 - reach || Math.abs(y) > arena.height / 2 - reach) return true
    return arena.obstacles.some((o) => {
      if (o.shape === 'circle') return Math.hypot(x - o.x, y - o.y) < o.r + reach
      const [c, s] = [Math.cos(-o.theta), Math.sin(-o.theta)]
      const [dx, dy] = [x - o.x, y - o.y]
      return (
        Math.abs(dx * c - dy * s) < o.w / 2 + reach && Math.abs(dx * s + dy * c) < o.h / 2 + reach
      )
    })
  }

  function look(robot) {
    for (let r = 0.02; r < 4.5; r += 0.08) {
      if (blocked(robot.x + r * Math.cos(robot.heading), robot.y + r * Math.sin(robot.heading))) {
        return Math.round(r * 1000) + 20
      }
    }
    return null
  }

  function decide(robot, now) {
    if (robot.estopped) return ['ERROR', 0, 0]
    if (robot.behaviour === 'manual') {
      if (now - robot.drivenAt > FAILSAFE_MS) return ['IDLE', 0, 0]
      return [robot.v !== 0 || robot.w !== 0 ? 'MOVING' : 'IDLE', robot.v, robot.w]
    }
    if (robot.behaviour === 'goto') {
      const [dx, dy] = [robot.goal.x - robot.x, robot.goal.y - robot.y]
      if (Math.hypot(dx, dy) < REACHED) {
        robot.behaviour = 'manual'
        robot.goal.done('completed', null)
        return ['IDLE', 0, 0]
      }
      const off = Math.atan2(dy, dx) - robot.heading
      const turn = Math.atan2(Math.sin(off), Math.cos(off))
      return ['MOVING', Math.abs(turn) < 0.5 ? WANDER_SPEED : 0, 3 * turn]
    }
    if (robot.behaviour !== 'wander') return ['IDLE', 0, 0]
    const range = robot.rangeMm ?? 9_999
    if (robot.avoiding > 0 || range < 300) {
      robot.avoiding = range < 600 ? 5 : robot.avoiding - 1
      return ['AVOIDING', 0, 1.5]
    }
    if (range < 700) return ['CAUTION', WANDER_SPEED / 2, 0.2]
    return ['MOVING', WANDER_SPEED, 0.3 * Math.sin(now / 3_000 + robot.index)]
  }

  return {
    arena,
    robots,
    /** Advances by `dt` seconds. */
    step(dt, now) {
      steps += 1
      for (const robot of robots) {
        if (robot.presence !== 'online') continue
        if ((steps + robot.index) % LOOK_EVERY === 0) robot.rangeMm = look(robot)
        const [state, v, w] = decide(robot, now)
        robot.state = state
        robot.heading += w * dt
        const x = robot.x + v * Math.cos(robot.heading) * dt
        const y = robot.y + v * Math.sin(robot.heading) * dt
        if (!blocked(x, y)) [robot.x, robot.y] = [x, y]
        robot.lowBattery = robot.battery < LOW_BATTERY
      }
    },
    /** Obeys one command; `done` is told later what came of one that takes time. The answer is a status and a reason as on the wire. */
    obey(robot, { command, parameters = {} }, now, done = () => undefined) {
      const moves = ['drive', 'move', 'behave', 'goto', 'scan'].includes(command)
      if (moves && robot.estopped) return { status: 'rejected', reason: 'estopped' }
      if (command !== 'identify' && command !== 'goto') {
        robot.goal?.done('failed', 'interrupted')
        robot.goal = null
      }
      switch (command) {
        case 'goto':
          if (
            Math.abs(parameters.x) > arena.width / 2 ||
            Math.abs(parameters.y) > arena.height / 2
          ) {
            return { status: 'rejected', reason: 'out_of_range' }
          }
          robot.goal?.done('failed', 'interrupted')
          robot.behaviour = 'goto'
          robot.goal = { x: parameters.x, y: parameters.y, done }
          return { status: 'accepted', reason: null }
        case 'drive':
          Object.assign(robot, {
            behaviour: 'manual',
            v: parameters.v,
            w: parameters.w,
            drivenAt: now,
          })
          break
        case 'stop':
          Object.assign(robot, { behaviour: 'manual', v: 0, w: 0, drivenAt: -Infinity })
          break
        case 'estop':
          Object.assign(robot, {
            behaviour: 'manual',
            v: 0,
            w: 0,
            drivenAt: -Infinity,
            estopped: true,
          })
          break
        case 'reset':
          robot.estopped = false
          break
        case 'behave':
          robot.behaviour = parameters.behaviour
          break
        case 'identify':
        case 'reboot':
        case 'scan':
        case 'capture':
          break
        default:
          return { status: 'rejected', reason: 'unknown_command' }
      }
      return { status: 'completed', reason: null }
    },
  }
}

function round(value) {
  return Math.round(value * 10) / 10
}
