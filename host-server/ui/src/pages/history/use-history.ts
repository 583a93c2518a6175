/** The page about the past: what stands in the address, the clock, and the record around the moment. */

import type { ComputedRef, InjectionKey, Ref, ShallowRef } from 'vue'
import { computed, inject, onBeforeUnmount, onMounted, ref, shallowRef, watch } from 'vue'
import { trouble } from '../../account/trouble'
import type { HistorySpan } from '../../api-types'
import type { Room } from '../../control/room'
import { ApiError } from '../../http'
import type { Window, Wish } from '../../history/address'
import { USUAL_WINDOW_MS, around, queryOfWish, wishOf } from '../../history/address'
import type { Layout } from '../../history/chunks'
import { layoutFor, pieceAt, pieceBefore, wanted } from '../../history/chunks'
import { Frames } from '../../history/frames'
import type { HistoryApi } from '../../history/history-api'
import { Player } from '../../history/player'
import type { Recorded } from '../../history/record'
import { Replay } from '../../history/replay'
import { Store } from '../../history/store'
import type { Address } from '../../view'
import type { Asked } from './ask'
import { useAsk } from './ask'

/** While a hand drags, nothing is fetched before it rests this long. */
const REST_MS = 120
/** How often the moment goes into the address: browsers bear no more. */
const WRITE_MS = 700
/** Words about the moment change this often. */
const TELL_MS = 200
/** Pieces are made smaller at most so often. */
const MOST_SHRINKS = 6

/** What is known of the moment that is wanted. */
export type Here = 'loading' | 'shown' | 'empty' | 'failed'

export interface Past {
  room: Room
  api: HistoryApi
  player: Player
  replay: Replay
  span: Asked<HistorySpan>
  wish: ComputedRef<Wish>
  window: ComputedRef<Window>
  /** Rises when what is written about the moment is worth computing anew. */
  tick: Ref<number>
  here: Ref<Here>
  error: Ref<string | null>
  /** Names of robots that were seen in the record, in order. */
  names: ShallowRef<readonly string[]>
  /** The server's clock, Unix milliseconds. */
  now(): number
  change(wish: Partial<Wish>): void
  seek(time: number): void
  /** The moment as well into the address, at once. */
  write(): void
  retry(): void
  /** Called with every change of the picture; the arena hangs on it. */
  onPoses: () => void
}

