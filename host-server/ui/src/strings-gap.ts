/** Words about the reality gap; loaded with its report. */

import type { Figure } from './twin/gap'

const centimetres = (metres: number): string => `${(metres * 100).toFixed(1)} cm`
const millimetres = (metres: number): string => `${(metres * 1_000).toFixed(2)} mm`
const percent = (share: number): string => `${(share * 100).toFixed(0)} %`
const of = (value: number | null, said: (value: number) => string): string =>
  value === null ? '–' : said(value)

export const words = {
  open: 'Reality gap',
  back: 'All robots, as a list',
  title: 'Reality gap: how far robots are from the bodies of their twins',
  about:
    'Predictions by the body of each twin, held against where its robot was then seen: medians. The floor is what a perfect copy of the robot would show, by the noise of the tracker; what is above it is gap. The worst robot stands first.',
  robot: 'Robot',
  ahead: (seconds: number) => `${String(seconds)} s ahead`,
  ratio: 'Beside nominal',
  within: 'Within 95 % region',
  displacements: 'Displacement in 2 s',
  distance: 'Energy distance between the displacements that were seen and those of the body',
  rests: 'Predictions',
  all: 'All robots',
  nominal: 'nominal body',
  certificate: (id: string) => `certificate ${id}`,
  none: 'No robot has a twin yet: no tracker has seen one.',
  few: 'too few',
  value: (figure: Figure | null) => of(figure?.own ?? null, centimetres),
  distanceOf: (figure: Figure | null) => of(figure?.own ?? null, millimetres),
  floor: (figure: Figure | null) =>
    figure === null ? words.few : `floor ${centimetres(figure.floor)}`,
  distanceFloor: (figure: Figure | null) =>
    figure === null ? words.few : `floor ${millimetres(figure.floor)}`,
  share: (share: number | null) => of(share, percent),
  counts: (counts: readonly number[]) => counts.map(String).join(', '),
  since: (time: string) => `since ${time}`,
} as const
