/** In which pieces the record is asked for: aligned, so that they are found again, and never too large. */

import { TRAIL, TRAIL_EVERY_MS } from '../arena/trails'
import type { Speed, Window } from './address'

/** What the server gives in one answer at most. */
export const MOST_POINTS = 600
export const MOST_ALL = 600_000
/** What is aimed at: so much comes and is read before anybody waits for it. */
const AIM = 100_000
const USUAL_POINTS = 300
const LEAST_POINTS = 10
/** Each piece begins so much earlier than what it is for: trails, and what a gap came after. */
const LEAD_MS = TRAIL * TRAIL_EVERY_MS
/** And ends so many steps later: what is blended with is in it. */
const TAIL_STEPS = 2
/** While playing, so much of the time to come is there already, by the clock on the wall. */
const AHEAD_MS = 12_000
const MOST_AHEAD = 3

/**
 * Milliseconds between points, by how fast time passes: a picture shows no more. A point is told as of
 * the beginning of its step, so at ordinary speed that is as short as it may be: robots tell where they
 * are every 200 ms or less often, and this gives no more points, but better times.
 */
const STEPS: Readonly<Record<Speed, number>> = { 1: 100, 2: 100, 5: 200, 10: 500, 60: 2_000 }
/** Coarser for many robots: from more than so many on, at least so many milliseconds. */
const COARSER = [
  [2_000, 1_000],
  [500, 500],
  [150, 200],
] as const

export interface Layout {
  step: number
  /** Points of a piece, without those before and behind it. */
  points: number
}

export interface Piece {
  key: string
  /** What it is for. */
  from: number
  to: number
  step: number
  /** What is asked for. */
  asked: Window
}

/** `shrink` halves pieces that the server found too large. */
export function layoutFor(robots: number, speed: Speed, shrink = 0): Layout {
  const many = Math.max(1, robots)
  const [, least] = COARSER.find(([more]) => many > more) ?? [0, 0]
  const step = Math.max(STEPS[speed], least)
  const beside = LEAD_MS / step + TAIL_STEPS
  const most = Math.min(MOST_POINTS, Math.floor(MOST_ALL / many)) - beside
  const aim = Math.min(USUAL_POINTS, Math.floor(AIM / many) - beside)
  const points = Math.max(LEAST_POINTS, aim) / 2 ** shrink
  return { step, points: Math.max(1, Math.floor(Math.min(most, points))) }
}

export function pieceAt({ step, points }: Layout, time: number): Piece {
  const length = step * points
  const from = Math.floor(time / length) * length
  const to = from + length
  return {
    key: `${String(step)} ${String(from)} ${String(length)}`,
    from,
    to,
    step,
    asked: { from: from - LEAD_MS, to: to + TAIL_STEPS * step },
  }
}

/** The piece before: what a robot told last may be in there. */
export function pieceBefore(layout: Layout, time: number): Piece {
  return pieceAt(layout, pieceAt(layout, time).from - 1)
}

/**
 * Pieces that are needed, the most urgent first. `speed` is 0 while nothing plays. The one before comes
 * last: in it are the last words of those who say nothing in this one.
 */
export function wanted(layout: Layout, at: number, speed: number, window: Window): Piece[] {
  const found = [pieceAt(layout, at)]
  const until = Math.min(window.to, at + AHEAD_MS * speed)
  while (found.length <= MOST_AHEAD) {
    const last = found.at(-1) as Piece
    // Also while nothing plays: whoever steps on does not wait.
    const near = found.length === 1 && at > last.from + 0.6 * (last.to - last.from)
    if (last.to >= window.to || (last.to > until && !near)) break
    found.push(pieceAt(layout, last.to))
  }
  return [...found, pieceBefore(layout, at)]
}
