/**
 * Keeps one WebSocket to the live feed open: reconnects by itself with
 * jittered exponential back-off, and gives a connection up that has fallen
 * silent (the server speaks at least once a second).
 */

import { ApiError } from '../http'
import type { Frame, Refusal } from './decode'
import { decodeFrame } from './decode'

/** Where the feed is: an address, or a way to get one that serves once. */
export type FeedAddress = string | (() => string | Promise<string>)

export type ConnectionState = 'connecting' | 'live' | 'silent' | 'waiting'

export interface ConnectionStatus {
  state: ConnectionState
  /** Attempts since the connection was last live. */
  attempt: number
  /** When the next attempt starts, by the handed-in clock; only while waiting. */
  retryAt: number | null
}

/** What the connection needs of its surroundings; tests hand in their own. */
interface ConnectionOptions {
  url: FeedAddress
  onFrame(frame: Frame): void
  onRefused(reason: Refusal): void
  onStatus(status: ConnectionStatus): void
  /** Monotonic milliseconds. */
  now?: () => number
  random?: () => number
  open?: (url: string) => WebSocket
}

/** Silence after which the picture counts as old: three missed metrics frames. */
export const SILENT_AFTER_MS = 3_000
/** Silence after which the connection is given up and made anew. */
export const DEAD_AFTER_MS = 8_000
const FIRST_RETRY_MS = 500
const LONGEST_RETRY_MS = 8_000
const WATCH_EVERY_MS = 500

export class Connection {
  private readonly now: () => number
  private readonly random: () => number
  private readonly open: (url: string) => WebSocket
  private socket: WebSocket | null = null
  private retryTimer: ReturnType<typeof setTimeout> | null = null
  private watchTimer: ReturnType<typeof setInterval> | null = null
  private attempt = 0
  private round = 0
  private state: ConnectionState = 'connecting'
  private retryAt: number | null = null
  private closed = true
  /** Monotonic time of the last frame, or of the last attempt. */
  private heardAt = 0

  constructor(private readonly options: ConnectionOptions) {
    this.now = options.now ?? (() => performance.now())
    this.random = options.random ?? Math.random
    this.open = options.open ?? ((url) => new WebSocket(url))
  }

  start(): void {
    if (!this.closed) return
    this.closed = false
    this.watchTimer = setInterval(() => this.watch(), WATCH_EVERY_MS)
    this.connect()
  }

  close(): void {
    this.closed = true
    if (this.watchTimer !== null) clearInterval(this.watchTimer)
    if (this.retryTimer !== null) clearTimeout(this.retryTimer)
    this.watchTimer = null
    this.retryTimer = null
    this.dropSocket()
  }

  /** Tries at once instead of waiting, for instance when the network is back. */
  retryNow(): void {
    if (this.closed || this.state !== 'waiting') return
    if (this.retryTimer !== null) clearTimeout(this.retryTimer)
    this.connect()
  }

  /** Monotonic time of the last frame. */
  get lastHeard(): number {
    return this.heardAt
  }

  private connect(): void {
    this.retryTimer = null
    this.attempt += 1
    this.heardAt = this.now()
    this.setState('connecting')
    // Rises with every attempt, so that an address that comes late opens nothing.
    this.round += 1
    const { url } = this.options
    const address = typeof url === 'string' ? url : url()
    if (typeof address === 'string') {
      this.openSocket(address)
      return
    }
    const round = this.round
    address.then(
      (found) => {
        if (round === this.round) this.openSocket(found)
      },
      (error: unknown) => {
        if (round === this.round) this.retryLater(error instanceof ApiError ? error.retryAfter : 0)
      },
    )
  }

  private openSocket(url: string): void {
    let socket: WebSocket
    try {
      socket = this.open(url)
    } catch {
      // A malformed address or a policy of the browser; waiting is all there is.
      this.retryLater()
      return
    }
    this.socket = socket
    socket.binaryType = 'arraybuffer'
    socket.onmessage = (message: MessageEvent<unknown>) => {
      if (socket === this.socket) this.receive(message.data)
    }
    socket.onclose = () => {
      if (socket !== this.socket) return
      this.socket = null
      this.retryLater()
    }
    // A close event always follows an error, so there is nothing to do here.
    socket.onerror = () => undefined
  }

  private receive(data: unknown): void {
    if (!(data instanceof ArrayBuffer)) {
      this.options.onRefused('unknown-kind')
      return
    }
    const decoded = decodeFrame(data)
    if (!decoded.ok) {
      this.options.onRefused(decoded.reason)
      return
    }
    this.heardAt = this.now()
    // The hello comes first: only then is the connection good for anything.
    if (decoded.frame.kind === 'hello' || this.state === 'silent') {
      this.attempt = 0
      this.setState('live')
    }
    this.options.onFrame(decoded.frame)
  }

  private watch(): void {
    if (this.state === 'waiting') return
    const silence = this.now() - this.heardAt
    if (silence > DEAD_AFTER_MS) {
      this.dropSocket()
      this.retryLater()
    } else if (silence > SILENT_AFTER_MS && this.state === 'live') {
      this.setState('silent')
    }
  }

  /** At least so many seconds later, where the server asked for that. */
  private retryLater(atLeast: number | null = 0): void {
    if (this.closed) return
    const ceiling = Math.min(LONGEST_RETRY_MS, FIRST_RETRY_MS * 2 ** Math.max(0, this.attempt - 1))
    // Half fixed, half drawn: many pages must not come back in one instant.
    const drawn = ceiling / 2 + (this.random() * ceiling) / 2
    const delay = Math.max(drawn, (atLeast ?? 0) * 1_000)
    this.retryAt = this.now() + delay
    this.setState('waiting')
    this.retryTimer = setTimeout(() => this.connect(), delay)
  }

  private dropSocket(): void {
    const socket = this.socket
    this.round += 1
    this.socket = null
    socket?.close()
  }

  private setState(state: ConnectionState): void {
    this.state = state
    if (state !== 'waiting') this.retryAt = null
    this.options.onStatus({ state, attempt: this.attempt, retryAt: this.retryAt })
  }
}

/** Address of the live feed for a page at `location`; a closed server takes a ticket. */
export function feedUrl(
  location: { protocol: string; host: string },
  ticket: string | null = null,
): string {
  const base = `${location.protocol === 'https:' ? 'wss:' : 'ws:'}//${location.host}/api/v1/live`
  return ticket === null ? base : `${base}?ticket=${encodeURIComponent(ticket)}`
}
