/** Calls of the page about the past. Each can be given up. */

import type { EventsBody, HistorySpan, TelemetryHistory } from '../api-types'
import type { Level } from '../feed/decode'
import { createClient } from '../client'
import type { Send } from '../http'
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
  const ask = createClient(send)

  return {
    span: (signal) => ask('get', '/history', {}, { signal }),
    async frames({ asked, step }, signal) {
      const query = rounded({ from: Math.max(0, asked.from), to: asked.to, step })
      return readFrames(await ask('get', '/history/frames', { query }, { signal }))
    },
    events({ from, to, level, robot, limit, before }, signal) {
      const query = {
        ...rounded({ from, to, limit }),
        level: level === 'info' ? null : level,
        robot,
        before,
      }
      return ask('get', '/events', { query }, { signal })
    },
    telemetry: (id, { from, to, step }, signal) =>
      ask(
        'get',
        '/robots/{id}/telemetry',
        { path: { id }, query: rounded({ from, to, step }) },
        { signal },
      ),
  }
}

/** The server takes whole milliseconds. */
function rounded<K extends string>(numbers: Record<K, number>): Record<K, number> {
  const pairs = Object.entries<number>(numbers).map(([name, value]) => [name, Math.round(value)])
  return Object.fromEntries(pairs) as Record<K, number>
}
