/**
 * The calls of the HTTP interface, each with the parameters, the body and the answer that the
 * server's own description says: a path, a name or a field that it does not know does not compile.
 */

import type { paths } from './.generated/interface'
import type { Send } from './http'
import { QUICK_MS, SLOW_MS, call } from './http'

type Paths = { [P in keyof paths as P extends `/api/v1${infer Rest}` ? Rest : never]: paths[P] }
type Method = 'get' | 'post' | 'put' | 'patch' | 'delete'
/** Paths that a method can be asked of. */
type PathOf<M extends Method> = {
  [P in keyof Paths]: Paths[P] extends Record<M, object> ? P : never
}[keyof Paths]
type Operation<M extends Method, P extends PathOf<M>> =
  Paths[P] extends Record<M, infer O> ? O : never

type InPath<O> = O extends { parameters: { path: infer V } } ? { path: V } : unknown
type InQuery<O> = O extends { parameters: { query?: infer V } }
  ? // What is `null` is left out.
    { query?: { [K in keyof V]: V[K] | null } }
  : unknown
type InBody<O> = O extends { requestBody: { content: { 'application/json': infer V } } }
  ? { body: V }
  : unknown
type Given<O> = InPath<O> & InQuery<O> & InBody<O>

/** Statuses of good answers. */
type Good = 200 | 201 | 202
type Answer<O> = O extends { responses: infer R }
  ? R[keyof R & Good] extends { content: { 'application/json': infer V } }
    ? V
    : unknown
  : never

interface Manner {
  milliseconds?: number
  /** Gives up as soon as this does. */
  signal?: AbortSignal
}

export type Client = <M extends Method, P extends PathOf<M>>(
  method: M,
  path: P,
  ...given: object extends Given<Operation<M, P>>
    ? [given?: Given<Operation<M, P>>, manner?: Manner]
    : [given: Given<Operation<M, P>>, manner?: Manner]
) => Promise<Answer<Operation<M, P>>>

/** What every call is given, whatever its type. */
interface Anything {
  path?: Readonly<Record<string, string>>
  query?: Readonly<Record<string, string | number | boolean | null | undefined>>
  body?: unknown
}

/** Calls that may take so long each, unless one says otherwise. */
export function createClient(send: Send, usual: number = SLOW_MS): Client {
  const ask = (method: string, path: string, given: Anything = {}, manner: Manner = {}) => {
    const { milliseconds = usual, signal } = manner
    const through: Send =
      signal === undefined
        ? send
        : (input, init) => send(input, { ...init, signal: either(signal, init?.signal) })
    return call(through, method.toUpperCase(), addressOf(path, given), given.body, milliseconds)
  }
  // A test of the server holds what it says of itself to what it does.
  return ask as Client
}

/** Calls that a lock or a look-up answers. */
export const quickClient = (send: Send): Client => createClient(send, QUICK_MS)

/** A path with its parameters in it. */
function addressOf(path: string, { path: names = {}, query = {} }: Anything): string {
  const filled = path.replace(/\{(\w+)\}/g, (_, name: string) => {
    return encodeURIComponent(names[name] ?? '')
  })
  const search = new URLSearchParams()
  for (const [name, value] of Object.entries(query)) {
    if (value !== null && value !== undefined) search.set(name, String(value))
  }
  return search.size === 0 ? filled : `${filled}?${search.toString()}`
}

/** Aborts as soon as one of both does, with its reason. */
function either(a: AbortSignal, b: AbortSignal | null | undefined): AbortSignal {
  return b == null ? a : AbortSignal.any([a, b])
}
