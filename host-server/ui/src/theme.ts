/** Light, dark, or whatever the system says; remembered on this machine. */

import { ref } from 'vue'
import type { Palette, Rgb } from './arena/renderer'
import { COLOURS } from './feed/arena'
import { STATES } from './feed/decode'

export const THEMES = ['system', 'light', 'dark'] as const
export type Theme = (typeof THEMES)[number]

const KEY = 'terracrawler.theme'

export const theme = ref<Theme>(remembered())

export function setTheme(choice: Theme): void {
  theme.value = choice
  try {
    localStorage.setItem(KEY, choice)
  } catch {
    // Storage may be off; the choice then lasts as long as the page.
  }
  applyTheme()
}

export function applyTheme(): void {
  document.documentElement.dataset['theme'] = theme.value
}

/** The arena's colours, from the same custom properties as everything else. */
export function readPalette(element: Element): Palette {
  const style = getComputedStyle(element)
  const tone = (name: string): Rgb => parseColour(style.getPropertyValue(name))
  return {
    background: tone('--arena-back'),
    floor: tone('--arena-floor'),
    grid: tone('--arena-grid'),
    wall: tone('--arena-wall'),
    obstacle: tone('--arena-obstacle'),
    edge: tone('--arena-edge'),
    cell: tone('--arena-cell'),
    patch: tone('--arena-patch'),
    things: COLOURS.map((colour) => tone(`--thing-${colour}`)),
    states: STATES.map((state) => tone(`--state-${state.toLowerCase()}`)),
    mark: tone('--arena-mark'),
    outline: tone('--arena-outline'),
    frame: tone('--arena-frame'),
    gone: tone('--state-gone'),
    accent: tone('--arena-accent'),
  }
}

/**
 * `#rrggbb` or `#rgb` (what a minifier makes of it) to 0…1; anything else is a
 * visible magenta rather than an exception.
 */
export function parseColour(value: string): Rgb {
  const match = /^\s*#([0-9a-f]{3}|[0-9a-f]{6})\s*$/i.exec(value)
  if (match === null) return [1, 0, 1]
  const digits = match[1] as string
  const long = digits.length === 6 ? digits : digits.replace(/./g, '$&$&')
  const bits = Number.parseInt(long, 16)
  return [((bits >> 16) & 255) / 255, ((bits >> 8) & 255) / 255, (bits & 255) / 255]
}

function remembered(): Theme {
  try {
    return THEMES.find((known) => known === localStorage.getItem(KEY)) ?? 'system'
  } catch {
    return 'system'
  }
}
