/** Looking at, comparing and changing the parameters of a robot. */

import type { ParametersBody } from '../api-types'

export type Parameter = ParametersBody['parameters'][number]
export type Value = number | string | boolean

export const valueOf = (value: unknown): Value | null =>
  typeof value === 'number' || typeof value === 'string' || typeof value === 'boolean'
    ? value
    : null

/** Numbers come as 32-bit floats: `0.1` may be `0.10000000149`. */
export function same(a: Value | null, b: Value | null): boolean {
  if (typeof a === 'number' && typeof b === 'number') return Math.fround(a) === Math.fround(b)
  return a === b
}

export function write(value: Value | null): string {
  if (value === null) return ''
  if (typeof value !== 'number') return String(value)
  return String(Number(value.toPrecision(7)))
}

export type Read = { ok: true; value: Value } | { ok: false; why: 'number' | 'low' | 'high' }

/** What somebody typed, as the kind of value that the parameter is. */
export function read(text: string, parameter: Parameter): Read {
  const now = valueOf(parameter.value)
  if (typeof now === 'string') return { ok: true, value: text }
  if (typeof now === 'boolean') return { ok: true, value: text === 'true' }
  // A comma is what half the world writes.
  const value = Number(text.trim().replace(',', '.').replace('−', '-'))
  if (text.trim() === '' || !Number.isFinite(value)) return { ok: false, why: 'number' }
  if (parameter.min != null && value < parameter.min) return { ok: false, why: 'low' }
  if (parameter.max != null && value > parameter.max) return { ok: false, why: 'high' }
  return { ok: true, value }
}

/** Values of this robot that another one has otherwise, by name. */
export function differences(
  mine: readonly Parameter[],
  others: readonly Parameter[],
): Map<string, Value | null> {
  const theirs = new Map(others.map(({ name, value }) => [name, valueOf(value)]))
  const found = new Map<string, Value | null>()
  for (const { name, value } of mine) {
    const other = theirs.get(name) ?? null
    if (!same(valueOf(value), other)) found.set(name, other)
  }
  return found
}

/** A robot takes so many at a time. */
export const MOST_AT_ONCE = 8
/** These belong to one body: its name, and what makes it drive straight. */
const OWN: ReadonlySet<string> = new Set(['name', 'trim_left', 'trim_right'])

/** As many sets of values as it takes. */
export function batches(values: Readonly<Record<string, Value>>): Record<string, Value>[] {
  const all = Object.entries(values)
  return Array.from({ length: Math.ceil(all.length / MOST_AT_ONCE) }, (_, at) =>
    Object.fromEntries(all.slice(at * MOST_AT_ONCE, (at + 1) * MOST_AT_ONCE)),
  )
}

/** What other robots may be given of this one's. */
export function shareable(parameters: readonly Parameter[]): Record<string, Value> {
  const found: Record<string, Value> = {}
  for (const { name, value } of parameters) {
    const known = valueOf(value)
    if (known !== null && !OWN.has(name)) found[name] = known
  }
  return found
}

/** For a file: names and values, nothing that the robot would not take. */
export function exported(robot: string, parameters: readonly Parameter[]): string {
  const values = Object.fromEntries(
    parameters.map(({ name, value }) => {
      const known = valueOf(value)
      return [name, typeof known === 'number' ? Number(write(known)) : known]
    }),
  )
  return `${JSON.stringify({ robot, parameters: values }, null, 2)}\n`
}
