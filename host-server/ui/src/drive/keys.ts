/**
 * What a key means, by where the focus is. One pure function, so that the
 * dangerous cases (Space on a focused button, arrows in a text field) are
 * tested one by one.
 */

import type { Direction } from './driver'

/**
 * Where the focus is, as far as keys care. `pad`: on a drive pad that has the keyboard; one that
 * has not is `elsewhere`.
 */
export type Focus = 'text' | 'choice' | 'slider' | 'list' | 'dialog' | 'arena' | 'pad' | 'elsewhere'

type Intent =
  | { do: 'stop-all' }
  | { do: 'drive'; direction: Direction }
  | { do: 'leave-field' }
  | { do: 'let-go' }
  | { do: 'help' }
  | { do: 'search' }
  | { do: 'neighbour'; step: 1 | -1 }
  | { do: 'zoom'; factor: number }
  | { do: 'fit' }
  | { do: 'pan'; x: -1 | 0 | 1; y: -1 | 0 | 1 }
  | { do: 'aim'; add: boolean }
  | { do: 'follow' }
  | { do: 'go' }
  | { do: 'lasso' }

export interface KeyPress {
  key: string
  code: string
  ctrlKey: boolean
  altKey: boolean
  metaKey: boolean
  shiftKey: boolean
}

const ARROWS: Readonly<Record<string, Direction>> = {
  ArrowUp: 'forward',
  ArrowDown: 'backward',
  ArrowLeft: 'left',
  ArrowRight: 'right',
}
/** By position on the keyboard, so that they are one block on every layout. */
const LETTERS: Readonly<Record<string, Direction>> = {
  KeyW: 'forward',
  KeyS: 'backward',
  KeyA: 'left',
  KeyD: 'right',
}
/** What an arrow does to the view: y is up in the world. */
const PANS: Readonly<Record<Direction, readonly [-1 | 0 | 1, -1 | 0 | 1]>> = {
  forward: [0, 1],
  backward: [0, -1],
  left: [-1, 0],
  right: [1, 0],
}
export const ZOOM_STEP = 1.25

export function isSpace(press: Pick<KeyPress, 'key' | 'code'>): boolean {
  return press.code === 'Space' || press.key === ' '
}

/** The direction a key stands for, wherever the focus is; releases need no more. */
export function directionOf(code: string): Direction | null {
  return ARROWS[code] ?? LETTERS[code] ?? null
}

export function intentOf(press: KeyPress, focus: Focus): Intent | null {
  // A text field takes a space as text. Everywhere else it is the emergency
  // stop, with any modifier too: a hand that slams the keyboard is not precise.
  if (isSpace(press)) return focus === 'text' ? null : { do: 'stop-all' }
  if (press.ctrlKey || press.altKey || press.metaKey) return null
  if (press.key === 'Escape') {
    if (focus === 'dialog') return null
    return { do: focus === 'text' ? 'leave-field' : 'let-go' }
  }
  if (focus === 'text' || focus === 'choice' || focus === 'dialog') return null
  // Whoever drives goes from robot to robot; Esc gives Tab back its own meaning.
  if (press.key === 'Tab') {
    return focus === 'pad' ? { do: 'neighbour', step: press.shiftKey ? -1 : 1 } : null
  }
  const arrow = ARROWS[press.code]
  if (focus === 'arena') {
    if (arrow !== undefined) return { do: 'pan', x: PANS[arrow][0], y: PANS[arrow][1] }
    if (press.key === 'Enter') return { do: 'aim', add: press.shiftKey }
    if (press.key === 'Home') return { do: 'fit' }
  }
  // A slider and a list have their own use for arrows.
  if (arrow !== undefined) {
    return focus === 'elsewhere' || focus === 'pad' ? { do: 'drive', direction: arrow } : null
  }
  const letter = LETTERS[press.code]
  if (letter !== undefined) return { do: 'drive', direction: letter }
  switch (press.key) {
    case '?':
      return { do: 'help' }
    case '/':
      return { do: 'search' }
    case '[':
      return { do: 'neighbour', step: -1 }
    case ']':
      return { do: 'neighbour', step: 1 }
    case '+':
    case '=':
      return { do: 'zoom', factor: ZOOM_STEP }
    case '-':
      return { do: 'zoom', factor: 1 / ZOOM_STEP }
    case '0':
      return { do: 'fit' }
    case 'f':
    case 'F':
      return { do: 'follow' }
    case 'g':
    case 'G':
      return { do: 'go' }
    case 'l':
    case 'L':
      return { do: 'lasso' }
    default:
      return null
  }
}

const NOT_TEXT = new Set([
  'button',
  'checkbox',
  'color',
  'file',
  'image',
  'radio',
  'range',
  'reset',
  'submit',
])

/** Classifies the element that has the focus. */
export function focusOf(element: Element | null): Focus {
  if (element === null) return 'elsewhere'
  const name = element.tagName
  if (name === 'INPUT') {
    const type = (element as HTMLInputElement).type
    if (type === 'range') return 'slider'
    return NOT_TEXT.has(type) ? 'elsewhere' : 'text'
  }
  if (name === 'TEXTAREA' || (element as HTMLElement).isContentEditable) return 'text'
  if (name === 'SELECT') return 'choice'
  if (element.closest('dialog') !== null) return 'dialog'
  if (element.closest('[role="listbox"]') !== null) return 'list'
  if (element.closest('[data-keys="arena"]') !== null) return 'arena'
  if (element.closest('[data-captured="true"]') !== null) return 'pad'
  return 'elsewhere'
}
