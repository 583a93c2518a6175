/** One way to call the HTTP interface, and its errors as the server words them. */

/** A part of a request that the server does not take. */
export interface WrongPart {
  /** JSON pointer into the body; empty for all of it, `null` for a parameter of the query. */
  readonly pointer: string | null
  /** Name of the parameter of the query. */
  readonly parameter: string | null
  readonly detail: string
}

/** What went wrong, in words that can be shown. */
export class ApiError extends Error {
  constructor(
    message: string,
    /** HTTP status; 0 when the server was not reached. */
    readonly status: number,
    /** What is wrong, for programs; `null` without a problem document. */
    readonly code: string | null = null,
    /** Seconds to wait before the next try, where the server named them. */
    readonly retryAfter: number | null = null,
    /** What is wrong with this request; `null` without a problem document. */
    readonly detail: string | null = null,
    /** The whole problem document, or whatever came in its place. */
    readonly problem: unknown = null,
  ) {
    super(message)
  }

  /** The parts of the request that are wrong, where the server tells them apart. */
  get parts(): readonly WrongPart[] {
    const errors = fields(this.problem)['errors']
    if (!Array.isArray(errors)) return []
    return errors.flatMap((one: unknown) => {
      const told = fields(one)
      const detail = text(told['detail'])
      const pointer = typeof told['pointer'] === 'string' ? told['pointer'] : null
      return detail === null ? [] : [{ pointer, parameter: text(told['parameter']), detail }]
    })
  }
}

/** What the server says of a part of the body, or of a part of that; `null` when it says nothing. */
export function wrongAt(error: unknown, pointer: string): string | null {
  if (!(error instanceof ApiError)) return null
  const told = error.parts
    .filter((part) => part.pointer === pointer || part.pointer?.startsWith(`${pointer}/`))
    .map(({ detail }) => detail)
  return told.length === 0 ? null : told.join('; ')
}

const BASE = '/api/v1'
/** Time for what a lock or a look-up answers. */
export const QUICK_MS = 2_000
/** Time for what hashes a password or reads many records. */
export const SLOW_MS = 15_000

export type Send = typeof fetch

/** A file goes as it is, anything else as JSON. */
const isFile = (body: unknown): body is Blob => body instanceof Blob

/** Sends a request and gives the answer, whatever its status; throws only when there is none. */
export async function request(
  send: Send,
  method: string,
  path: string,
  body?: unknown,
  milliseconds = QUICK_MS,
): Promise<Response> {
  try {
    return await send(BASE + path, {
      method,
      headers:
        body === undefined
          ? {}
          : { 'content-type': isFile(body) ? 'application/octet-stream' : 'application/json' },
      ...(body === undefined ? {} : { body: isFile(body) ? body : JSON.stringify(body) }),
      // A stop sent while the page goes away must still leave the machine, and
      // the answer to a refresh must still reach the browser's cookies. Browsers
      // let no more than 64 KiB go so.
      keepalive: method === 'POST' && !isFile(body),
      cache: 'no-store',
      signal: AbortSignal.timeout(milliseconds),
    })
  } catch (error) {
    const late = error instanceof DOMException && error.name === 'TimeoutError'
    throw new ApiError(
      late ? 'the server did not answer in time' : 'the server cannot be reached',
      0,
    )
  }
}

/** The body of a good answer; a bad one is thrown. */
export async function payloadOf(response: Response): Promise<unknown> {
  const payload: unknown = await response.json().catch(() => null)
  if (!response.ok) throw failure(response, payload)
  return payload
}

/** For the calls of `client.ts`, which know what each takes and gives. */
export async function call(
  send: Send,
  method: string,
  path: string,
  body?: unknown,
  milliseconds = QUICK_MS,
): Promise<unknown> {
  return payloadOf(await request(send, method, path, body, milliseconds))
}

function failure(response: Response, payload: unknown): ApiError {
  const wait = Number(response.headers.get('retry-after') ?? Number.NaN)
  return new ApiError(
    problemText(payload, response.status),
    response.status,
    text(fields(payload)['code']),
    Number.isFinite(wait) && wait >= 0 ? Math.ceil(wait) : null,
    text(fields(payload)['detail']),
    payload,
  )
}

/** Words of an RFC 9457 problem document, or the bare status without one. */
export function problemText(payload: unknown, status: number): string {
  const body = fields(payload)
  const words = [text(body['title']), text(body['detail'])].filter((part) => part !== null)
  return words.length > 0 ? words.join(': ') : `the server answered ${String(status)}`
}

export function fields(value: unknown): Record<string, unknown> {
  return typeof value === 'object' && value !== null ? (value as Record<string, unknown>) : {}
}

/** The fields of a body that should be one of these, none of which can be relied on. */
export function told<T>(value: unknown): { readonly [K in keyof T]?: unknown } {
  return fields(value) as { readonly [K in keyof T]?: unknown }
}

export function text(value: unknown): string | null {
  return typeof value === 'string' && value !== '' ? value : null
}

export function numeric(value: unknown): number | null {
  return typeof value === 'number' && Number.isFinite(value) ? value : null
}
