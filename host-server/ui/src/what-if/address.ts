/** Which time of both worlds is looked at, as it stands in the address. */

import type { Query } from '../view'

/** Milliseconds after the moment; `null` for the end, which is seen first. Never throws: a link may be cut off anywhere. */
export function afterOf(query: Query): number | null {
  const text = query['after'] ?? ''
  const after = Number(text)
  return text !== '' && Number.isSafeInteger(after) && after >= 0 ? after : null
}

/** The part of the address that says so. */
export function queryOfAfter(after: number | null): Query {
  return { after: after === null ? '' : String(after) }
}
