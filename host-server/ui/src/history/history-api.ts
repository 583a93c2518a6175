/** Calls of the page about the past. Each can be given up. */

import type { EventsBody, HistoryFrames, HistorySpan, TelemetryHistory } from '../api-types'
import type { Level } from '../feed/decode'
import type { Send } from '../http'
import { SLOW_MS, call } from '../http'
import type { Window } from './address'
import type { Piece } from './chunks'
import type { Recorded } from './record'
import { readFrames } from './record'

export interface EventsWanted extends Window {
  level: Level
  robot: string | null
  limit: number
  before: string | null
}

export interface HistoryApi {
  span(signal: AbortSignal): Promise<HistorySpan>
  frames(piece: Piece, signal: AbortSignal): Promise<Recorded>
  events(wanted: EventsWanted, signal: AbortSignal): Promise<EventsBody>
  telemetry(
    robot: string,
    span: Window & { step: number },
    signal: AbortSignal,
  ): Promise<TelemetryHistory>
}

export function historyApi(send: Send): HistoryApi {
  const ask = async <T>(path: string, signal: AbortSignal): Promise<T> => {
    const given: Send = (input, init) => {
      const late = init?.signal
      return send(input, { ...init, signal: late == null ? signal : either(signal, late) })
    }
    return (await call(given, 'GET', path, undefined, SLOW_MS)) as T
  }

  return {
    span: (signal) => ask('/history', signal),
    async frames({ asked, step }, signal) {
      const query = search({ from: Math.max(0, asked.from), to: asked.to, step })
      return readFrames(await ask<HistoryFrames>(`/history/frames?${query}`, signal))
    },
    events({ from, to, level, robot, limit, before }, signal) {
      const query = search({
        from,
        to,
        limit,
        ...(level === 'info' ? {} : { level }),
        ...(robot === null ? {} : { robot }),
        ...(before === null ? {} : { before }),
      })
      return ask(`/events?${query}`, signal)
    },
    telemetry: (robot, { from, to, step }, signal) =>
      ask(`/robots/${encodeURIComponent(robot)}/telemetry?${search({ from, to, step })}`, signal),
  }
}

function search(fields: Readonly<Record<string, number | string>>): string {
  const pairs = Object.entries(fields).map(
    ([name, value]) =>
      [name, typeof value === 'number' ? String(Math.round(value)) : value] as const,
  )
  return new URLSearchParams(pairs.map(([name, value]) => [name, value])).toString()
}

/** Aborts as soon as one of both does, with its reason. */
function either(a: AbortSignal, b: AbortSignal): AbortSignal {
  return AbortSignal.any([a, b])
}
