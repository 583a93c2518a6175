/** Words about the twin of a robot; loaded with its layer, and with the page of a robot. */

import type { TwinBody, TwinForecastsBody } from './api-types'
import { duration, position } from './strings'

const centimetres = (metres: number): string => `${(metres * 100).toFixed(1)} cm`
const percent = (share: number): string => `${(share * 100).toFixed(0)} %`

/** Older than this it says how old it is, milliseconds. */
const OLD_MS = 3_000

type Fault = TwinBody['faults'][number]

const faults: Readonly<Record<string, string>> = {
  left_weak: 'Left motor weak',
  right_weak: 'Right motor weak',
  both_weak: 'Both motors weak, or the battery',
  slipping: 'Wheels slip',
  stuck: 'Stuck',
  tracker_wrong: 'Tracker errs',
  late: 'Messages come late',
}

function amount({ fault, amount: much }: Fault): string {
  if (fault === 'late') return `by ${much.toFixed(1)} s`
  if (fault === 'tracker_wrong') return `${much.toFixed(0)} jumps in half a minute`
  return `${percent(Math.min(1, much))} is missing`
}

export const words = {
  nobody: 'Twin: select a robot to see its twin.',
  asking: (robot: string) => `Looking for the twin of ${robot}…`,
  failed: (robot: string, why: string) => `No twin of ${robot}: ${why}.`,
  twin(robot: string, twin: TwinForecastsBody, now: number): string {
    const { pose, forecasts, errors, time } = twin
    const old = now - time > OLD_MS ? `, ${duration((now - time) / 1_000)} old` : ''
    const soon = forecasts[0]
    const ahead =
      soon === undefined
        ? ''
        : `; in 1 s at ${position(soon.pose.x, soon.pose.y)} ± ${centimetres(soon.pose.sigma)}`
    const off = errors[0]?.median
    const errs = off == null ? '' : `; off by ${centimetres(off)} of late`
    return `Twin of ${robot}: ${position(pose.x, pose.y)} ± ${centimetres(pose.sigma)}${old}${ahead}${errs}.`
  },
} as const

export const page = {
  title: 'Twin',
  none: (why: string) => `No twin: ${why}.`,
  body: 'Body',
  nominal: 'nominal: this robot was not calibrated',
  certificate: (id: string) => `certificate ${id}`,
  place: 'Where it is',
  speed: 'Speed, turning',
  gains: 'Wheels beside the body, left and right',
  fixes: 'Fixes',
  agree: (fixes: string, coverage: number) => `${fixes}, ${percent(coverage)} where expected`,
  wrong: 'Wrong with it',
  nothing: 'nothing found',
  stale: (since: string) =>
    `Its certificate does not hold any more: the wheels have drifted since ${since}. Calibrate it again.`,
  gap: 'How far it is from its body: reality gap',
  fault: (fault: Fault, since: string) =>
    `${faults[fault.fault] ?? fault.fault}: ${amount(fault)}, since ${since}`,
  sure: (place: string, sigma: number) => `${place} ± ${centimetres(sigma)}`,
  moving: (v: number, w: number) => `${v.toFixed(2)} m/s, ${w.toFixed(2)} rad/s`,
  gain: (left: number, right: number) => `${percent(left)}, ${percent(right)}`,
} as const
