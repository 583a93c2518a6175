import { describe, expect, it } from 'vitest'
import type { Command, Outcome } from '../../src/api'
import type { Goal } from '../../src/arena/goals'
import { Goals } from '../../src/arena/goals'

function setUp(answers: Record<string, Outcome | Error> = {}) {
  const sent: [string, Command][] = []
  const asked: string[] = []
  const ended: Goal[] = []
  let now = 0
  const goals = new Goals({
    api: {
      commandRobot: (robot, command) => {
        sent.push([robot, command])
        return robot === 'refused'
          ? Promise.reject(new Error('no'))
          : Promise.resolve(`of ${robot} ${String(sent.length)}`)
      },
      outcome: (id) => {
        asked.push(id)
        const answer = answers[id] ?? outcome('accepted')
        return answer instanceof Error ? Promise.reject(answer) : Promise.resolve(answer)
      },
    },
    words: (status, reason) => `${status} ${String(reason)}`,
    onEnd: (goal) => ended.push(goal),
    now: () => now,
  })
  const states = () => goals.list.value.map(({ robot, state }) => `${robot} ${state}`)
  return { goals, sent, asked, ended, states, pass: (ms: number) => (now += ms) }
}

function outcome(status: string, reason: string | null = null): Outcome {
  return { status, reason, completed: 0, expected: 1 }
}

const place = (id: string) => ({ id, x: 1, y: 2 })

describe('goals', () => {
  it('are sent, followed and forgotten', async () => {
    const answers: Record<string, Outcome> = {}
    const { goals, sent, ended, states, pass } = setUp(answers)
    const sending = goals.send([place('a')])
    expect(states()).toEqual(['a sending'])
    await sending
    expect(sent).toEqual([['a', { command: 'goto', parameters: { x: 1, y: 2 } }]])
    await goals.ask()
    expect(states()).toEqual(['a going'])
    answers['of a 1'] = outcome('completed')
    await goals.ask()
    expect(states()).toEqual(['a reached'])
    expect(ended).toHaveLength(1)
    pass(3_000)
    await goals.ask()
    expect(states()).toEqual([])
  })

  it('say why they are not reached', async () => {
    const { goals, ended } = setUp({ 'of a 1': outcome('failed', 'blocked') })
    await goals.send([place('a'), place('refused')])
    await goals.ask()
    expect(ended.map(({ robot, why }) => `${robot}: ${String(why)}`)).toEqual([
      'refused: no',
      'a: failed blocked',
    ])
  })

  it('give way to newer ones of the same robot', async () => {
    const { goals, ended, states } = setUp({ 'of a 1': outcome('failed', 'interrupted') })
    await goals.send([place('a')])
    await goals.send([place('a')])
    await goals.ask()
    expect(states()).toEqual(['a going'])
    expect(ended).toEqual([])
  })

  it('are asked about in turns', async () => {
    const { goals, asked } = setUp()
    await goals.send(Array.from({ length: 30 }, (_, i) => place(`r${String(i)}`)))
    for (let i = 0; i < 3; i++) await goals.ask()
    expect(asked.length).toBe(36)
    expect(new Set(asked).size).toBe(30)
  })

  it('stay when an answer is lost, but not for ever', async () => {
    const { goals, states, pass } = setUp({ 'of a 1': new Error('gone') })
    await goals.send([place('a')])
    await goals.ask()
    expect(states()).toEqual(['a going'])
    pass(16 * 60_000)
    await goals.ask()
    expect(states()).toEqual([])
  })

  it('can be dropped', async () => {
    const { goals, states } = setUp()
    await goals.send([place('a')])
    goals.drop('a')
    expect(states()).toEqual([])
  })
})
