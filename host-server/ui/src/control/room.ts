/**
 * The control room's state: wires feed, fleet, drive and emergency stop
 * together and offers Vue what it shows. One per page.
 */

import type { ComputedRef, InjectionKey, Ref, ShallowRef } from 'vue'
import { computed, inject, ref, shallowRef } from 'vue'
import { includes } from '../account/roles'
import type { Role } from '../account/roles'
import type { Api, Command, RobotDetails } from '../api'
import { words as account } from '../strings-account'
import type { ConnectionStatus, FeedAddress } from '../feed/connection'
import { Connection } from '../feed/connection'
import type { Arena, Frame, Level, MetricsFrame } from '../feed/decode'
import { FEED_PROTOCOL } from '../feed/decode'
import type { Robot } from '../fleet/fleet'
import { Fleet, MOVING_FOR_MS } from '../fleet/fleet'
import type { Summaries } from '../fleet/order'
import { Selection } from '../fleet/selection'
import type { Direction } from '../drive/driver'
import { Driver } from '../drive/driver'
import { text } from '../strings'
import type { ArenaKeys } from './controls'
import { isOpen, message, named } from './told'
import type { StopState } from './stop'
import { EmergencyStop } from './stop'
import type { LogEntry } from './log'
import { Log } from './log'

export { MOST_LOG_ENTRIES } from './log'

type Blocked = keyof typeof text.drive.blocked

/** The list and all figures are brought up to date this often, not at feed rate. */
const REFRESH_MS = 200
const DETAILS_EVERY_MS = 1_000
const SUMMARIES_EVERY_MS = 5_000
/** Time after which the outcome of a command that matters is asked for. */
const OUTCOME_AFTER_MS = 600
/** Time between two looks at who has confirmed a stop. */
const RECEIPT_EVERY_MS = 300
/** All robots must report ERROR this long before the page takes it for a stop. */
const ADOPT_AFTER_MS = 1_500

interface RoomOptions {
  url: FeedAddress
  api: Api
  /** What the one at the controls may do; everything, where it is not said. */
  role?: Ref<Role>
  open?: (url: string) => WebSocket
}

export class Room {
  readonly fleet = new Fleet()
  readonly connection: Connection
  readonly driver: Driver
  readonly stop: EmergencyStop
  readonly api: Api
  /** Whether robots may be commanded at all. */
  readonly mayOperate: ComputedRef<boolean>
  private readonly entries = new Log()

  /** Rises whenever figures and rows are worth computing anew. */
  readonly tick = ref(0)
  readonly status: ShallowRef<ConnectionStatus> = shallowRef({
    state: 'connecting',
    attempt: 0,
    retryAt: null,
  })
  /** Seconds since the server was last heard. */
  readonly age = ref(0)
  readonly retryIn = ref(0)
  readonly fleetName = ref('')
  readonly arena: ShallowRef<Arena | null> = shallowRef(null)
  /** Feed version of the server when this page does not know it. */
  readonly mismatch: Ref<number | null> = ref(null)
  readonly metrics: ShallowRef<MetricsFrame | null> = shallowRef(null)
  readonly ignored = ref(0)
  readonly log: ShallowRef<readonly LogEntry[]>
  readonly selectedId: Ref<string | null> = ref(null)
  readonly details: ShallowRef<RobotDetails | null> = shallowRef(null)
  readonly summaries: ShallowRef<Summaries> = shallowRef(new Map())
  /** Robots to act on together; the lasso in the arena chooses too. */
  readonly selection = new Selection()
  readonly stopState: Ref<StopState> = ref('armed')
  readonly stopError: Ref<string | null> = ref(null)
  /** Robots that have confirmed the stop, and robots it went to. */
  readonly stopReceipt: ShallowRef<{ completed: number; expected: number } | null> =
    shallowRef(null)
  readonly directions: ShallowRef<ReadonlySet<Direction>> = shallowRef(new Set())
  /** Something is held or pushed. */
  readonly driving = ref(false)
  /** What a gamepad calls itself, and whether its stick must be let go before it drives. */
  readonly gamepad = { name: ref<string | null>(null), waits: ref(false) }
  readonly speed = ref(0.6)
  /** The drive pad has the keyboard: Tab goes to the next robot rather than on. */
  readonly captured = ref(false)
  /** Last refusal of a drive command, until driving works again. */
  readonly driveError: Ref<string | null> = ref(null)
  readonly announcement = ref('')

