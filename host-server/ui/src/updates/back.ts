/** The way back to an earlier version: forward, under a sequence above all before. */

import type { Release, Rollout } from '../api-types'
import { standing } from './releases'

type Kept = Pick<
  Release,
  'id' | 'kind' | 'board' | 'version' | 'build' | 'sequence' | 'size' | 'floor' | 'withdrawn'
> & { expires_at?: number | null }

/** A program that was released before, and what it takes to go back to it. */
export interface Earlier {
  /** The newest release of that program. */
  release: Kept
  /** A release of it that robots take at once, if there is one. */
  ready: Kept | null
}

export interface Way {
  board: string
  /** The highest sequence that was rolled out for the board, and what has it; 0 where nothing was. */
  newest: number
  /** The program that the board's newest rollout brings; `null` where there was none. */
  build: string | null
  /** The least sequence that no release of the board has or is below of. */
  free: number
  earlier: readonly Earlier[]
}

/** Releases that a rollout is of: as its plan has them. */
type Planned = Pick<Rollout, 'plan'>

/** Boards that programs were released for, by name. */
export function boardsOf(releases: readonly Pick<Release, 'kind' | 'board'>[]): string[] {
  const programs = releases.filter(({ kind }) => kind === 'program')
  return [...new Set(programs.map(({ board }) => board))].sort((a, b) => a.localeCompare(b))
}

/** How robots on a board get back to something earlier. */
export function wayBack(
  board: string,
  releases: readonly Kept[],
  rollouts: readonly Planned[],
  now: number,
): Way {
  const own = releases.filter((one) => one.kind === 'program' && one.board === board)
  const planned = rollouts
    .flatMap(({ plan }) => plan.releases)
    .filter((one) => one.board === board && one.model == null)
  const top = planned.reduce<(typeof planned)[number] | null>(
    (best, one) => (best === null || one.sequence > best.sequence ? one : best),
    null,
  )
  const newest = top?.sequence ?? 0
  const build = top?.build ?? null
  const highest = own.reduce((most, one) => Math.max(most, one.sequence), newest)
  const byBuild = new Map<string, Kept[]>()
  for (const one of own) {
    // What was withdrawn was withdrawn for a reason.
    if (one.build === build || one.withdrawn != null) continue
    byBuild.set(one.build, [...(byBuild.get(one.build) ?? []), one])
  }
  const earlier = [...byBuild.values()].flatMap((group): Earlier[] => {
    const sorted = [...group].sort((a, b) => b.sequence - a.sequence)
    const [release] = sorted
    const first = sorted.at(-1)
    if (release === undefined || first === undefined) return []
    // What has never been below what was rolled out is later, not earlier.
    if (first.sequence > newest) return []
    const good = sorted.filter((one) => standing(one, now) === 'good')
    return [{ release, ready: good.find((one) => one.sequence > newest) ?? null }]
  })
  earlier.sort((a, b) => b.release.sequence - a.release.sequence)
  return { board, newest, build, free: highest + 1, earlier }
}

/** A word of a command line as a shell takes it. */
export function quoted(word: string): string {
  return /^[\w.,:=+/@%-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`
}

/** For how many days it holds what expired, or will, before. */
const EXPIRES_DAYS = '365'

/** What to type where the private key is, to sign a program again under another sequence. */
export function signCommand(
  { board, version, build, expires_at: expires }: Kept,
  sequence: number,
): string {
  const number = String(sequence)
  const words: readonly string[] = [
    'terracrawler',
    'release',
    'sign',
    '--key',
    'keys/release-key.pem',
    '--image',
    'IMAGE',
    '--board',
    board,
    '--version',
    version,
    '--build',
    build,
    '--sequence',
    number,
    ...(expires == null ? [] : ['--expires', EXPIRES_DAYS]),
    '--out',
    `${board}-${number}.release`,
  ]
  return words.map(quoted).join(' ')
}

/** What to type to give it to the server, besides the form of the page. */
export function fileOf({ board }: Pick<Release, 'board'>, sequence: number): string {
  return `${board}-${String(sequence)}.release`
}
