/** Gamepads of the page, looked at with every picture while one is there. */

import { onBeforeUnmount, onMounted } from 'vue'
import type { Room } from '../control/room'
import { PadDriver } from './gamepad'

/** Those that are plugged in; none where the browser keeps them from the page. */
function plugged(): Gamepad[] {
  if (!('getGamepads' in navigator)) return []
  return navigator.getGamepads().filter((pad) => pad !== null)
}

/** Follows gamepads for as long as the component lives, which must be as long as robots are shown. */
export function useGamepad(room: Room): void {
  const { name, waits } = room.gamepad
  let driver: PadDriver | null = null
  let index = -1
  let request = 0

  /** Another robot for whoever has both hands on a gamepad. */
  function neighbour(step: 1 | -1): void {
    const list = room.fleet.byName().filter(({ presence }) => presence !== 'offline')
    const at = list.findIndex(({ id }) => id === room.selectedId.value)
    const from = at < 0 && step < 0 ? 0 : at
    const to = list[(from + step + list.length) % list.length]
    if (to !== undefined) room.select(to.id)
  }

  function drive(pad: Gamepad): PadDriver {
    return new PadDriver(pad.index, {
      driver: room.driver,
      prepare: () => {
        room.driver.setBlocked(room.selectedId.value === null ? 'no-robot' : room.blocked.value)
      },
      stopRobot: () => void room.tellSelected({ command: 'stop' }),
      stopAll: () => room.stopAll(),
      neighbour,
    })
  }

  /** Nobody drives what is out of sight. */
  function mayDrive(): boolean {
    const pad = document.getElementById('drive-pad')
    return pad !== null && pad.offsetParent !== null
  }

  function look(): void {
    request = 0
    const pad = plugged().find((one) => one.index === index)
    if (driver === null) return
    if (pad === undefined) {
      lost(index)
      return
    }
    // Behind the login page a gamepad does nothing at all.
    if (document.querySelector('main')?.closest('[inert]') === null) {
      driver.look(pad, mayDrive)
      waits.value = driver.waits && pad.axes.some((axis) => Math.abs(axis) > 0.5)
    } else {
      driver.letGo()
    }
    request = requestAnimationFrame(look)
  }

  function found(pad: Gamepad): void {
    // The first one drives; others wait until it is gone.
    if (driver !== null) return
    index = pad.index
    name.value = pad.id
    driver = drive(pad)
    request = requestAnimationFrame(look)
  }

  function lost(which: number): void {
    if (which !== index) return
    driver?.letGo()
    driver = null
    index = -1
    name.value = null
    waits.value = false
    cancelAnimationFrame(request)
    const next = plugged().find((pad) => pad.index !== which)
    if (next !== undefined) found(next)
  }

  const onFound = (event: GamepadEvent): void => found(event.gamepad)
  const onLost = (event: GamepadEvent): void => lost(event.gamepad.index)
  /** Pictures stop in a hidden tab, and with them looking. */
  const onHidden = (): void => {
    if (document.hidden) driver?.letGo()
  }

  onMounted(() => {
    window.addEventListener('gamepadconnected', onFound)
    window.addEventListener('gamepaddisconnected', onLost)
    document.addEventListener('visibilitychange', onHidden)
    // One that was used before the page came here is not announced again.
    const [known] = plugged()
    if (known !== undefined) found(known)
  })
  onBeforeUnmount(() => {
    window.removeEventListener('gamepadconnected', onFound)
    window.removeEventListener('gamepaddisconnected', onLost)
    document.removeEventListener('visibilitychange', onHidden)
    driver?.letGo()
    driver = null
    cancelAnimationFrame(request)
  })
}
