import { describe, expect, it } from 'vitest'
import type { Signs } from '../../src/fleet/health'
import { findings, modeOf, verdict } from '../../src/fleet/health'
import type { Figures } from '../../src/fleet/openmetrics'
import { figuresOf, parseMetrics, quantile, recent } from '../../src/fleet/openmetrics'
import { FAULT_NAMES, FAULTS, specOf } from '../../src/fleet/faults'
import { size } from '../../src/strings-health'
import told from '../../interface.json?raw'

const figures: Figures = figuresOf('', 0)
const well: Signs = {
  connection: 'live',
  age: 0.2,
  readiness: { broker: true, simulation: null, journal: true, audit: true },
  stop: 'armed',
  counts: { online: 5, stale: 0, offline: 0, error: 0, low: 0, fence: 0 },
  figures,
  recent: { completed: 9, answered: 9, median: 0.1, slow: 0.2 },
}
const codes = (change: Partial<Signs>) =>
  findings({ ...well, ...change }).map(({ code, gravity }) => `${gravity} ${code}`)

describe('how things are', () => {
  it('is well when nothing is wrong', () => {
    expect(findings(well)).toEqual([])
    expect(verdict([], 'live')).toEqual({ gravity: 'good', words: 'All well' })
    expect(verdict([], 'connecting').gravity).toBe('watch')
  })

  it('names the worst first, and a single thing by name', () => {
    const found = findings({
      ...well,
      readiness: { broker: false, simulation: false, journal: true, audit: true },
      counts: { online: 5, stale: 1, offline: 2, error: 0, low: 1, fence: 3 },
    })
    expect(found.map(({ code }) => code)).toEqual([
      'broker',
      'simulation',
      'stale',
      'offline',
      'fence',
      'low',
    ])
    expect(verdict(found, 'live')).toEqual({ gravity: 'bad', words: '6 to look at' })
    const [stale] = findings({ ...well, counts: { ...well.counts, stale: 1 } })
    expect(stale?.words).toBe('One robot has not been heard of for a few seconds.')
    expect(stale?.link).toBe('#/robots?show=stale')
  })

  it('tells that the server cannot write', () => {
    const readiness = { broker: true, simulation: null, journal: false, audit: false }
    expect(codes({ readiness })).toEqual(['bad journal', 'bad audit'])
    const [found] = findings({ ...well, readiness: { ...readiness, audit: true } })
    expect(verdict(found === undefined ? [] : [found], 'live').words).toBe('Commands not kept')
  })

  it('says how old what is seen is', () => {
    const [lost] = findings({ ...well, connection: 'waiting', age: 61 })
    expect(lost?.words).toContain('61 s old')
    expect(codes({ connection: 'silent' })).toEqual(['bad silent'])
  })

  it('does not take an emergency stop for errors of robots', () => {
    const counts = { ...well.counts, error: 5 }
    expect(codes({ counts })).toEqual(['bad error'])
    expect(codes({ counts, stop: 'stopped' })).toEqual(['watch stop'])
  })

  it('tells no robot from none online', () => {
    const none = { online: 0, stale: 0, offline: 0, error: 0, low: 0, fence: 0 }
    expect(codes({ counts: none })).toEqual(['watch empty'])
    expect(codes({ counts: { ...none, offline: 3 } })).toEqual(['bad none'])
  })

  it('watches the database and commands', () => {
    const database = { ...figures.database, free: 5e7, dropped: 3, queued: 2e5, damaged: 1 }
    expect(codes({ figures: { ...figures, duplicates: 1, database } })).toEqual([
      'bad twins',
      'bad space',
      'watch dropped',
      'watch damaged',
      'watch queued',
    ])
    const failing = { completed: 6, answered: 10, median: null, slow: null }
    expect(codes({ recent: failing })).toEqual(['watch commands'])
    expect(codes({ recent: { ...failing, completed: 1, answered: 2 } })).toEqual([])
  })

  it('knows what kind of fleet it is', () => {
    expect(modeOf({ simulated: 0, emulated: 0, physical: 0 })).toBe('none')
    expect(modeOf({ simulated: 2, emulated: 1, physical: 0 })).toBe('simulation')
    expect(modeOf({ simulated: 0, emulated: 0, physical: 1 })).toBe('physical')
    expect(modeOf({ simulated: 1, emulated: 0, physical: 1 })).toBe('hybrid')
  })
})