  readonly blocked = computed<Blocked | null>(() => {
    void this.tick.value
    if (this.selectedId.value === null) return null
    if (!this.mayOperate.value) return 'role'
    if (this.stopState.value !== 'armed') return 'stopped'
    const state = this.status.value.state
    if (state !== 'live') return 'link'
    const robot = this.fleet.get(this.selectedId.value)
    if (robot === undefined) return 'gone'
    if (robot.presence !== 'online') return robot.presence
    if (robot.state === 'INITIALIZING') return 'starting'
    if (robot.state === 'UPDATING') return 'updating'
    if (robot.state === 'ERROR') return 'error'
    return null
  })

  /** Called with every change of a pose; the arena hangs on it. */
  onPoses: () => void = () => undefined
  /** What keys do in the arena; null while there is none. */
  arenaKeys: ArenaKeys | null = null

  private dirty = true
  /** Whether this connection has said hello. */
  private greeted = false
  /** Server clock minus page clock: the smallest seen, so network delay drops out. */
  private clockOffset: number | null = null
  private allErrorSince: number | null = null
  /** The stop whose receipts are being counted. */
  private stopFollowed: string | null = null
  private outcomeDue: { id: string; command: string; robot: string } | null = null
  private readonly timers: ReturnType<typeof setInterval>[] = []

  constructor(options: RoomOptions) {
    this.api = options.api
    this.log = this.entries.shown
    this.mayOperate = computed(() => includes(options.role?.value ?? 'admin', 'operator'))
    this.connection = new Connection({
      url: options.url,
      onFrame: (frame) => this.receive(frame),
      onRefused: () => {
        this.ignored.value += 1
      },
      onStatus: (status) => this.setStatus(status),
      ...(options.open === undefined ? {} : { open: options.open }),
    })
    this.driver = new Driver({
      send: (robot, command) => this.sendDrive(robot, command),
      onFailure: (robot, command, error) => {
        this.driveError.value = message(error)
        this.note('error', robot, text.log.commandFailed(command.command, robot, message(error)))
      },
      onChange: () => {
        this.directions.value = this.driver.directions
        this.driving.value = this.driver.driving
      },
    })
    this.driver.setSpeed(this.speed.value)
    this.stop = new EmergencyStop({
      send: (command) => this.api.commandSwarm(command),
      onChange: (state, error) => this.setStop(state, error),
      onTaken: (id) => void this.followStop(id),
    })
  }

  start(): void {
    this.connection.start()
    this.timers.push(
      setInterval(() => this.refresh(), REFRESH_MS),
      setInterval(() => void this.fetchDetails(), DETAILS_EVERY_MS),
      setInterval(() => void this.fetchSummaries(), SUMMARIES_EVERY_MS),
      setInterval(() => void this.askOutcome(), OUTCOME_AFTER_MS),
    )
  }

  close(): void {
    this.driver.releaseAll()
    this.stopFollowed = null
    this.stop.cancel()
    this.connection.close()
    for (const timer of this.timers) clearInterval(timer)
    this.timers.length = 0
  }

  get selected(): Robot | undefined {
    return this.selectedId.value === null ? undefined : this.fleet.get(this.selectedId.value)
  }

  /** Server clock now, Unix milliseconds, as well as the feed tells. */
  serverNow(): number {
    return performance.now() + (this.clockOffset ?? 0)
  }

  select(id: string | null): void {
    if (id === this.selectedId.value) return
    this.selectedId.value = id
    this.details.value = null
    this.driveError.value = null
    this.driver.setTarget(id)
    this.driver.setBlocked(id === null ? 'no-robot' : this.blocked.value)
    this.tick.value += 1
    this.onPoses()
    void this.fetchDetails()
  }

