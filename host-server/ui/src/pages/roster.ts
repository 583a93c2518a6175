/** Robots of a page, as its address asks for them, in step with the live feed. */

import type { ComputedRef, ShallowRef } from 'vue'
import { computed, onBeforeUnmount, shallowRef, watch } from 'vue'
import type { Room } from '../control/room'
import type { Robot } from '../fleet/fleet'
import { isMoving } from '../fleet/fleet'
import type { Show, Sort, Wanted } from '../fleet/order'
import { arrange, isShow, isSort } from '../fleet/order'
import type { Address } from '../view'

/** Rows keep their places for that long: a list that jumps under the hand is no use. */
const ARRANGE_EVERY_MS = 1_000
/** And sorting a large fleet must not take more than so small a part of the time. */
const REST = 25

interface Roster {
  wanted: ComputedRef<Wanted>
  shown: ShallowRef<readonly Robot[]>
  search(text: string): void
  show(show: Show): void
  /** The same column again turns the order round. */
  sortBy(sort: Sort): void
  turn(): void
}

export function useRoster(room: Room, address: Address): Roster {
  const query = computed(() => address.route.value.query)
  const wanted = computed<Wanted>(() => {
    const { q = '', show = '', sort = '', order = '' } = query.value
    return {
      search: q,
      show: isShow(show) ? show : 'all',
      sort: isSort(sort) ? sort : 'name',
      descending: order === 'down',
    }
  })
  const shown: ShallowRef<readonly Robot[]> = shallowRef([])
  let due = 0
  let size = -1

  function renew(): void {
    const began = performance.now()
    size = room.fleet.size
    shown.value = arrange(room.fleet.byName(), wanted.value, room.summaries.value)
    const end = performance.now()
    due = end + Math.max(ARRANGE_EVERY_MS, REST * (end - began))
  }
  watch(wanted, renew, { immediate: true })
  const stop = watch(room.tick, () => {
    if (performance.now() >= due || room.fleet.size !== size) renew()
  })
  onBeforeUnmount(stop)

  return {
    wanted,
    shown,
    search: (text) => address.change({ q: text }),
    show: (show) => address.change({ show: show === 'all' ? '' : show }),
    sortBy(sort) {
      if (wanted.value.sort === sort) this.turn()
      else address.change({ sort: sort === 'name' ? '' : sort, order: '' })
    },
    turn: () => address.change({ order: wanted.value.descending ? '' : 'down' }),
  }
}

/** What a row or a card shows, read anew with every tick for those in view. */
export interface Row {
  id: string
  kind: Robot['kind']
  state: Robot['state']
  presence: Robot['presence']
  moving: boolean
  position: string
  range: number | null
  low: boolean
  fence: string | null
  battery: number | null
  rssi: number | null
  behaviour: string | null
  firmware: string
  lastSeen: number | null
  selected: boolean
}

export function rowOf(room: Room, robot: Robot, now: number): Row {
  const more = room.summaries.value.get(robot.id)
  return {
    id: robot.id,
    kind: robot.kind,
    state: robot.state,
    presence: robot.presence,
    moving: isMoving(robot, now),
    position: robot.placed ? `${robot.x.toFixed(2)}, ${robot.y.toFixed(2)}` : '',
    range: robot.range,
    low: robot.lowBattery,
    fence: robot.fence,
    battery: more?.battery ?? null,
    rssi: more?.rssi ?? null,
    behaviour: more?.behaviour ?? null,
    firmware: [robot.firmware, robot.board].filter((part) => part !== '').join(' · '),
    lastSeen: more?.lastSeen ?? null,
    selected: room.selection.ids.value.has(robot.id),
  }
}
