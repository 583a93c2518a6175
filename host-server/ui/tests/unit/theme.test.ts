import { describe, expect, it } from 'vitest'
import css from '../../src/styles/theme.css?raw'
import { parseColour } from '../../src/theme'

function properties(block: string): Map<string, string> {
  return new Map(
    [...block.matchAll(/(--[\w-]+):\s*([^;]+);/g)].map((m) => [m[1] ?? '', m[2] ?? '']),
  )
}

function block(start: string): Map<string, string> {
  const from = css.indexOf(start)
  if (from < 0) throw new Error(`no ${start}`)
  return properties(css.slice(from, css.indexOf('}', from)))
}

function luminance(colour: string): number {
  const [r, g, b] = parseColour(colour).map((c) =>
    c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4,
  ) as [number, number, number]
  return 0.2126 * r + 0.7152 * g + 0.0722 * b
}

function contrast(a: string, b: string): number {
  const [low, high] = [luminance(a), luminance(b)].sort((x, y) => x - y) as [number, number]
  return (high + 0.05) / (low + 0.05)
}

const light = block(':root {')
const dark = block(":root[data-theme='dark'] {")

describe('colours', () => {
  it('are the same dark ones by choice and by system', () => {
    expect(block(":root[data-theme='system'] {")).toEqual(dark)
    expect([...dark.keys()].sort()).toEqual([...light.keys()].sort())
  })

  describe.each([
    ['light', light],
    ['dark', dark],
  ])('in %s', (_, theme) => {
    const of = (name: string) => theme.get(name) ?? ''

    it.each([
      ['--text', '--panel'],
      ['--text', '--raised'],
      ['--quiet', '--panel'],
      ['--quiet', '--raised'],
      ['--quiet', '--back'],
      ['--warn', '--panel'],
      ['--accent', '--panel'],
      ['--accent-text', '--accent'],
      ['--danger-text', '--panel'],
      ['--danger-text', '--raised'],
      ['--danger-text', '--danger-soft'],
      ['--text', '--danger-soft'],
    ])('text in %s on %s is readable (4.5:1)', (ink, paper) => {
      expect(contrast(of(ink), of(paper))).toBeGreaterThanOrEqual(4.5)
    })

    it('the stop button is readable (4.5:1)', () => {
      expect(contrast('#ffffff', of('--danger'))).toBeGreaterThanOrEqual(4.5)
      expect(contrast('#ffffff', of('--danger-deep'))).toBeGreaterThanOrEqual(4.5)
    })

    const states = [...light.keys()].filter((name) => name.startsWith('--state-'))
    it.each(states)('%s stands out from the floor (3:1, gone 2:1)', (state) => {
      const least = state === '--state-gone' ? 2 : 3
      expect(contrast(of(state), of('--arena-floor'))).toBeGreaterThanOrEqual(least)
    })

    it.each(states.filter((name) => name !== '--state-gone'))(
      'the mark stands out from %s (3:1)',
      (state) => {
        expect(contrast(of('--arena-mark'), of(state))).toBeGreaterThanOrEqual(3)
      },
    )
  })
})

describe('parseColour', () => {
  it('reads long and short notation', () => {
    expect(parseColour('#ff0080')).toEqual([1, 0, 128 / 255])
    expect(parseColour(' #fff ')).toEqual([1, 1, 1])
  })

  it('shows what it cannot read', () => {
    expect(parseColour('rebeccapurple')).toEqual([1, 0, 1])
  })
})