  hold(source: string, direction: Direction): boolean {
    this.driver.setBlocked(this.selectedId.value === null ? 'no-robot' : this.blocked.value)
    return this.driver.hold(source, direction)
  }

  setSpeed(share: number): void {
    this.speed.value = share
    this.driver.setSpeed(share)
  }

  stopAll(): void {
    if (!this.mayOperate.value) {
      this.stopError.value = account.need.stop
      this.announcement.value = account.need.stop
      return
    }
    this.stopReceipt.value = null
    this.stop.trigger()
    this.driver.setBlocked('stopped')
    this.announcement.value = text.stop.announced
  }

  async rearm(): Promise<void> {
    if (await this.stop.rearm()) this.announcement.value = text.stop.announcedArmed
  }

  /** Sends a command to all robots and logs what comes of it. */
  async tellAll(command: Command): Promise<void> {
    try {
      await this.api.commandSwarm(command)
      this.note('info', null, text.log.sent(named(command), text.log.all))
    } catch (error) {
      this.note('error', null, text.log.commandFailed(named(command), text.log.all, message(error)))
    }
  }

  /** Sends a command to the selected robot and logs what comes of it. */
  async tellSelected(command: Command): Promise<void> {
    const id = this.selectedId.value
    if (id === null) return
    this.driver.releaseAll()
    try {
      const commandId = await this.api.commandRobot(id, command)
      this.note('info', id, text.log.sent(named(command), id))
      if (commandId !== null) {
        this.outcomeDue = { id: commandId, command: named(command), robot: id }
      }
    } catch (error) {
      this.note('error', id, text.log.commandFailed(named(command), id, message(error)))
    }
  }

  note(level: Level, robot: string | null, words: string): void {
    this.entries.append({ time: Date.now(), level, robot, text: words })
  }

  clearLog(): void {
    this.entries.clear()
  }

  /** Lets go of everything but what is shown, until `resume`. */
  suspend(): void {
    this.driver.setBlocked('link')
    this.connection.close()
    this.setStatus({ state: 'waiting', attempt: 0, retryAt: null })
  }

  resume(): void {
    this.connection.start()
  }

  private receive(frame: Frame): void {
    switch (frame.kind) {
      case 'hello':
        this.mismatch.value = frame.protocol === FEED_PROTOCOL ? null : frame.protocol
        this.fleetName.value = frame.fleet
        this.arena.value = frame.arena
        // One more on the same socket tells of another arena; robots and clock stay.
        if (!this.greeted) {
          this.greeted = true
          this.clockOffset = null
          this.fleet.begin(frame.time)
        }
        break
      case 'roster':
        this.fleet.applyRoster(frame)
        this.onPoses()
        break
      case 'poses':
        this.keepTime(this.fleet.timeOf(frame))
        this.fleet.applyPoses(frame, this.serverNow())
        if (frame.full) void this.fetchSummaries()
        this.onPoses()
        break
      case 'event':
        this.entries.append({
          time: frame.time,
          level: frame.level,
          robot: frame.robot,
          text: frame.text,
        })
        break
      case 'metrics':
        this.metrics.value = frame
        break
    }
    this.dirty = true
  }

  /** The largest offset belongs to the frame that was least delayed. */
  private keepTime(serverTime: number): void {
    const sample = serverTime - performance.now()
    // Forgets one millisecond per frame, so that a clock that is set back is followed.
    this.clockOffset = Math.max(sample, (this.clockOffset ?? sample) - 1)
  }

  private setStatus(status: ConnectionStatus): void {
    const before = this.status.value.state
    this.status.value = status
    if (status.state === 'connecting') this.greeted = false
    if (status.state !== 'live') this.driver.setBlocked('link')
    if (status.state === 'live' && before !== 'silent' && before !== 'live') {
      this.note('info', null, text.log.linkBack)
    } else if (status.state === 'waiting' && (before === 'live' || before === 'silent')) {
      this.note('error', null, text.log.linkLost)
    }
    this.dirty = true
  }

