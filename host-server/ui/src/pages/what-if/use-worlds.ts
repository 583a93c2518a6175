/** Both worlds of an answer, played in step by one clock. */

import type { Ref } from 'vue'
import { onBeforeUnmount, onMounted, ref, watch } from 'vue'
import type { Bounds } from '../../arena/camera'
import { Frames } from '../../history/frames'
import { Player } from '../../history/player'
import { Replay } from '../../history/replay'
import { useAddress } from '../../view'
import { afterOf, queryOfAfter } from '../../what-if/address'
import type { WhatIfAnswer, World } from '../../what-if/answer'
import { WORLDS } from '../../what-if/answer'
import { frameOf } from '../../what-if/frame'
import type { Overlay } from '../../what-if/overlay'
import { overlayAt, radiusAt } from '../../what-if/overlay'

/** Words about the moment change this often. */
const TELL_MS = 200
/** How often the time goes into the address: browsers bear no more. */
const WRITE_MS = 700

export interface Worlds {
  answer: WhatIfAnswer
  player: Player
  replays: Readonly<Record<World, Replay>>
  /** Rises when what is written about the moment is worth computing anew. */
  tick: Ref<number>
  /** What both pictures show of the floor. */
  frame: Bounds | null
  /** Called with every change of the pictures. */
  readonly draws: Set<() => void>
  overlay(world: World): Overlay
  /** How sure a world is of the chosen robot, metres. */
  within(world: World): number
}

/** `asked`: those that were told something else; `null` for all, of whom none stands out. */
export function useWorlds(
  answer: WhatIfAnswer,
  asked: readonly string[] | null,
  chosen: () => string | null,
): Worlds {
  const replays = { was: new Replay(), would: new Replay() }
  const about = new Set(asked ?? [])
  for (const world of WORLDS) replays[world].selection.replace(about)
  const draws = new Set<() => void>()
  const tick = ref(0)
  let toldAt = Number.NEGATIVE_INFINITY

  function show(): void {
    for (const world of WORLDS) {
      replays[world].selectedId = chosen()
      replays[world].show(player.now, answer.worlds[world], null)
    }
    for (const draw of draws) draw()
    const wall = performance.now()
    if (player.playing.value && wall - toldAt < TELL_MS) return
    toldAt = wall
    tick.value += 1
  }

  const player = new Player({ window: () => answer.window, ready: () => true, onMove: show })
  const frames = new Frames(player)
  watch(player.playing, (playing) => {
    frames.stop()
    if (playing) frames.start()
    else show()
  })
  watch(chosen, show)

  const address = useAddress()
  const { from, to } = answer.window
  const wished = (): number | null => afterOf(address.route.value.query)
  let written = wished()
  // What it came to is seen first; playing begins at the moment that was asked of.
  function seek(after: number | null): void {
    player.seek(after === null ? to : from + after)
  }
  seek(written)
  /** With some delay: time changes faster than addresses may. */
  function write(): void {
    if (address.view.value !== 'what-if' || address.leaving()) return
    const after = player.now >= to ? null : Math.round(player.now - from)
    if (after === written) return
    written = after
    address.change(queryOfAfter(after))
  }
  // Another time by hand.
  watch(wished, (after) => {
    if (after === written) return
    written = after
    seek(after)
  })
  let writing: ReturnType<typeof setInterval> | undefined
  onMounted(() => {
    writing = setInterval(write, WRITE_MS)
  })
  onBeforeUnmount(() => {
    clearInterval(writing)
    frames.stop()
    draws.clear()
  })

  return {
    answer,
    player,
    replays,
    tick,
    frame: frameOf(answer),
    draws,
    overlay: (world) => overlayAt(answer, world, player.now, chosen(), about),
    within(world) {
      const robot = chosen()
      return robot === null ? 0 : radiusAt(answer, world, robot, player.now)
    },
  }
}
