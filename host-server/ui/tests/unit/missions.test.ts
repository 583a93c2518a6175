import { describe, expect, it } from 'vitest'
import { asText, bounded, cornersOf, places } from '../../src/fleet/missions'

describe('what a person types for a mission', () => {
  it('takes places in the usual ways of writing', () => {
    expect(places('0 0; 2 0; 2 2.5')).toEqual([
      [0, 0],
      [2, 0],
      [2, 2.5],
    ])
    expect(places('-1.5,2\n 3 , 4 ;')).toEqual([
      [-1.5, 2],
      [3, 4],
    ])
  })

  it('writes corners as it reads them', () => {
    const corners = cornersOf(6, 4.5)
    expect(asText(corners)).toBe('-2.9 -2.15; 2.9 -2.15; 2.9 2.15; -2.9 2.15')
    expect(places(asText(corners))).toEqual(corners)
    expect(asText([[0.123456, -1]])).toBe('0.12 -1')
  })

  it('takes nothing else', () => {
    for (const text of ['', ';', '1', '1 2 3', 'a b', '1 2; 3', '1 2000', '1 2; '.repeat(9)]) {
      expect(places(text), text).toBeNull()
    }
  })

  it('keeps numbers within their bounds', () => {
    expect(bounded('0,6', 0.3, 2)).toBe(0.6)
    for (const text of ['', ' ', 'x', '0.2', '2.1', 'NaN', 'Infinity']) {
      expect(bounded(text, 0.3, 2), text).toBeNull()
    }
  })
})
