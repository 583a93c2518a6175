// The simulated world of the mock: its time, scenarios, what is dropped into it, bookmarks.

import { Refusal } from './accounts.mjs'

const MOST_BOOKMARKS = 16
const MOST_DROPPED = 64
const NAME = /^[a-z0-9-]{1,32}$/
/** How near to a robot nothing is dropped. */
const BODY = 0.1
const ABOUT = {
  arena: 'A square that grows with the number of robots, posts and boxes in it, everyone wanders.',
  corridor: 'A long corridor with a door, to be passed one after the other.',
  empty: 'Four walls and nothing else; the robots wait for commands.',
  'dynamic-environment': 'A hall with slippery floor and two things that go to and fro.',
  search: 'Coloured objects stand about, to be found with the camera.',
  'simple-navigation': 'One robot visits three places among obstacles.',
  resilience: 'Four robots go on while things break and are mended.',
}

/** A scenario's arena and where its robots begin, the same for the same seed. */
function build(name, robots, seed, usual) {
  const spread = (at, side) => ((((at + 1) * 0.618 + seed * 0.37) % 1) - 0.5) * (side - 1)
  const arena = {
    arena: () => structuredClone(usual),
    corridor: () => ({
      width: 8,
      height: 2.4,
      obstacles: [
        { shape: 'box', x: 0, y: 0.85, w: 0.2, h: 0.7, theta: 0 },
        { shape: 'box', x: 0, y: -0.85, w: 0.2, h: 0.7, theta: 0 },
      ],
    }),
    empty: () => ({ width: 6, height: 6, obstacles: [] }),
    'simple-navigation': () => ({
      width: 6,
      height: 4,
      obstacles: [
        { shape: 'circle', x: -0.8, y: 0.6, r: 0.25 },
        { shape: 'box', x: 1.2, y: -0.5, w: 0.5, h: 0.4, theta: 0.3 },
      ],
    }),
    resilience: () => ({ width: 5, height: 5, obstacles: [] }),
    'dynamic-environment': () => ({
      width: 6,
      height: 5,
      obstacles: [{ shape: 'circle', x: 1.5, y: 1.2, r: 0.3 }],
      movers: [
        { body: { shape: 'circle', x: -2, y: 1, r: 0.2 }, path: [[2, 1.8]], speed: 0.3 },
        {
          body: { shape: 'box', x: -2, y: -1.5, w: 0.4, h: 0.3, theta: 0.4 },
          path: [
            [2, -1.5],
            [2, -0.5],
          ],
          speed: 0.2,
        },
      ],
      patches: [{ x: 0, y: 0, w: 2.5, h: 1.2, theta: 0.3, grip: 0.4 }],
    }),
    search: () => ({
      width: 5,
      height: 4,
      obstacles: [{ shape: 'box', x: 0, y: 0, w: 0.2, h: 1.5, theta: 0.5 }],
      objects: ['red', 'green', 'blue', 'yellow', 'white', 'black'].map((colour, at) => ({
        shape: ['cylinder', 'box', 'ball', 'cone'][at % 4],
        colour,
        x: spread(at + 7, 4.5),
        y: spread(3 * at + 5, 3.5),
        size: 0.2,
      })),
    }),
  }[name]()
  const poses = Array.from({ length: Math.min(robots, 1_000) }, (_, at) => ({
    x: spread(at, arena.width),
    y: spread(5 * at + 2, arena.height),
    theta: (at * 2.4) % 6.28,
  }))
  return { name, about: ABOUT[name], robots, seed, arena, poses }
}

