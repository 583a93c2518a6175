/**
 * Emergency stop of the whole fleet. It latches: once pressed it stands until
 * someone re-arms it, and while it stands the command is sent again and again
 * until the server has taken it.
 */

import type { Command } from '../api'
import { ApiError } from '../http'
import { words as account } from '../strings-account'

export type StopState =
  /** Robots may move. */
  | 'armed'
  /** Pressed; the server has not taken the command yet. */
  | 'sending'
  /** Pressed, and the server has taken it. */
  | 'stopped'
  /** Re-arming was asked for; no answer yet. */
  | 'rearming'

interface StopOptions {
  /** Resolves with the command's id, if the server gave one. */
  send(command: Command): Promise<string | null>
  onChange(state: StopState, error: string | null): void
  /** The server has taken a stop: what it comes to can be asked for. */
  onTaken(commandId: string | null): void
}

const FIRST_RETRY_MS = 250
const LONGEST_RETRY_MS = 2_000

export class EmergencyStop {
  private current: StopState = 'armed'
  private retry: ReturnType<typeof setTimeout> | null = null
  private delay = FIRST_RETRY_MS
  /** Rises with every press, so that answers to earlier ones change nothing. */
  private press = 0

  constructor(private readonly options: StopOptions) {}

  get state(): StopState {
    return this.current
  }

  get latched(): boolean {
    return this.current !== 'armed'
  }

  /** Stops everything; a second press sends the command again. */
  trigger(): void {
    this.press += 1
    this.delay = FIRST_RETRY_MS
    // On its way before anything else happens.
    this.deliver(this.press)
    this.set('sending', null)
  }

  /** Someone else stopped the fleet: show it, so that it can be re-armed here. */
  adopt(): void {
    if (this.current === 'armed') this.set('stopped', null)
  }

  /** Lifts the stop. Robots stay where they are until told otherwise. */
  async rearm(): Promise<boolean> {
    if (this.current !== 'stopped') return false
    this.press += 1
    const press = this.press
    this.set('rearming', null)
    try {
      await this.options.send({ command: 'reset' })
    } catch (error) {
      if (press === this.press) this.set('stopped', words(error))
      return false
    }
    if (press !== this.press) return false
    this.set('armed', null)
    return true
  }

  /** Forgets what was not delivered: the one who pressed has left. */
  cancel(): void {
    this.press += 1
    if (this.retry !== null) clearTimeout(this.retry)
    this.retry = null
  }

  private deliver(press: number): void {
    if (this.retry !== null) clearTimeout(this.retry)
    this.retry = null
    this.options.send({ command: 'estop' }).then(
      (commandId) => {
        if (press !== this.press) return
        this.set('stopped', null)
        this.options.onTaken(commandId)
      },
      (error: unknown) => {
        if (press !== this.press) return
        // Sent again it would be refused again: better to say so than to seem to stop.
        if (error instanceof ApiError && error.status === 403) {
          this.set('armed', account.need.stopRefused)
          return
        }
        this.set('sending', words(error))
        this.retry = setTimeout(() => this.deliver(press), this.delay)
        this.delay = Math.min(LONGEST_RETRY_MS, this.delay * 2)
      },
    )
  }

  private set(state: StopState, error: string | null): void {
    this.current = state
    this.options.onChange(state, error)
  }
}

function words(error: unknown): string {
  return error instanceof Error ? error.message : String(error)
}
