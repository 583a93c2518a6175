/** What releases are worth, without a page. */

import type { Release, ReleaseFault } from '../api-types'
import { ApiError, fields, text } from '../http'

/** Whether robots can be given a release: not any more, once it was withdrawn or has expired. */
export type Standing = 'good' | 'expired' | 'withdrawn'

export function standing(
  release: Pick<Release, 'withdrawn' | 'expires_at'>,
  now: number,
): Standing {
  if (release.withdrawn != null) return 'withdrawn'
  const ends = release.expires_at ?? null
  return ends !== null && ends <= now ? 'expired' : 'good'
}

/** What a report says that a release was tried on; none where there is no report. */
export type Gate = 'passed' | 'failed' | 'none'

export function gateOf({ gate }: Pick<Release, 'gate'>): Gate {
  if (gate == null) return 'none'
  // Whatever else a newer server says, it is no pass.
  return gate === 'passed' ? 'passed' : 'failed'
}

/** Most bytes of a file: head, manifest and image (`crawler_updates::release::FILE_MAX`). */
export const LARGEST_FILE = 2 + 1_024 + 4_718_592

/** Longest reason for withdrawing, in bytes. */
const LONGEST_REASON = 512

export function isReason(reason: string): boolean {
  const bytes = new TextEncoder().encode(reason.trim()).length
  return bytes > 0 && bytes <= LONGEST_REASON
}

/** Every reason that the server has against a file; none where it was something else. */
export function faultsOf(error: unknown): readonly ReleaseFault[] {
  const listed = error instanceof ApiError ? fields(error.problem)['faults'] : null
  if (!Array.isArray(listed)) return []
  return listed.flatMap((item) => {
    const [code, told] = [text(fields(item)['code']), text(fields(item)['text'])]
    return code === null || told === null ? [] : [{ code, text: told }]
  })
}
