// @vitest-environment happy-dom

import { describe, expect, it } from 'vitest'
import type { Focus, KeyPress } from '../../src/drive/keys'
import { focusOf, intentOf } from '../../src/drive/keys'

function press(key: string, code = key, held: Partial<KeyPress> = {}): KeyPress {
  return { key, code, ctrlKey: false, altKey: false, metaKey: false, shiftKey: false, ...held }
}

const EVERYWHERE: Focus[] = [
  'text',
  'choice',
  'slider',
  'list',
  'dialog',
  'arena',
  'pad',
  'elsewhere',
]

describe('Space', () => {
  it.each(EVERYWHERE.filter((focus) => focus !== 'text'))(
    'stops with the focus on: %s',
    (focus) => {
      expect(intentOf(press(' ', 'Space'), focus)).toEqual({ do: 'stop-all' })
    },
  )

  it('is text in a text field', () => {
    expect(intentOf(press(' ', 'Space'), 'text')).toBeNull()
  })

  it.each(['ctrlKey', 'altKey', 'metaKey'] as const)('stops with %s held', (modifier) => {
    expect(intentOf(press(' ', 'Space', { [modifier]: true }), 'elsewhere')).toEqual({
      do: 'stop-all',
    })
  })

  it('is told by the key as well as by its place', () => {
    expect(intentOf(press(' ', ''), 'elsewhere')).toEqual({ do: 'stop-all' })
    expect(intentOf(press('Unidentified', 'Space'), 'elsewhere')).toEqual({ do: 'stop-all' })
  })
})

describe('arrows and letters', () => {
  it('drive where nothing else wants them', () => {
    expect(intentOf(press('ArrowUp'), 'elsewhere')).toEqual({ do: 'drive', direction: 'forward' })
    expect(intentOf(press('a', 'KeyA'), 'elsewhere')).toEqual({ do: 'drive', direction: 'left' })
  })

  it.each(['text', 'choice', 'dialog'] as const)('do not drive with the focus on: %s', (focus) => {
    expect(intentOf(press('ArrowUp'), focus)).toBeNull()
    expect(intentOf(press('w', 'KeyW'), focus)).toBeNull()
  })

  it.each(['slider', 'list'] as const)('leave arrows, not letters, to a %s', (focus) => {
    expect(intentOf(press('ArrowUp'), focus)).toBeNull()
    expect(intentOf(press('w', 'KeyW'), focus)).toEqual({ do: 'drive', direction: 'forward' })
  })

  it('are a browser shortcut with a modifier', () => {
    expect(intentOf(press('ArrowLeft', 'ArrowLeft', { altKey: true }), 'elsewhere')).toBeNull()
    expect(intentOf(press('s', 'KeyS', { ctrlKey: true }), 'elsewhere')).toBeNull()
  })
})

describe('Escape', () => {
  it('leaves a text field, closes a dialog by itself, otherwise lets go', () => {
    expect(intentOf(press('Escape'), 'text')).toEqual({ do: 'leave-field' })
    expect(intentOf(press('Escape'), 'dialog')).toBeNull()
    expect(intentOf(press('Escape'), 'elsewhere')).toEqual({ do: 'let-go' })
  })
})

describe('focusOf', () => {
  it.each([
    ['<input type="search">', 'text'],
    ['<input>', 'text'],
    ['<textarea></textarea>', 'text'],
    ['<input type="range">', 'slider'],
    ['<input type="checkbox">', 'elsewhere'],
    ['<select></select>', 'choice'],
    ['<button></button>', 'elsewhere'],
    ['<div role="listbox"></div>', 'list'],
  ] as const)('%s is %s', (html, expected) => {
    document.body.innerHTML = html
    expect(focusOf(document.body.firstElementChild)).toBe(expected)
  })

  it('knows what is inside a dialog', () => {
    document.body.innerHTML = '<dialog open><button></button></dialog>'
    expect(focusOf(document.querySelector('button'))).toBe('dialog')
  })
})

describe('keys in the arena', () => {
  it.each([
    ['ArrowUp', { do: 'pan', x: 0, y: 1 }],
    ['ArrowLeft', { do: 'pan', x: -1, y: 0 }],
    ['Enter', { do: 'aim', add: false }],
    ['Home', { do: 'fit' }],
  ] as const)('%s', (key, intent) => {
    expect(intentOf(press(key), 'arena')).toEqual(intent)
  })

  it('Shift and Enter add to the group', () => {
    expect(intentOf(press('Enter', 'Enter', { shiftKey: true }), 'arena')).toEqual({
      do: 'aim',
      add: true,
    })
  })

  it.each(['f', 'g', 'l'] as const)('%s is a tool, but a letter in a field', (key) => {
    expect(intentOf(press(key), 'elsewhere')).not.toBeNull()
    expect(intentOf(press(key.toUpperCase()), 'arena')).not.toBeNull()
    expect(intentOf(press(key), 'text')).toBeNull()
    expect(intentOf(press(key, key, { ctrlKey: true }), 'elsewhere')).toBeNull()
  })

  it('WASD drives there too, arrows do not', () => {
    expect(intentOf(press('w', 'KeyW'), 'arena')).toEqual({ do: 'drive', direction: 'forward' })
    expect(intentOf(press('ArrowUp'), 'arena')).not.toHaveProperty('direction')
  })
})

describe('Tab', () => {
  it('goes to the next robot on a pad that has the keyboard, and nowhere else', () => {
    expect(intentOf(press('Tab'), 'pad')).toEqual({ do: 'neighbour', step: 1 })
    expect(intentOf(press('Tab', 'Tab', { shiftKey: true }), 'pad')).toEqual({
      do: 'neighbour',
      step: -1,
    })
    for (const focus of EVERYWHERE.filter((where) => where !== 'pad')) {
      expect(intentOf(press('Tab'), focus)).toBeNull()
    }
  })

  it('leaves a pad that has not', () => {
    document.body.innerHTML = `
      <div data-keys="arena" id="a"></div>
      <div data-captured="true"><button id="b"></button></div>
      <div data-captured="false"><button id="c"></button></div>`
    const at = (id: string) => focusOf(document.getElementById(id))
    expect([at('a'), at('b'), at('c')]).toEqual(['arena', 'pad', 'elsewhere'])
  })
})