export function usePast(room: Room, address: Address, api: HistoryApi): Past {
  let wished = wishOf({})
  // What another page is asked for says nothing about this one, which may be about to go.
  const wish = computed(() => {
    if (address.view.value === 'history') wished = wishOf(address.route.value.query)
    return wished
  })
  const span = useAsk<HistorySpan>()
  const tick = ref(0)
  const here = ref<Here>('loading')
  const error = ref<string | null>(null)
  const names: ShallowRef<readonly string[]> = shallowRef([])
  const shrinks = ref(0)
  const opened = now()
  let written = -1
  let latest: Recorded | null = null
  let toldAt = Number.NEGATIVE_INFINITY
  let resting: ReturnType<typeof setTimeout> | null = null

  /** Before the first frame of the feed there is no clock but the browser's. */
  function now(): number {
    const told = room.serverNow()
    return Math.round(told > 1e12 ? told : Date.now())
  }

  const window = computed<Window>(() => {
    const wished = wish.value.window
    if (wished !== null) return wished
    const at = wish.value.at
    const to = Math.min(opened, span.data.value?.to ?? opened)
    const usual = { from: Math.max(1, to - USUAL_WINDOW_MS), to: Math.max(2, to) }
    return at === null ? usual : around(usual, at)
  })
  // The same object while it is the same layout: whoever sees another throws away what is loaded, and
  // this is computed anew with every change of the address.
  const layout = computed<Layout>((known) => {
    const next = layoutFor(span.data.value?.robots ?? 1, wish.value.speed, shrinks.value)
    return known?.step === next.step && known.points === next.points ? known : next
  })

  const replay = new Replay()
  const store = new Store({
    fetch: (piece, signal) => api.frames(piece, signal),
    now,
    onChange: () => show(),
  })
  const player = new Player({
    window: () => window.value,
    ready: (time) => store.has(pieceAt(layout.value, time)),
    onMove: () => {
      show()
      // A hand that drags is not followed step by step.
      if (player.playing.value) load()
      else rest()
    },
  })

  const frames = new Frames(player)

  const past: Past = {
    room,
    api,
    player,
    replay,
    span,
    wish,
    window,
    tick,
    here,
    error,
    names,
    now,
    change: (next) => address.change(queryOfWish(next)),
    seek(time) {
      player.seek(time)
    },
    write,
    retry() {
      span.again()
      store.retry()
    },
    onPoses: () => undefined,
  }

  function load(): void {
    if (span.data.value === null) return
    store.want(
      wanted(layout.value, player.now, player.playing.value ? player.speed.value : 0, window.value),
    )
  }

  function rest(): void {
    if (resting !== null) clearTimeout(resting)
    resting = setTimeout(load, store.has(pieceAt(layout.value, player.now)) ? 0 : REST_MS)
  }

  /** Brings the picture to the moment, as far as it is known. */
  function show(): void {
    const piece = pieceAt(layout.value, player.now)
    const found = store.get(piece)
    const before = here.value
    if (found !== undefined) {
      replay.show(player.now, found, store.get(pieceBefore(layout.value, player.now)) ?? null)
      here.value = replay.fleet.size > 0 ? 'shown' : 'empty'
      error.value = null
      if (found !== latest) meet(found.tracks.keys())
      latest = found
    } else {
      const problem = store.failure(piece)
      if (
        problem instanceof ApiError &&
        problem.code === 'too_much' &&
        shrinks.value < MOST_SHRINKS
      ) {
        shrinks.value += 1
        return
      }
      here.value = problem === null ? 'loading' : 'failed'
      // Another moment under the time of this one would be a lie; while it loads it is veiled.
      if (problem !== null) replay.clear()
      error.value = problem === null ? null : trouble(problem)
    }
    past.onPoses()
    const wall = performance.now()
    if (!player.playing.value || before !== here.value || wall - toldAt > TELL_MS) {
      toldAt = wall
      tick.value += 1
    }
  }

  const met = new Set<string>()
  function meet(ids: Iterable<string>): void {
    const size = met.size
    for (const id of ids) met.add(id)
    if (met.size === size) return
    const order = new Intl.Collator('en', { numeric: true })
    names.value = [...met].sort((a, b) => order.compare(a, b))
  }

  /** The moment stands in the address with some delay: it changes faster than addresses may. */
  function write(): void {
    const at = Math.round(player.now)
    if (address.view.value !== 'history' || span.data.value === null) return
    // This moment belongs to the address that is being left.
    if (address.leaving()) return
    if (at === written && wish.value.at !== null) return
    written = at
    const { from, to } = window.value
    address.change(queryOfWish({ window: { from, to }, at }))
  }

  watch(player.playing, (playing) => {
    frames.stop()
    load()
    if (!playing) {
      tick.value += 1
      write()
      return
    }
    frames.start()
  })
  watch(
    () => wish.value.speed,
    (speed) => {
      player.speed.value = speed
    },
    { immediate: true },
  )
  watch(
    () => wish.value.robot,
    (robot) => {
      replay.selectedId = robot
      tick.value += 1
      show()
    },
    { immediate: true },
  )
  watch(layout, () => {
    store.clear()
    load()
    show()
  })
  // Another address by hand, or by a link on this very page; and the first one.
  watch(
    [() => wish.value.at, window, span.data],
    ([at]) => {
      if (span.data.value === null) return
      if (at === null) player.seek(window.value.to)
      else if (at !== written) player.seek(at)
      else player.seek(player.now)
      load()
      show()
      write()
    },
    { immediate: true },
  )
  // The record goes on: what was its end when the page was opened is not for long.
  watch(
    () => window.value.to,
    (to) => {
      const known = span.data.value
      if (known !== null && to > (known.to ?? 0)) span.again()
    },
  )
  // What failed while the server was away is asked for as soon as it is back.
  watch(
    () => room.status.value.state,
    (state) => {
      if (state !== 'live') return
      if (span.error.value !== null) span.again()
      store.retry()
    },
  )

  let writing: ReturnType<typeof setInterval> | null = null
  onMounted(() => {
    void span.ask((signal) => api.span(signal))
    writing = setInterval(write, WRITE_MS)
  })
  onBeforeUnmount(() => {
    frames.stop()
    if (resting !== null) clearTimeout(resting)
    if (writing !== null) clearInterval(writing)
    player.playing.value = false
    past.onPoses = () => undefined
    store.close()
  })
  return past
}

export const PAST: InjectionKey<Past> = Symbol('past')

export function injectPast(): Past {
  const past = inject(PAST)
  if (past === undefined) throw new Error('no past is provided')
  return past
}
