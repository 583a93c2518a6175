/** What went wrong with an account, in words. */

import { ApiError } from '../http'
import { words } from '../strings-account'

export function trouble(error: unknown): string {
  if (!(error instanceof ApiError)) return error instanceof Error ? error.message : String(error)
  switch (error.code) {
    case 'bad_credentials':
      return words.failure.bad_credentials
    case 'too_many_attempts':
    case 'rate_limited':
      return words.failure.too_many_attempts(error.retryAfter)
    case 'bad_invitation':
      return words.failure.invitation
    default:
      return error.detail ?? error.message
  }
}
