import { describe, expect, it } from 'vitest'
import { inOrder } from '../../src/in-order'

describe('one after the other', () => {
  it('begins what is pressed meanwhile when the one before has ended, well or not', async () => {
    const line = inOrder(3)
    const log: string[] = []
    const ends: (() => void)[] = []
    const task = (name: string, fails = false) => {
      return () =>
        new Promise<string>((resolve, reject) => {
          log.push(name)
          ends.push(() => {
            if (fails) reject(new Error(name))
            else resolve(name)
          })
        })
    }
    const step = line.run(task('step', true))
    const resume = line.run(task('resume'))
    await Promise.resolve()
    expect(log).toEqual(['step'])
    expect(line.waiting.value).toBe(2)
    ends[0]?.()
    await expect(step).rejects.toThrow('step')
    await expect.poll(() => log).toEqual(['step', 'resume'])
    ends[1]?.()
    await expect(resume).resolves.toBe('resume')
    expect(line.waiting.value).toBe(0)
  })

  it('takes no more than so many', () => {
    const line = inOrder(1)
    const forever = () => new Promise<never>(() => undefined)
    expect(line.run(forever)).not.toBeNull()
    expect(line.run(forever)).toBeNull()
  })
})
