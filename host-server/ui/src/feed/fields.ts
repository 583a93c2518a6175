/** Reading JSON that nobody vouches for: what is not as expected is refused. */

/** Why a frame was refused. */
export type Refusal =
  | 'empty'
  | 'too-large'
  | 'unknown-kind'
  | 'truncated'
  | 'trailing-bytes'
  | 'not-utf8'
  | 'not-json'
  | 'bad-shape'

/** Carries a refusal out of nested readers; never leaves this folder. */
export class Refused extends Error {
  constructor(readonly reason: Refusal) {
    super(reason)
  }
}

export type Fields = Record<string, unknown>

export function object(value: unknown): Fields {
  if (typeof value !== 'object' || value === null || Array.isArray(value)) {
    throw new Refused('bad-shape')
  }
  return value as Fields
}

export function array(value: unknown): unknown[] {
  if (!Array.isArray(value)) throw new Refused('bad-shape')
  return value
}

export function string(value: unknown): string {
  if (typeof value !== 'string') throw new Refused('bad-shape')
  return value
}

export function number(value: unknown): number {
  if (typeof value !== 'number') throw new Refused('bad-shape')
  return finite(value)
}

export function finite(value: number): number {
  if (!Number.isFinite(value)) throw new Refused('bad-shape')
  return value
}

export function positive(value: unknown): number {
  const read = number(value)
  if (read <= 0) throw new Refused('bad-shape')
  return read
}

export function slot(value: unknown): number {
  const read = number(value)
  if (!Number.isInteger(read) || read < 0 || read > 0xffff) throw new Refused('bad-shape')
  return read
}

export function oneOf<const T extends readonly string[]>(allowed: T, value: unknown): T[number] {
  const found = allowed.find((item) => item === value)
  if (found === undefined) throw new Refused('bad-shape')
  return found
}
