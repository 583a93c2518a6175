/** Which experiments are shown, and what can be done with one. */

import type { Experiment, ExperimentMetric } from '../api-types'
import { SUCCESS } from './trials'

export const SHOWN = ['all', 'active', 'completed', 'stopped', 'failed'] as const
export type Shown = (typeof SHOWN)[number]
/** What is asked of a server that has an experiment. */
export type Act = 'start' | 'pause' | 'resume' | 'stop'

/** Anything that its server may still change by itself. */
export function isActive({ state, waiting }: Pick<Experiment, 'state' | 'waiting'>): boolean {
  return state === 'running' || waiting === true
}

export function isOver({ state }: Pick<Experiment, 'state'>): boolean {
  return state === 'completed' || state === 'stopped' || state === 'failed'
}

/** In words that `states` of the strings has. */
export function stateOf({ state, waiting }: Pick<Experiment, 'state' | 'waiting'>): string {
  return waiting === true && (state === 'created' || state === 'running') ? 'waiting' : state
}

export function acts(experiment: Experiment): Act[] {
  switch (experiment.state) {
    case 'created':
      return experiment.waiting === true ? ['stop'] : ['start']
    case 'running':
      return ['pause', 'stop']
    case 'paused':
      return ['resume', 'stop']
    default:
      return []
  }
}

export function passes(experiment: Experiment, show: Shown, search: string): boolean {
  const { state } = experiment
  const fits =
    show === 'all' || (show === 'active' ? !isOver(experiment) : (state as string) === show)
  const wanted = search.trim().toLowerCase()
  const text = `${experiment.name} ${experiment.scenario} ${experiment.by}`.toLowerCase()
  return fits && (wanted === '' || text.includes(wanted))
}

/** Metrics that are drawn when nobody has chosen: success, and how long it takes. */
export function usualCurves(metrics: readonly ExperimentMetric[]): string[] {
  const time =
    metrics.find(({ name }) => /^(episode|ran|duration|length)/.test(name)) ??
    metrics.find(({ unit }) => unit === 's') ??
    metrics.find(({ name }) => name !== SUCCESS)
  return time === undefined ? [SUCCESS] : [SUCCESS, time.name]
}

/** Words of a shell, quoted where they must be. */
export function shell(words: readonly string[]): string {
  return words
    .map((word) =>
      /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", String.raw`'\''`)}'`,
    )
    .join(' ')
}

/** What opens one seed in the debugger. */
export function replayCommand(experiment: Experiment, seed: number): string {
  const option = (name: string, value: string | null | undefined): string[] =>
    value == null || value === '' ? [] : [`--${name}`, value]
  return shell([
    'terracrawler',
    'replay',
    ...option('scenario', experiment.scenario),
    ...option('robots', String(experiment.robots)),
    ...option('difficulty', experiment.difficulty),
    ...option('randomisation', experiment.randomisation),
    ...experiment.set.flatMap((pair) => option('set', pair)),
    ...option('seed', String(seed)),
  ])
}
