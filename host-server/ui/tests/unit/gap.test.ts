import { describe, expect, it } from 'vitest'
import type { FleetGapBody } from '../../src/api-types'
import { words } from '../../src/strings-gap'
import { gapRows } from '../../src/twin/gap'

type Measures = FleetGapBody['fleet']

const measures = (own: number | null, floor = 0.01): Measures => {
  const pair = (median: number) => ({ median, p90: 2 * median })
  const errors = (ahead_s: number, count: number) => ({
    ahead_s,
    count,
    way: own,
    own: own === null ? null : pair(own),
    nominal: own === null ? null : pair(2 * own),
    ratio: own === null ? null : 0.5,
    floor: own === null ? null : pair(floor),
    coverage: own === null ? null : { within_50: 0.4, within_95: 0.9 },
  })
  return {
    whole: own !== null,
    errors: [errors(1, 40), errors(10, 12)],
    innovations: { count: 90, coverage: null },
    displacements: {
      over_s: 2,
      count: 30,
      own: own === null ? null : 0.00123,
      nominal: own === null ? null : 0.004,
      floor: own === null ? null : 0.0001,
    },
  }
}
const robot = (name: string, of: Measures) => ({
  robot: name,
  certificate: name === 'ada-1' ? '01ab' : null,
  since: 5,
  measures: of,
})

describe('the reality gap', () => {
  it('has all robots first, then the worst beside their floor, and last who has driven too little', () => {
    const rows = gapRows({
      time: 9,
      fleet: measures(0.03),
      robots: [
        robot('new-1', measures(null)),
        robot('ada-1', measures(0.02, 0.01)),
        robot('eve-1', measures(0.02, 0.005)),
      ],
    })
    expect(rows.map((row) => row.robot)).toEqual([null, 'eve-1', 'ada-1', 'new-1'])
    const [, , ada, none] = rows
    expect(ada).toEqual({
      robot: 'ada-1',
      certificate: '01ab',
      since: 5,
      errors: [
        { own: 0.02, nominal: 0.04, floor: 0.01 },
        { own: 0.02, nominal: 0.04, floor: 0.01 },
      ],
      ratio: 0.5,
      within: 0.9,
      displacements: { own: 0.00123, nominal: 0.004, floor: 0.0001 },
      counts: [40, 12],
    })
    expect(none?.errors).toEqual([null, null])
    expect(none?.displacements).toBe(null)
  })

  it('says what there is too little for', () => {
    expect(words.value({ own: 0.0213, nominal: 0.04, floor: 0.01 })).toBe('2.1 cm')
    expect(words.floor({ own: 0.0213, nominal: 0.04, floor: 0.01 })).toBe('floor 1.0 cm')
    expect(words.distanceOf({ own: 0.00123, nominal: 0.04, floor: 0 })).toBe('1.23 mm')
    expect([words.value(null), words.floor(null), words.share(null)]).toEqual(['–', 'too few', '–'])
    expect(words.counts([40, 12])).toBe('40, 12')
  })
})
