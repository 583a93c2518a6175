/** Two to four experiments, side by side. */

import type { Experiment, ExperimentMetric, ExperimentSummary } from '../api-types'
import { overlap } from './statistics'

export const LEAST_COMPARED = 2
export const MOST_COMPARED = 4

/** How one stands to the first. */
export type Standing = 'same' | 'better' | 'worse' | 'other'

interface Cell {
  told: ExperimentSummary
  /** To the mean of the first; `null` for the first itself, or where that has none. */
  difference: number | null
  /** Whether the intervals overlap. */
  overlaps: boolean | null
  standing: Standing | null
}

export interface Row {
  metric: string
  unit: string
  /** One for each experiment, `null` where it has no such metric. */
  cells: (Cell | null)[]
}

/** From the address; an id stands once. */
export function compared(ids: string): string[] {
  return [...new Set(ids.split(',').filter((id) => id !== ''))].slice(0, MOST_COMPARED)
}

/** With one more, or without it. One too many is not taken. */
export function toggled(ids: readonly string[], id: string): string[] {
  if (ids.includes(id)) return ids.filter((one) => one !== id)
  return ids.length < MOST_COMPARED ? [...ids, id] : [...ids]
}

/** All metrics of any of them, in the order in which they are first told. */
export function rows(
  experiments: readonly Pick<Experiment, 'summary'>[],
  better: ReadonlyMap<string, ExperimentMetric['better']>,
): Row[] {
  const units = new Map<string, string>()
  for (const { summary } of experiments) {
    for (const { metric, unit } of summary) if (!units.has(metric)) units.set(metric, unit)
  }
  return [...units].map(([metric, unit]) => {
    const told = experiments.map(({ summary }) => summary.find((one) => one.metric === metric))
    const [first] = told
    const cells = told.map((one, at) =>
      one === undefined ? null : cell(one, at === 0 ? undefined : first, better.get(metric)),
    )
    return { metric, unit, cells }
  })
}

function cell(
  told: ExperimentSummary,
  first: ExperimentSummary | undefined,
  better: ExperimentMetric['better'] | undefined,
): Cell {
  if (first === undefined) return { told, difference: null, overlaps: null, standing: null }
  const difference = told.mean - first.mean
  const overlaps = overlap(told, first)
  if (overlaps) return { told, difference, overlaps, standing: 'same' }
  const more = difference > 0
  const standing =
    better === 'more' || better === 'less'
      ? more === (better === 'more')
        ? 'better'
        : 'worse'
      : 'other'
  return { told, difference, overlaps, standing }
}

/** Settings in which they differ: what the difference of the results may come from. */
const SETTINGS = [
  'scenario',
  'robots',
  'seeds',
  'first_seed',
  'difficulty',
  'randomisation',
  'set',
] as const
/** The same of trainings. */
const OF_TRAININGS = ['steps', 'worlds', 'units', 'own_critic'] as const
export type Setting = (typeof SETTINGS)[number] | (typeof OF_TRAININGS)[number]

export function differing(
  experiments: readonly Experiment[],
): { setting: Setting; values: (string | null)[] }[] {
  return [...SETTINGS, ...OF_TRAININGS].flatMap((setting) => {
    const values = experiments.map((one) => {
      const value =
        (setting in one
          ? one[setting as (typeof SETTINGS)[number]]
          : one.training?.[setting as (typeof OF_TRAININGS)[number]]) ?? null
      const text = Array.isArray(value) ? value.join(', ') : value === null ? null : String(value)
      return text === '' ? null : text
    })
    return new Set(values).size > 1 ? [{ setting, values }] : []
  })
}
