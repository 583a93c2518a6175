/** What can be broken about a robot, and which numbers that takes. */

import type { SimulatorCommand } from '../api-types'

export type FaultSpec = Extract<SimulatorCommand, { command: 'inject' }>['fault']
export type FaultName = FaultSpec['fault']

interface NumberField {
  name: string
  words: string
  least: number
  most: number
  usual: number
  whole: boolean
}

interface FaultForm {
  words: string
  number?: NumberField
  wheel?: true
}

const share = (name: string, words: string, usual: number): NumberField => ({
  name,
  words,
  least: 0,
  most: 1,
  usual,
  whole: false,
})
const whole = (
  name: string,
  words: string,
  least: number,
  most: number,
  usual: number,
): NumberField => ({ name, words, least, most, usual, whole: true })

/** Every fault there is: one that the server knows and this does not is an error of types. */
export const FAULTS: Record<FaultName, FaultForm> = {
  'ranger-dead': { words: 'Ranger: dead' },
  'ranger-stuck': {
    words: 'Ranger: stuck at a distance',
    number: whole('mm', 'Distance in mm', 0, 65_535, 300),
  },
  'ranger-noisy': {
    words: 'Ranger: noisy',
    number: whole('mm', 'Standard deviation in mm', 0, 1_000, 100),
  },
  'line-noise': {
    words: 'Ranger line: bits flip',
    number: share('flips', 'Share of bits, 0 to 1', 0.01),
  },
  'line-stuck': { words: 'Ranger line: hangs' },
  'motor-weak': {
    words: 'Motor: weak',
    wheel: true,
    number: share('strength', 'What is left of it, 0 to 1', 0.5),
  },
  'motor-dead': { words: 'Motor: dead', wheel: true },
  'motor-stuck-on': { words: 'Motor: cannot be switched off', wheel: true },
  'link-loss': { words: 'Link: lost' },
  'hostile-packets': {
    words: 'Link: hostile packets',
    number: whole('per_s', 'Packets a second', 1, 200, 20),
  },
  'clock-step': {
    words: 'Clock: jumps',
    number: whole('ms', 'By how many ms', -315_360_000_000, 315_360_000_000, 5_000),
  },
  'brown-out': { words: 'Supply: dips' },
  'battery-sag': {
    words: 'Battery: sags',
    number: { name: 'ohm', words: 'Ohms added', least: 0, most: 1_000, usual: 1, whole: false },
  },
  'battery-at': {
    words: 'Battery: at this charge',
    number: share('charge', 'Share of the capacity, 0 to 1', 0.1),
  },
  'flash-power-cut': {
    words: 'Flash: power goes while writing',
    number: whole('after_bytes', 'Bytes until then', 0, 4_294_967_295, 64),
  },
  'flash-noise': {
    words: 'Flash: full of noise',
    number: whole('seed', 'Seed of the noise', 0, 4_294_967_295, 1),
  },
  'camera-absent': { words: 'Camera: unplugged' },
  'camera-stalled': { words: 'Camera: stalled' },
  'camera-garbage': { words: 'Camera: delivers noise' },
}

export const FAULT_NAMES = Object.keys(FAULTS) as FaultName[]

/** `null` when the number is none, or out of its range. */
export function specOf(
  fault: FaultName,
  number: string,
  wheel: 'left' | 'right',
): FaultSpec | null {
  const form = FAULTS[fault]
  const spec: Record<string, unknown> = { fault }
  if (form.number !== undefined) {
    const { name, least, most, whole: integral } = form.number
    const value = Number(number.trim().replace(',', '.').replace('−', '-'))
    const good = number.trim() !== '' && Number.isFinite(value) && value >= least && value <= most
    if (!good || (integral && !Number.isInteger(value))) return null
    spec[name] = value
  }
  if (form.wheel === true) spec['wheel'] = wheel
  // Its fields are those of the form, which the test compares with the schema.
  return spec as unknown as FaultSpec
}
