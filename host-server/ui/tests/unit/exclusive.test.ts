import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest'
import type { Store } from '../../src/account/exclusive'
import { exclusively } from '../../src/account/exclusive'

beforeEach(() => {
  vi.useFakeTimers()
})
afterEach(() => {
  vi.useRealTimers()
})

describe('where the browser has no locks', () => {
  const store = (): Store & { kept: Map<string, string> } => {
    const kept = new Map<string, string>()
    return {
      kept,
      getItem: (key) => kept.get(key) ?? null,
      setItem: (key, value) => kept.set(key, value),
      removeItem: (key) => kept.delete(key),
    }
  }

  it('one tab waits for the other', async () => {
    const shared = store()
    let inside = 0
    let most = 0
    const act = async () => {
      inside += 1
      most = Math.max(most, inside)
      await new Promise((resolve) => setTimeout(resolve, 100))
      inside -= 1
    }
    const tabs = [0, 1, 2].map(() => exclusively('x', null, shared))
    const all = Promise.all(tabs.map((tab) => tab(act)))
    await vi.advanceTimersByTimeAsync(5_000)
    await all
    expect(most).toBe(1)
    expect(shared.kept.size).toBe(0)
  })

  it('a tab that died holds nobody up for long', async () => {
    const shared = store()
    shared.setItem('x', `gone ${String(Date.now() + 20_000)}`)
    let done = false
    const waiting = exclusively(
      'x',
      null,
      shared,
    )(() => {
      done = true
      return Promise.resolve()
    })
    await vi.advanceTimersByTimeAsync(15_000)
    expect(done).toBe(false)
    await vi.advanceTimersByTimeAsync(6_000)
    await waiting
    expect(done).toBe(true)
  })
})
