import { describe, expect, it } from 'vitest'
import { watch } from 'vue'
import { Selection } from '../../src/fleet/selection'

describe('selection', () => {
  it('toggles, replaces, adds and clears', () => {
    const selection = new Selection()
    selection.toggle('a')
    selection.toggle('b')
    selection.toggle('a')
    expect([...selection.ids.value]).toEqual(['b'])
    selection.replace(['c', 'd', 'c'])
    expect(selection.size).toBe(2)
    selection.add(['d', 'e'])
    expect([...selection.ids.value]).toEqual(['c', 'd', 'e'])
    expect(selection.has('e')).toBe(true)
    selection.clear()
    expect(selection.size).toBe(0)
  })

  it('tells watchers of every change, and of nothing else', () => {
    const selection = new Selection()
    let changes = 0
    watch(selection.ids, () => (changes += 1), { flush: 'sync' })
    selection.add(['a'])
    selection.add(['a'])
    selection.clear()
    selection.clear()
    expect(changes).toBe(2)
  })
})
