/** The calls for the twin of a robot. */

import type {
  CalibrationBody,
  CalibrationPermit,
  CalibrationsBody,
  FleetGapBody,
  NewCalibration,
  TwinBody,
  TwinForecastsBody,
} from '../api-types'
import { createClient } from '../client'
import type { Send } from '../http'

export interface TwinApi {
  twin(robot: string): Promise<TwinBody>
  forecast(robot: string): Promise<TwinForecastsBody>
  /** How far all robots are from the bodies of their twins. */
  gap(): Promise<FleetGapBody>
  /** Whether a robot may be calibrated where it stands, with so many metres free around it. */
  permit(robot: string, around: number | null): Promise<CalibrationPermit>
  calibrations(robot: string): Promise<CalibrationsBody>
  calibrate(robot: string, wanted: NewCalibration): Promise<CalibrationBody>
  stopCalibration(robot: string, number: number): Promise<unknown>
}

export function twinApi(send: Send): TwinApi {
  const ask = createClient(send)
  return {
    twin: (id) => ask('get', '/robots/{id}/twin', { path: { id } }),
    forecast: (id) => ask('get', '/robots/{id}/twin/forecast', { path: { id } }),
    gap: () => ask('get', '/fleet/gap'),
    permit: (id, around) =>
      ask('get', '/robots/{id}/twin/permit', { path: { id }, query: { around } }),
    calibrations: (id) => ask('get', '/robots/{id}/twin/calibrations', { path: { id } }),
    calibrate: (id, body) => ask('post', '/robots/{id}/twin/calibrations', { path: { id }, body }),
    stopCalibration: (id, number) =>
      ask('delete', '/robots/{id}/twin/calibrations/{number}', {
        path: { id, number: String(number) },
      }),
  }
}
