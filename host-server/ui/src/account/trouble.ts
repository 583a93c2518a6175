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
      return withParts(error)
  }
}

/** What went wrong, and where, as far as the words do not say so already. */
function withParts(error: ApiError): string {
  const told = error.detail ?? error.message
  const parts = error.parts
    .map(({ pointer, parameter, detail }) => ({ at: pointer ?? parameter ?? '', detail }))
    .filter(({ at, detail }) => at !== '' && !(told.includes(detail) && told.includes(at)))
    .map(({ at, detail }) => (told === detail ? at : `${at} ${detail}`))
  return parts.length === 0 ? told : `${told} (${parts.join('; ')})`
}
