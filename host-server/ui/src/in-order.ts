import { type Ref, ref } from 'vue'

/** Does one thing after the other, in the order in which they were asked for. */
interface InOrder {
  /** How many are under way or wait. */
  readonly waiting: Readonly<Ref<number>>
  /** Does `task` when all before it have ended, well or not; `null` when too many wait. */
  run: <T>(task: () => Promise<T>) => Promise<T> | null
}

/** At most `most` are under way or wait: more presses than that are not meant. */
export function inOrder(most: number): InOrder {
  const waiting = ref(0)
  let last: Promise<unknown> = Promise.resolve()
  return {
    waiting,
    run<T>(task: () => Promise<T>) {
      if (waiting.value >= most) return null
      waiting.value += 1
      const turn = last.then(task).finally(() => {
        waiting.value -= 1
      })
      // Whoever asked is told of a failure; the next goes on.
      last = turn.catch(() => undefined)
      return turn
    },
  }
}
