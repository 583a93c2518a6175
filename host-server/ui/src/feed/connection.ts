/**
 * Keeps one WebSocket to the live feed open: reconnects by itself with
 * jittered exponential back-off, and gives a connection up that has fallen
 * silent (the server speaks at least once a second).
 */

import type { Frame, Refusal } from './decode'
import { decodeFrame } from './decode'

export type ConnectionState = 'connecting' | 'live' | 'silent' | 'waiting'

export interface ConnectionStatus {
  state: ConnectionState
  /** Attempts since the connection was last live. */
  attempt: number
  /** When the next attempt starts, by the handed-in clock; only while waiting. */
  retryAt: number | null
}

/** What the connection needs of its surroundings; tests hand in their own. */
export interface ConnectionOptions {
  url: string
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
    let socket: WebSocket
    try {
      socket = this.open(this.options.url)
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

  private retryLater(): void {
    if (this.closed) return
    const ceiling = Math.min(LONGEST_RETRY_MS, FIRST_RETRY_MS * 2 ** Math.max(0, this.attempt - 1))
    // Half fixed, half drawn: many pages must not come back in one instant.
    const delay = ceiling / 2 + (this.random() * ceiling) / 2
    this.retryAt = this.now() + delay
    this.setState('waiting')
    this.retryTimer = setTimeout(() => this.connect(), delay)
  }

  private dropSocket(): void {
    const socket = this.socket
    this.socket = null
    socket?.close()
  }

  private setState(state: ConnectionState): void {
    this.state = state
    if (state !== 'waiting') this.retryAt = null
    this.options.onStatus({ state, attempt: this.attempt, retryAt: this.retryAt })
  }
}

/** Address of the live feed for a page at `location`. */
export function feedUrl(location: { protocol: string; host: string }): string {
  return `${location.protocol === 'https:' ? 'wss:' : 'ws:'}//${location.host}/api/v1/live`
}
