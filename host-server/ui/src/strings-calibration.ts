/** Words about calibrations of robots where they stand; loaded with the pages that have them. */

import type { CalibrationBody, CalibrationPermit } from './api-types'
import { position } from './strings'

const centimetres = (metres: number): string => `${(metres * 100).toFixed(1)} cm`

const steps: Readonly<Record<string, string>> = {
  preparing: 'Permitted; telemetry gets quicker',
  baseline: 'Drives what is identified on',
  held_out: 'Drives what is held out to validate on',
  identifying: 'A body is identified, adjusted and validated',
  certified: 'Certified',
  refused: 'No certificate',
  broken_off: 'Broken off',
}

/** The five steps, and in which state each is under way. */
export const FIVE = [
  { name: 'Permit', states: ['preparing'] },
  { name: 'Baseline', states: ['baseline'] },
  { name: 'Held-out drive', states: ['held_out'] },
  { name: 'Identify, adjust', states: ['identifying'] },
  { name: 'Validate', states: ['certified', 'refused'] },
] as const

export const words = {
  title: 'Calibrate',
  about:
    'The robot drives to and fro and in curves where it stands, while this server watches it. What comes of it is a certificate of its body, if a part of the drive that was held out proves it.',
  open: 'Calibrate…',
  look: 'Look again',
  asking: 'Looking whether it may…',
  failed: (why: string) => `That did not work: ${why}.`,
  wouldTake: ({ seconds, size }: CalibrationPermit): string => {
    const sides = (size ?? []).map((side) => side.toFixed(1)).join(' × ')
    const floor = sides === '' ? '' : ` on ${sides} m`
    return `It takes ${seconds.toFixed(0)} s${floor}, and half a second of this server at the end.`
  },
  may: 'It may begin here.',
  mayNot: (refused: NonNullable<CalibrationPermit['refused']>): string => {
    const at = refused.at == null ? '' : ` (at ${position(refused.at[0] ?? 0, refused.at[1] ?? 0)})`
    return `It may not begin: ${refused.detail}${at}.`
  },
  outline: 'Floor that the drive may take',
  around: 'Metres free around it',
  aroundHint: 'where no fence says it',
  floor: 'Floor, in words',
  begin: 'Begin',
  question: (robot: string) =>
    `Is the floor around ${robot} free, and nobody within a metre of it? It drives at once.`,
  act: 'It is free: calibrate',
  stop: 'Stop the calibration',
  state: (state: string) => steps[state] ?? state,
  progress: (done: number, all: number) => `Leg ${String(done)} of ${String(all)}`,
  steps: 'Steps',
  before: 'Earlier calibrations',
  none: 'This robot was not calibrated by this server yet.',
  errors: '10 s ahead on the held-out drive, half of the predictions were off by less than:',
  own: 'new body',
  nominal: 'nominal body',
  previous: 'certificate before',
  centimetres,
  result(one: CalibrationBody): string {
    const why = one.reason
    if (why != null) return `${words.state(one.state)}: ${why.detail}`
    return one.certificate == null
      ? words.state(one.state)
      : `${words.state(one.state)}: ${one.certificate}`
  },
  line(one: CalibrationBody): string {
    const when = new Date(one.begun).toLocaleString()
    return `${when}, by ${one.by}: ${words.result(one)}`
  },
  several: (count: number) => `Calibrate ${String(count)} robots…`,
  severalTitle: 'Calibrate several robots',
  severalAbout:
    'One after the other; those that are clear of each other drive at the same time. Keep this page open: it begins the next.',
  severalQuestion: (count: number) =>
    `Is the floor around all ${String(count)} robots free, and nobody within a metre of them? They drive as soon as it is their turn.`,
  waits: 'Waits for its turn',
  stoppedTurn: 'stopped before its turn',
  openSeveral: 'Calibrate…',
  queue: 'Robots',
  stopAll: 'Stop all',
} as const
