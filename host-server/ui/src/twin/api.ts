/** The calls for the twin of a robot. */

import type { TwinBody, TwinForecastsBody } from '../api-types'
import { createClient } from '../client'
import type { Send } from '../http'

export interface TwinApi {
  twin(robot: string): Promise<TwinBody>
  forecast(robot: string): Promise<TwinForecastsBody>
}

export function twinApi(send: Send): TwinApi {
  const ask = createClient(send)
  return {
    twin: (id) => ask('get', '/robots/{id}/twin', { path: { id } }),
    forecast: (id) => ask('get', '/robots/{id}/twin/forecast', { path: { id } }),
  }
}
