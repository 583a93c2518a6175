/** What is written into the form of a new experiment, checked before it is sent. */

import type { Experiment, NewExperiment, NewTraining } from '../api-types'
import { repeatTraining } from './training'

/** In the order of the form: the first wrong one gets the focus. */
export const FIELDS = [
  'scenario',
  'seeds',
  'name',
  'robots',
  'first_seed',
  'difficulty',
  'randomisation',
  'thresholds',
  'set',
] as const
export type Field = (typeof FIELDS)[number]
/** Those that stand open in the form; the others are behind “more”. */
export const FIRST_FIELDS: readonly Field[] = ['scenario', 'seeds']

export type Draft = Record<Field, string> & { start: boolean }

export const LONGEST_NAME = 64
const MOST_SEEDS = 100_000
const MOST_LINES = { thresholds: 16, set: 32 } as const
const MOST_ROBOTS = 10_000
/** Somebody who has never seen it has a result within a minute. */
const USUAL_SEEDS = 20
const USUAL_SCENARIO = 'simple-navigation'
const USUAL_THRESHOLD = 'success>=0.9'

const THRESHOLD = /^[a-z][a-z0-9_]*\s*(>=|<=)\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i
const SETTING = /^[A-Za-z_][\w.[\]-]*\s*=\s*\S/

/** What is wrong with a field; words for it are elsewhere. `line` counts from 1. */
export type Wrong =
  | { why: 'missing' }
  | { why: 'long'; most: number }
  | { why: 'whole'; least: number; most: number }
  | { why: 'difficulty' }
  | { why: 'lines'; most: number }
  | { why: 'threshold' | 'setting'; line: number }

export type Wrongs = Partial<Record<Field, Wrong>>

/** `known` are the scenarios there are; empty when the server does not tell. */
export function usual(known: readonly string[] = []): Draft {
  const scenario = known.includes(USUAL_SCENARIO) ? USUAL_SCENARIO : (known[0] ?? USUAL_SCENARIO)
  return {
    scenario,
    seeds: String(USUAL_SEEDS),
    name: '',
    robots: '',
    first_seed: '1',
    difficulty: '',
    randomisation: '',
    thresholds: USUAL_THRESHOLD,
    set: '',
    start: true,
  }
}

/** The form filled in as an experiment was. */
export function draftOf(experiment: Experiment, name: string): Draft {
  return {
    scenario: experiment.scenario,
    seeds: String(experiment.seeds),
    name: name.slice(0, LONGEST_NAME),
    robots: String(experiment.robots),
    first_seed: String(experiment.first_seed),
    difficulty: experiment.difficulty ?? '',
    randomisation: experiment.randomisation ?? '',
    thresholds: experiment.thresholds.join('\n'),
    set: experiment.set.join('\n'),
    start: true,
  }
}

/** The same once more. */
export function repeat(experiment: Experiment): NewExperiment | NewTraining {
  if (experiment.kind === 'training') return repeatTraining(experiment)
  return bodyOf(draftOf(experiment, experiment.name), experiment.name)
}

export function check(draft: Draft): Wrongs {
  const wrongs: Wrongs = {}
  const put = (field: Field, wrong: Wrong | null): void => {
    if (wrong !== null) wrongs[field] = wrong
  }
  put('scenario', draft.scenario.trim() === '' ? { why: 'missing' } : null)
  put('seeds', whole(draft.seeds, 1, MOST_SEEDS))
  put('name', draft.name.trim().length > LONGEST_NAME ? { why: 'long', most: LONGEST_NAME } : null)
  put('robots', draft.robots.trim() === '' ? null : whole(draft.robots, 1, MOST_ROBOTS))
  put('first_seed', whole(draft.first_seed, 0, Number.MAX_SAFE_INTEGER - MOST_SEEDS))
  put('difficulty', difficulty(draft.difficulty.trim()))
  put('thresholds', listed(draft.thresholds, 'thresholds', THRESHOLD, 'threshold'))
  put('set', listed(draft.set, 'set', SETTING, 'setting'))
  return wrongs
}

export function firstWrong(wrongs: Partial<Record<Field, unknown>>): Field | null {
  return FIELDS.find((field) => wrongs[field] !== undefined) ?? null
}

/** What is sent; only of a draft with nothing wrong. `name` is for one without. */
export function bodyOf(draft: Draft, name: string): NewExperiment {
  const told = (text: string): string | null => (text.trim() === '' ? null : text.trim())
  const [robots, difficulty, randomisation] = [
    told(draft.robots),
    told(draft.difficulty),
    told(draft.randomisation),
  ]
  return {
    name: told(draft.name) ?? name.slice(0, LONGEST_NAME),
    scenario: draft.scenario.trim(),
    seeds: Number(draft.seeds),
    first_seed: Number(draft.first_seed),
    ...(robots === null ? {} : { robots: Number(robots) }),
    ...(difficulty === null ? {} : { difficulty }),
    ...(randomisation === null ? {} : { randomisation }),
    set: lines(draft.set),
    thresholds: lines(draft.thresholds),
    start: draft.start,
  }
}

/** The field that the pointer `/set/3` is about; `null` for one not in the form. */
export function fieldOf(pointer: string): Field | null {
  const name = /^\/([^/]+)/.exec(pointer)?.[1]
  return FIELDS.find((field) => field === name) ?? null
}

function lines(text: string): string[] {
  return text
    .split('\n')
    .map((line) => line.trim())
    .filter((line) => line !== '')
}

function whole(text: string, least: number, most: number): Wrong | null {
  const value = /^\d{1,16}$/.test(text.trim()) ? Number(text) : Number.NaN
  return value >= least && value <= most ? null : { why: 'whole', least, most }
}

function difficulty(text: string): Wrong | null {
  if (text === '') return null
  const number = Number(text)
  // Whether there is a level of that name the server knows.
  if (Number.isNaN(number)) return /^[\w -]{1,64}$/.test(text) ? null : { why: 'difficulty' }
  return number >= 0 && number <= 1 ? null : { why: 'difficulty' }
}

function listed(
  text: string,
  field: keyof typeof MOST_LINES,
  form: RegExp,
  why: 'threshold' | 'setting',
): Wrong | null {
  const most = MOST_LINES[field]
  if (lines(text).length > most) return { why: 'lines', most }
  const line = text.split('\n').findIndex((one) => one.trim() !== '' && !form.test(one.trim()))
  return line === -1 ? null : { why, line: line + 1 }
}