  private setStop(state: StopState, error: string | null): void {
    this.stopState.value = state
    this.stopError.value = error
    if (state !== 'armed') this.driver.setBlocked('stopped')
    if (state === 'armed') this.allErrorSince = null
  }

  private refresh(): void {
    const now = performance.now()
    const { state, retryAt } = this.status.value
    this.age.value = Math.round((now - this.connection.lastHeard) / 100) / 10
    this.retryIn.value = state === 'waiting' && retryAt !== null ? (retryAt - now) / 1_000 : 0
    // Robots that came to rest send nothing more, so the count must fall by itself.
    const settling = this.serverNow() - this.fleet.newest < 2 * MOVING_FOR_MS
    if (this.dirty || settling || state !== 'live') {
      this.dirty = false
      this.tick.value += 1
    }
    if (this.selectedId.value !== null && this.blocked.value !== null) {
      this.driver.setBlocked(this.blocked.value)
    }
    this.watchForStop(now)
    this.entries.show()
  }

  /** A stop pressed elsewhere shows as every reachable robot reporting ERROR. */
  private watchForStop(now: number): void {
    let reachable = 0
    for (const robot of this.fleet.all()) {
      if (robot.presence !== 'online') continue
      reachable += 1
      if (robot.state !== 'ERROR') {
        this.allErrorSince = null
        return
      }
    }
    if (reachable === 0) return
    this.allErrorSince ??= now
    if (now - this.allErrorSince > ADOPT_AFTER_MS) this.stop.adopt()
  }

  private async sendDrive(robot: string, command: Command): Promise<void> {
    const id = await this.api.commandRobot(robot, command)
    if (id !== null && command.command === 'drive') {
      this.outcomeDue = { id, command: command.command, robot }
    }
  }

  /** Counts the robots that confirm a stop until all have, or none will any more. */
  private async followStop(id: string | null): Promise<void> {
    this.stopFollowed = id
    while (id !== null && this.stopFollowed === id && this.stopState.value === 'stopped') {
      const outcome = await this.api.outcome(id).catch(() => null)
      if (this.stopFollowed !== id) return
      if (outcome !== null) {
        this.stopReceipt.value = { completed: outcome.completed, expected: outcome.expected }
        if (!isOpen(outcome.status)) return
      }
      await new Promise((resolve) => setTimeout(resolve, RECEIPT_EVERY_MS))
    }
  }

  /** A robot may refuse what the server took; the operator must hear of it. */
  private async askOutcome(): Promise<void> {
    const due = this.outcomeDue
    this.outcomeDue = null
    if (due === null) return
    try {
      const outcome = await this.api.outcome(due.id)
      if (outcome.status === 'pending' && !this.driver.driving) this.outcomeDue ??= due
      if (isOpen(outcome.status)) return
      if (outcome.status === 'completed') {
        if (due.command === 'drive') this.driveError.value = null
        return
      }
      // The word of a stop that overtook it is no news.
      if (due.command === 'drive' && outcome.reason === 'interrupted') return
      const words = text.log.refused(due.command, outcome.status ?? 'failed', outcome.reason)
      if (due.command === 'drive') {
        if (this.driveError.value === words) return
        this.driveError.value = words
      }
      this.note('warn', due.robot, words)
    } catch {
      // The answer is a courtesy; its loss is already visible as a lost connection.
    }
  }

  private async fetchDetails(): Promise<void> {
    const id = this.selectedId.value
    if (id === null || document.hidden || this.status.value.state !== 'live') return
    const details = await this.api.robot(id).catch(() => null)
    if (id === this.selectedId.value) this.details.value = details
  }

  private async fetchSummaries(): Promise<void> {
    if (document.hidden || this.status.value.state !== 'live' || this.fleet.size === 0) return
    const found = await this.api.summaries().catch(() => null)
    if (found !== null) this.summaries.value = found
  }
}

const ROOM: InjectionKey<Room> = Symbol('room')

export { ROOM }

export function useRoom(): Room {
  const room = inject(ROOM)
  if (room === undefined) throw new Error('no control room is provided')
  return room
}
