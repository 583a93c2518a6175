/** Keyboard, focus and visibility of the whole page, wired to the room. */

import { directionOf, focusOf, intentOf, isSpace } from '../drive/keys'
import type { Room } from './room'

/** What the page offers keys besides stopping and driving. */
interface PageActions {
  /** `room`: all keys; `page`: the emergency stop only; `off`: none. */
  keys(): 'room' | 'page' | 'off'
  help(): void
  search(): void
  neighbour(step: 1 | -1): void
  zoom(factor: number): void
  fit(): void
}

/** What the arena offers keys; it says so itself, by the room. */
export interface ArenaKeys {
  pan(x: number, y: number): void
  aim(add: boolean): void
  follow(): void
  go(): void
  lasso(): void
  /** True when there was something to leave: a tool, for instance. */
  leave(): boolean
}

/** Installs all listeners; the result removes them again. */
export function installControls(room: Room, page: PageActions): () => void {
  function keyDown(event: KeyboardEvent): void {
    const keys = page.keys()
    if (keys === 'off') return
    // While the command key is down macOS reports no releases of other keys.
    if (event.metaKey) room.driver.releaseAll()
    const intent = intentOf(event, focusOf(document.activeElement))
    if (intent === null) return
    // A page of settings is scrolled and tabbed through: nothing there may drive.
    if (keys === 'page' && intent.do !== 'stop-all' && intent.do !== 'leave-field') return
    switch (intent.do) {
      case 'stop-all':
        // In the capture phase and swallowed, so that Space never also clicks
        // the focused button, ticks a box or scrolls.
        event.preventDefault()
        event.stopImmediatePropagation()
        if (!event.repeat) room.stopAll()
        return
      case 'drive':
        if (room.selectedId.value === null) return
        // Held arrows must not scroll the page, also while driving is refused.
        event.preventDefault()
        if (!event.repeat) room.hold(`key:${event.code}`, intent.direction)
        return
      case 'leave-field':
        ;(document.activeElement as HTMLElement | null)?.blur()
        break
      case 'let-go':
        // From what moves to what is only chosen, one at a time.
        if (room.driver.driving) room.driver.releaseAll()
        else if (room.arenaKeys?.leave() === true) break
        else if (room.captured.value) room.captured.value = false
        else if (room.selection.size > 0) room.selection.clear()
        else room.select(null)
        break
      case 'help':
        page.help()
        break
      case 'search':
        page.search()
        break
      case 'neighbour':
        page.neighbour(intent.step)
        break
      case 'zoom':
        page.zoom(intent.factor)
        break
      case 'fit':
        page.fit()
        break
      case 'pan':
        room.arenaKeys?.pan(intent.x, intent.y)
        break
      case 'aim':
        room.arenaKeys?.aim(intent.add)
        break
      case 'follow':
      case 'go':
      case 'lasso':
        if (!event.repeat) room.arenaKeys?.[intent.do]()
        break
    }
    event.preventDefault()
  }

  function keyUp(event: KeyboardEvent): void {
    if (page.keys() === 'off') return
    // Some browsers click a button when Space comes up, whatever became of the way down.
    if (isSpace(event) && focusOf(document.activeElement) !== 'text') {
      event.preventDefault()
      event.stopImmediatePropagation()
    }
    if (directionOf(event.code) !== null) room.driver.release(`key:${event.code}`)
  }

  // A key or finger held while the page loses the keyboard never reports its release.
  const letGo = (): void => room.driver.releaseAll()
  const onVisibility = (): void => {
    if (document.hidden) letGo()
  }
  const onOnline = (): void => room.connection.retryNow()
  const capture = { capture: true }

  window.addEventListener('keydown', keyDown, capture)
  window.addEventListener('keyup', keyUp, capture)
  window.addEventListener('blur', letGo)
  window.addEventListener('pagehide', letGo)
  window.addEventListener('online', onOnline)
  document.addEventListener('visibilitychange', onVisibility)
  return () => {
    window.removeEventListener('keydown', keyDown, capture)
    window.removeEventListener('keyup', keyUp, capture)
    window.removeEventListener('blur', letGo)
    window.removeEventListener('pagehide', letGo)
    window.removeEventListener('online', onOnline)
    document.removeEventListener('visibilitychange', onVisibility)
  }
}
