/** A moment of the record in words, for those who do not see the picture. */

import type { RobotState } from '../../feed/decode'
import type { Replay } from '../../history/replay'
import { selectedSummary, states } from '../../strings'
import { past as say } from '../../strings-history'

/** Robots that are named one by one. */
const MOST_NAMED = 3

interface MomentWords {
  shown: number
  moving: number
  gaps: number
  all: string
  robot: { id: string; x: number; y: number; words: string } | null
}

/** `known`: how many robots were ever seen in the record. */
export function momentWords(replay: Replay, known: number): MomentWords {
  const counts = new Map<RobotState, number>()
  for (const robot of replay.fleet.all()) {
    if (!robot.placed || robot.presence !== 'online') continue
    counts.set(robot.state, (counts.get(robot.state) ?? 0) + 1)
  }
  const listed = [...counts].map(
    ([state, count]) => `${String(count)} ${states[state].toLowerCase()}`,
  )
  const sentences = [say.arena.summary(replay.fleet.size, replay.moving, listed.join(', '))]
  const { gaps } = replay
  if (gaps.size > 0) {
    const named = [...gaps].slice(0, MOST_NAMED).map(([id, gap]) => say.arena.gap(id, gap))
    if (gaps.size > MOST_NAMED) named.push(say.arena.more)
    sentences.push(say.arena.gaps(gaps.size, named.join(', ')))
  }
  const others = known - replay.fleet.size
  if (others > 0) sentences.push(say.arena.others(others))
  return {
    shown: replay.fleet.size,
    moving: replay.moving,
    gaps: gaps.size,
    all: sentences.join(' '),
    robot: chosen(replay),
  }
}

function chosen(replay: Replay): MomentWords['robot'] {
  const robot = replay.selected
  if (robot === undefined) return null
  const { id, state, x, y, heading, range } = robot
  const gap = replay.gaps.get(id)
  const words = selectedSummary(id, state, x, y, heading, range)
  return { id, x, y, words: gap === undefined ? words : `${say.arena.old(id, gap)} ${words}` }
}