/** `greet` tells every viewer of the arena anew. */
export function createSimulator({ world, clock, find, greet }) {
  const usual = structuredClone(world.arena)
  const state = {
    paused: false,
    factor: 1,
    seed: 1,
    /** Seconds of the world when it began to run, or stood still. */
    time: 0,
    since: clock(),
    robots: world.robots.length,
    scenario: 'arena',
    dropped: [],
    next: 1,
  }
  const bookmarks = new Map()
  const summaries = Object.keys(ABOUT).map((name) => {
    const { arena } = build(name, 8, 1, usual)
    const count = (list) => arena[list]?.length ?? 0
    return {
      name,
      about: ABOUT[name],
      robots: name === 'arena' ? world.robots.length : 8,
      width: arena.width,
      height: arena.height,
      obstacles: count('obstacles'),
      objects: count('objects'),
      movers: count('movers'),
    }
  })

  const refuse = (why) => {
    throw new Refusal(409, 'refused', why)
  }
  const seconds = () =>
    state.paused ? state.time : state.time + ((clock() - state.since) / 1_000) * state.factor
  const setTime = (time) => Object.assign(state, { time, since: clock() })
  const present = () => world.robots.filter(({ presence }) => presence === 'online')

  function view() {
    return {
      state: state.paused ? 'paused' : 'running',
      factor: state.factor,
      real_time_factor: state.paused ? 0 : state.factor,
      time: seconds(),
      seed: state.seed,
      robots: state.robots,
      connected: present().length,
      hash: '544830de73b3a36d',
      scenario: state.scenario,
      dropped: state.dropped,
      bookmarks: [...bookmarks.values()].map(({ told }) => told),
    }
  }

  function preview(name, url) {
    if (!(name in ABOUT)) throw new Refusal(404, 'unknown_scenario', `no scenario ${name}`)
    const given = (key, least) => {
      const text = url.searchParams.get(key)
      if (text === null) return null
      const value = Number(text)
      if (!Number.isInteger(value) || value < least) {
        throw new Refusal(400, 'bad_query', `${key} is no whole number from ${least}`)
      }
      return value
    }
    const { robots } = summaries.find((one) => one.name === name)
    return build(name, given('robots', 1) ?? robots, given('seed', 0) ?? 1, usual)
  }

  /** The walls, what the scenario has, and what was dropped. */
  function furnish(arena) {
    Object.assign(world.arena, { movers: [], patches: [] }, structuredClone(arena))
    state.bare = structuredClone(arena)
    show()
  }

  function show() {
    const of = (key) => state.dropped.flatMap((item) => (item[key] === undefined ? [] : item[key]))
    world.arena.obstacles = [...state.bare.obstacles, ...of('obstacle')]
    world.arena.objects = [...(state.bare.objects ?? []), ...of('object')]
    greet()
  }

  function stand(robot, pose) {
    robot.goal?.done('failed', 'interrupted')
    Object.assign(robot, { x: pose.x, y: pose.y, heading: pose.theta, goal: null })
    Object.assign(robot, { v: 0, w: 0, behaviour: 'manual', state: 'IDLE', estopped: false })
  }

  function load({ scenario, robots, seed }) {
    const url = new URL('http://mock')
    if (robots !== undefined) url.searchParams.set('robots', robots)
    if (seed !== undefined) url.searchParams.set('seed', seed)
    const next = preview(scenario, url)
    if (next.robots > world.robots.length) refuse(`there are ${world.robots.length} robots here`)
    Object.assign(state, { scenario, seed: next.seed, dropped: [] })
    setTime(0)
    state.robots = next.robots
    world.robots.forEach((robot, at) => {
      // Those that are too many switch off, inside the new walls.
      robot.presence = at < next.robots ? 'online' : 'offline'
      stand(robot, next.poses[at] ?? { x: 0, y: 0, theta: 0 })
    })
    furnish(next.arena)
  }

  function drop({ obstacle, object }) {
    const thing = obstacle ?? object
    const { x, y, r, w, h, size } = thing
    const reach = r ?? Math.max(w ?? size, h ?? size) / 2
    if (!(reach > 0)) throw new Refusal(422, 'invalid_command', 'a size is not positive')
    const { width, height } = world.arena
    if (Math.abs(x) > width / 2 || Math.abs(y) > height / 2) refuse('it lies outside the arena')
    const near = present().find((robot) => Math.hypot(robot.x - x, robot.y - y) < reach + BODY)
    if (near !== undefined) refuse(`it overlaps robot ${near.id}`)
    if (state.dropped.length >= MOST_DROPPED) refuse(`${MOST_DROPPED} things are dropped already`)
    const id = state.next++
    state.dropped = [...state.dropped, { id, ...(obstacle ? { obstacle } : { object }) }]
    show()
    return id
  }

  function keep(name) {
    if (!NAME.test(name)) throw new Refusal(422, 'invalid_command', 'no name of a snapshot')
    if (!bookmarks.has(name) && bookmarks.size >= MOST_BOOKMARKS) refuse('16 bookmarks are kept')
    const poses = world.robots.map(({ x, y, heading, presence }) => {
      return { x, y, theta: heading, presence }
    })
    const { scenario, seed, dropped, bare, robots } = state
    const time = seconds()
    bookmarks.set(name, {
      told: { name, time, made_at: clock(), robots, scenario },
      world: { scenario, seed, dropped, bare, robots },
      poses,
      time,
    })
  }

  function kept(name) {
    return bookmarks.get(name) ?? refuse(`there is no bookmark ${name}`)
  }

  function restore(name) {
    const found = kept(name)
    Object.assign(state, found.world)
    setTime(found.time)
    found.poses.forEach((pose, at) => {
      world.robots[at].presence = pose.presence
      stand(world.robots[at], pose)
    })
    furnish(found.world.bare)
  }

  /** What came of a command. */
  function obey(body) {
    let item
    switch (body.command) {
      case 'pause':
        setTime(seconds())
        state.paused = true
        break
      case 'resume':
        if (state.paused) setTime(state.time)
        state.paused = false
        break
      case 'step':
        setTime(seconds() + body.steps * 0.005)
        state.paused = true
        break
      case 'speed':
        setTime(seconds())
        state.factor = body.factor
        break
      case 'reset':
        state.seed = body.seed ?? state.seed
        setTime(0)
        if (state.dropped.length > 0) {
          state.dropped = []
          show()
        }
        break
      case 'add':
        state.robots += 1
        break
      case 'remove':
        find(body.robot)
        state.robots -= 1
        break
      case 'load':
        load(body)
        break
      case 'drop':
        item = drop(body)
        break
      case 'take':
        if (!state.dropped.some(({ id }) => id === body.item))
          refuse(`nothing has number ${body.item}`)
        state.dropped = state.dropped.filter(({ id }) => id !== body.item)
        show()
        break
      case 'snapshot':
        keep(body.name)
        break
      case 'restore':
        restore(body.name)
        break
      case 'forget':
        kept(body.name)
        bookmarks.delete(body.name)
        break
      default:
        throw new Refusal(422, 'invalid_command', 'the body is no command to the simulator')
    }
    return { simulator: view(), ...(item === undefined ? {} : { item }) }
  }

  state.bare = structuredClone(world.arena)

  /** What a GET below `/simulator` gives. */
  function read([, what, name], url) {
    if (what === undefined) return view()
    if (what !== 'scenarios') return null
    return name === undefined ? { scenarios: summaries } : preview(name, url)
  }

  return { read, obey }
}
