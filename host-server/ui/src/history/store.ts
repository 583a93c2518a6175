/** Pieces of the record: fetched as they are wanted, kept while there is room. */

import { ApiError } from '../http'
import type { Piece } from './chunks'
import type { Recorded } from './record'

/** About 26 bytes each. */
const MOST_KEPT_POINTS = 1_500_000
/** Requests under way at a time. */
const AT_ONCE = 2
/** Records are written in batches: what is younger than this may not be there yet. */
const SETTLED_MS = 5_000
/** What was not all there is asked for again. */
const AGAIN_MS = 2_000
const RETRY_MS = 2_000
const LONGEST_RETRY_MS = 30_000

interface StoreOptions {
  fetch: (piece: Piece, signal: AbortSignal) => Promise<Recorded>
  /** The server's clock, Unix milliseconds. */
  now: () => number
  /** Something came, or did not. */
  onChange: () => void
  most?: number
}

interface Kept {
  recorded: Recorded
  /** When it is to be asked for again; `null` once nothing can be added to it. */
  due: number | null
}

interface Failure {
  error: unknown
  tries: number
  due: number
}

export class Store {
  private readonly kept = new Map<string, Kept>()
  private readonly failures = new Map<string, Failure>()
  private readonly underWay = new Map<string, AbortController>()
  private queue: readonly Piece[] = []
  private timer: ReturnType<typeof setTimeout> | null = null
  /** Points kept now. */
  points = 0

  constructor(private readonly options: StoreOptions) {}

  /** These and no others; what is under way for nobody is given up. */
  want(pieces: readonly Piece[]): void {
    this.queue = pieces
    const keys = new Set(pieces.map(({ key }) => key))
    for (const [key, controller] of this.underWay) {
      if (keys.has(key)) continue
      this.underWay.delete(key)
      controller.abort()
    }
    for (const key of this.failures.keys()) if (!keys.has(key)) this.failures.delete(key)
    this.pump()
  }

  get(piece: Piece): Recorded | undefined {
    const kept = this.kept.get(piece.key)
    if (kept === undefined) return undefined
    // The last one used is the last one to go.
    this.kept.delete(piece.key)
    this.kept.set(piece.key, kept)
    return kept.recorded
  }

  has(piece: Piece): boolean {
    return this.kept.has(piece.key)
  }

  loading(piece: Piece): boolean {
    return this.underWay.has(piece.key)
  }

  /** Why a piece is not there; `null` while it may still come. */
  failure(piece: Piece): unknown {
    return this.failures.get(piece.key)?.error ?? null
  }

  /** At once what failed. */
  retry(): void {
    this.failures.clear()
    this.pump()
  }

  /** Everything anew: another layout, or another fleet. */
  clear(): void {
    this.want([])
    this.kept.clear()
    this.points = 0
  }

  close(): void {
    this.clear()
    if (this.timer !== null) clearTimeout(this.timer)
    this.timer = null
  }

  private pump(): void {
    const now = this.options.now()
    let next = Number.POSITIVE_INFINITY
    for (const piece of this.queue) {
      if (this.underWay.size >= AT_ONCE) break
      if (this.underWay.has(piece.key)) continue
      const due = this.failures.get(piece.key)?.due ?? this.dueOf(piece)
      if (due === null) continue
      if (due > now) next = Math.min(next, due)
      else void this.load(piece)
    }
    if (this.timer !== null) clearTimeout(this.timer)
    this.timer = null
    if (Number.isFinite(next)) {
      this.timer = setTimeout(() => this.pump(), Math.max(50, next - now))
    }
  }

  /** `null`: it is there for good. */
  private dueOf(piece: Piece): number | null {
    const kept = this.kept.get(piece.key)
    return kept === undefined ? 0 : kept.due
  }

  private async load(piece: Piece): Promise<void> {
    const controller = new AbortController()
    const { key } = piece
    this.underWay.set(key, controller)
    const asked = this.options.now()
    try {
      const recorded = await this.options.fetch(piece, controller.signal)
      if (controller.signal.aborted) return
      const settled = piece.asked.to + SETTLED_MS < asked
      this.keep(key, { recorded, due: settled ? null : this.options.now() + AGAIN_MS })
      this.failures.delete(key)
    } catch (error) {
      if (controller.signal.aborted) return
      const tries = (this.failures.get(key)?.tries ?? 0) + 1
      // The server names a time where there are too many of us.
      const asks = error instanceof ApiError ? (error.retryAfter ?? 0) * 1_000 : 0
      const wait = Math.max(asks, Math.min(LONGEST_RETRY_MS, RETRY_MS * 2 ** (tries - 1)))
      this.failures.set(key, { error, tries, due: this.options.now() + wait })
    } finally {
      if (this.underWay.get(key) === controller) {
        this.underWay.delete(key)
        this.pump()
        this.options.onChange()
      }
    }
  }

  private keep(key: string, kept: Kept): void {
    this.points += kept.recorded.points - (this.kept.get(key)?.recorded.points ?? 0)
    this.kept.delete(key)
    this.kept.set(key, kept)
    const wanted = new Set(this.queue.map((piece) => piece.key))
    for (const [old, { recorded }] of this.kept) {
      if (this.points <= (this.options.most ?? MOST_KEPT_POINTS)) break
      if (wanted.has(old)) continue
      this.kept.delete(old)
      this.points -= recorded.points
    }
  }
}
