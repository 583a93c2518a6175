/** Commands and errors, as they are told of. */

import type { Command } from '../api'

/** Whether somebody has yet to answer for good. */
export function isOpen(status: string | null): boolean {
  return status === null || status === 'pending' || status === 'accepted'
}

/** What a command is called in the log. */
export function named(command: Command): string {
  const behaviour = command.parameters?.['behaviour']
  return behaviour === undefined ? command.command : String(behaviour)
}

export function message(error: unknown): string {
  return error instanceof Error ? error.message : String(error)
}
