/** The call for the map of a robot. */

import type { MapBody } from '../api-types'
import { createClient } from '../client'
import type { Send } from '../http'

export interface MapApi {
  map(robot: string): Promise<MapBody>
}

export function mapApi(send: Send): MapApi {
  const ask = createClient(send)
  return { map: (id) => ask('get', '/robots/{id}/map', { path: { id } }) }
}
