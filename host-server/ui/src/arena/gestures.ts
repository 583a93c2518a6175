/**
 * Mouse, pen and fingers on the arena: drag pans, wheel and pinch zoom, a tap picks. A drag with
 * Shift, or while `lassoing` says so, draws a line around robots instead.
 */

import type { Ref } from 'vue'
import { onBeforeUnmount, onMounted } from 'vue'

interface Gestures {
  pan(dx: number, dy: number): void
  zoom(x: number, y: number, factor: number): void
  tap(x: number, y: number, keys: Keys): void
  /** Whether a drag that starts now draws a line. */
  lassoing(): boolean
  /** A line begins, goes on, ends (with something, or given up). */
  lassoStart(x: number, y: number): void
  lassoMove(x: number, y: number): void
  lassoEnd(done: boolean, keys: Keys): void
}

/** Keys that say that robots are added to those chosen. */
export interface Keys {
  shiftKey: boolean
  ctrlKey: boolean
  metaKey: boolean
}

/** A pointer that moved less than this is a tap, pixels. */
const TAP_SLOP = 6
const WHEEL_GAIN = 0.0015
/** One notch of a wheel that counts lines rather than pixels. */
const LINE_PIXELS = 16

interface Finger {
  x: number
  y: number
}

export function useGestures(target: Readonly<Ref<HTMLElement | null>>, act: Gestures): void {
  const fingers = new Map<number, Finger>()
  let travelled = 0
  /** The pointer that draws a line. */
  let drawing: number | null = null
  let element: HTMLElement | null = null

  function at(event: MouseEvent): Finger {
    const frame = (event.currentTarget as HTMLElement).getBoundingClientRect()
    return { x: event.clientX - frame.left, y: event.clientY - frame.top }
  }

  function down(event: PointerEvent): void {
    if (event.button !== 0) return
    if (fingers.size === 0) travelled = 0
    const here = at(event)
    fingers.set(event.pointerId, here)
    if (fingers.size === 1 && (event.shiftKey || act.lassoing())) {
      drawing = event.pointerId
      act.lassoStart(here.x, here.y)
    } else if (drawing !== null) {
      // A second finger means to pinch.
      drawing = null
      act.lassoEnd(false, event)
    }
    ;(event.currentTarget as HTMLElement).setPointerCapture(event.pointerId)
  }

  function move(event: PointerEvent): void {
    const before = fingers.get(event.pointerId)
    if (before === undefined) return
    const now = at(event)
    travelled += Math.hypot(now.x - before.x, now.y - before.y)
    if (event.pointerId === drawing) {
      fingers.set(event.pointerId, now)
      act.lassoMove(now.x, now.y)
      return
    }
    const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1]
    if (other !== undefined) {
      const spread = Math.hypot(before.x - other.x, before.y - other.y)
      const wider = Math.hypot(now.x - other.x, now.y - other.y)
      act.pan((now.x - before.x) / 2, (now.y - before.y) / 2)
      if (spread > 1) act.zoom((now.x + other.x) / 2, (now.y + other.y) / 2, wider / spread)
    } else if (travelled > TAP_SLOP) {
      act.pan(now.x - before.x, now.y - before.y)
    }
    fingers.set(event.pointerId, now)
  }

  function up(event: PointerEvent): void {
    const finger = fingers.get(event.pointerId)
    if (finger === undefined) return
    fingers.delete(event.pointerId)
    const tapped = fingers.size === 0 && travelled <= TAP_SLOP
    if (event.pointerId === drawing) {
      drawing = null
      act.lassoEnd(!tapped, event)
    }
    if (tapped) act.tap(finger.x, finger.y, event)
  }

  function cancel(event: PointerEvent): void {
    fingers.delete(event.pointerId)
    if (event.pointerId !== drawing) return
    drawing = null
    act.lassoEnd(false, event)
  }

  /** A drag must not take the focus off the drive pad: whoever drives goes on driving. */
  function keepFocus(event: MouseEvent): void {
    event.preventDefault()
  }

  function wheel(event: WheelEvent): void {
    event.preventDefault()
    const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PIXELS : 1)
    const { x, y } = at(event)
    act.zoom(x, y, Math.exp(-pixels * WHEEL_GAIN))
  }

  onMounted(() => {
    element = target.value
    element?.addEventListener('pointerdown', down)
    element?.addEventListener('mousedown', keepFocus)
    element?.addEventListener('pointermove', move)
    element?.addEventListener('pointerup', up)
    element?.addEventListener('pointercancel', cancel)
    element?.addEventListener('wheel', wheel, { passive: false })
  })
  onBeforeUnmount(() => {
    element?.removeEventListener('pointerdown', down)
    element?.removeEventListener('mousedown', keepFocus)
    element?.removeEventListener('pointermove', move)
    element?.removeEventListener('pointerup', up)
    element?.removeEventListener('pointercancel', cancel)
    element?.removeEventListener('wheel', wheel)
  })
}