const TEXT = `# TYPE terracrawler_command_answers counter
terracrawler_command_answers_total{status="completed"} 10
terracrawler_command_answers_total{status="timeout"} 2
terracrawler_command_latency_seconds_bucket{le="0.1",command="stop"} 5
terracrawler_command_latency_seconds_bucket{le="0.1",command="drive"} 3
terracrawler_command_latency_seconds_bucket{le="1.0",command="stop"} 6
terracrawler_command_latency_seconds_bucket{le="1.0",command="drive"} 4
terracrawler_command_latency_seconds_bucket{le="+Inf",command="stop"} 6
terracrawler_command_latency_seconds_bucket{le="+Inf",command="drive"} 4
terracrawler_broker_connected 1
terracrawler_history_dropped_total 7
terracrawler_data_free_bytes 54000000000
terracrawler_build_info{version="0.3.0"} 1
terracrawler_odd{a="b
nonsense
# EOF
`

describe('what the server says of itself', () => {
  it('is read, and what cannot be is passed over', () => {
    const found = figuresOf(TEXT, 5)
    expect(found.answers).toEqual({ completed: 10, timeout: 2 })
    expect(found.latency).toEqual([
      [0.1, 8],
      [1, 10],
      [Number.POSITIVE_INFINITY, 10],
    ])
    expect(found.broker.connected).toBe(true)
    expect(found.database).toMatchObject({ dropped: 7, free: 54e9, size: null, queued: 0 })
    expect(found.version).toBe('0.3.0')
    expect(parseMetrics('a{b="c\\"d"} 1', ['a'])).toHaveLength(1)
    expect(parseMetrics('a NaN\na x', ['a'])).toEqual([])
  })

  it('gives what happened between two readings', () => {
    const now = figuresOf(TEXT, 10_000)
    const before: Figures = {
      ...now,
      answers: { completed: 6, timeout: 2 },
      latency: [
        [0.1, 6],
        [1, 6],
        [Number.POSITIVE_INFINITY, 6],
      ],
    }
    expect(recent(now, before)).toMatchObject({ completed: 4, answered: 4 })
    expect(recent(now, before).median).toBeCloseTo(0.1)
    // The server has been restarted in between.
    const restarted = { ...now, answers: { completed: 90 }, latency: [[0.1, 90]] as const }
    expect(recent(now, restarted)).toMatchObject({ completed: 10, answered: 12 })
  })

  it('reads quantiles off buckets', () => {
    const buckets = [
      [1, 0],
      [2, 10],
      [Number.POSITIVE_INFINITY, 10],
    ] as const
    expect(quantile(buckets, 0.5)).toBeCloseTo(1.5)
    expect(quantile([[Number.POSITIVE_INFINITY, 4]], 0.5)).toBe(0)
    expect(quantile([], 0.5)).toBe(null)
  })

  it('is written in sizes that people read', () => {
    expect([size(0), size(999), size(8_000_000), size(54e9), size(123e9)]).toEqual([
      '0 B',
      '999 B',
      '8.0 MB',
      '54.0 GB',
      '123 GB',
    ])
  })
})

interface Variant {
  properties: Record<string, { const?: string; type?: string; $ref?: string }>
  required: string[]
}

describe('faults', () => {
  it('have the fields that the server wants', () => {
    const { messages } = JSON.parse(told) as {
      messages: { 'simulator-command': { $defs: { FaultSpec: { oneOf: Variant[] } } } }
    }
    const variants = messages['simulator-command'].$defs.FaultSpec.oneOf
    expect(variants.map(({ properties }) => properties['fault']?.const).sort()).toEqual(
      [...FAULT_NAMES].sort(),
    )
    for (const { properties, required } of variants) {
      const name = FAULT_NAMES.find((known) => known === properties['fault']?.const)
      const spec = name === undefined ? null : specOf(name, usual(name), 'left')
      expect(Object.keys(spec ?? {}).sort()).toEqual([...required].sort())
    }
  })

  it('are refused with a number that is none', () => {
    expect(specOf('battery-at', '0,25', 'left')).toEqual({ fault: 'battery-at', charge: 0.25 })
    expect(specOf('clock-step', '−50', 'left')).toEqual({ fault: 'clock-step', ms: -50 })
    for (const number of ['', 'x', '1.5', '-1']) {
      expect(specOf('battery-at', number, 'left')).toBe(null)
    }
    expect(specOf('ranger-stuck', '2.5', 'left')).toBe(null)
  })
})

function usual(name: (typeof FAULT_NAMES)[number]): string {
  return String(FAULTS[name].number?.usual ?? '')
}
