/** Reading what the server says of itself at `/metrics`. */

interface Sample {
  name: string
  labels: Readonly<Record<string, string>>
  value: number
}

const LINE = /^([a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{(.*)\})? (\S+)/
const LABEL = /([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\]|\\.)*)"/g

/** The samples whose name begins with one of these; lines that are none are passed over. */
export function parseMetrics(text: string, prefixes: readonly string[]): Sample[] {
  const samples: Sample[] = []
  for (const line of text.split('\n')) {
    if (!prefixes.some((prefix) => line.startsWith(prefix))) continue
    const match = LINE.exec(line)
    if (match === null) continue
    const [, name = '', inside = '', number = ''] = match
    const value = number === '+Inf' ? Number.POSITIVE_INFINITY : Number(number)
    if (Number.isNaN(value)) continue
    const labels = Object.fromEntries(
      [...inside.matchAll(LABEL)].map(([, key = '', text = '']) => [key, text]),
    )
    samples.push({ name, labels, value })
  }
  return samples
}

/** What the control room shows of it. */
export interface Figures {
  /** When it was read, in milliseconds of the page's clock. */
  at: number
  /** Last answers to commands, by what they came to. */
  answers: Readonly<Record<string, number>>
  /** Completed commands by the time they took: cumulative, `[seconds, count]`, rising. */
  latency: readonly (readonly [number, number])[]
  broker: { connected: boolean; losses: number; connections: number | null; queued: number | null }
  database: {
    written: number
    queued: number
    dropped: number
    failures: number
    damaged: number
    /** Bytes; `null` where nobody knows. */
    free: number | null
    size: number | null
  }
  duplicates: number
  version: string | null
}

const PREFIX = 'terracrawler_'
const FAMILIES = [
  'command_answers',
  'command_latency_seconds_bucket',
  'broker_',
  'embedded_broker_connections',
  'embedded_broker_queued',
  'history_',
  'data_',
  'robots_sharing_an_id',
  'build_info',
].map((name) => PREFIX + name)

export function figuresOf(text: string, at: number): Figures {
  const samples = parseMetrics(text, FAMILIES)
  const named = (name: string): Sample[] =>
    samples.filter((sample) => sample.name === PREFIX + name)
  const one = (name: string): number | null =>
    // Counters carry `_total` in OpenMetrics.
    (named(name)[0] ?? named(`${name}_total`)[0])?.value ?? null
  const buckets = new Map<number, number>()
  for (const { labels, value } of named('command_latency_seconds_bucket')) {
    const le = labels['le'] === '+Inf' ? Number.POSITIVE_INFINITY : Number(labels['le'])
    buckets.set(le, (buckets.get(le) ?? 0) + value)
  }
  return {
    at,
    answers: Object.fromEntries(
      named('command_answers_total').map(({ labels, value }) => [labels['status'] ?? '', value]),
    ),
    latency: [...buckets].sort(([a], [b]) => a - b),
    broker: {
      connected: one('broker_connected') === 1,
      losses: one('broker_losses') ?? 0,
      connections: one('embedded_broker_connections'),
      queued: one('embedded_broker_queued'),
    },
    database: {
      written: one('history_written') ?? 0,
      queued: one('history_queued') ?? 0,
      dropped: one('history_dropped') ?? 0,
      failures: one('history_failures') ?? 0,
      damaged: one('history_damaged') ?? 0,
      free: one('data_free_bytes'),
      size: one('data_size_bytes'),
    },
    duplicates: one('robots_sharing_an_id') ?? 0,
    version: named('build_info')[0]?.labels['version'] ?? null,
  }
}

/** What happened between two readings; the counters begin anew with the server. */
export interface Recent {
  completed: number
  answered: number
  /** Seconds that half, and 95 %, of the completed commands took at most. */
  median: number | null
  slow: number | null
}

export function recent(now: Figures, before: Figures): Recent {
  const since = (name: string): number => {
    const [new_, old] = [now.answers[name] ?? 0, before.answers[name] ?? 0]
    return new_ >= old ? new_ - old : new_
  }
  const answered = Object.keys(now.answers).reduce((sum, name) => sum + since(name), 0)
  const old = new Map(before.latency)
  const restarted = now.latency.some(([le, count]) => count < (old.get(le) ?? 0))
  const buckets = now.latency.map(
    ([le, count]) => [le, restarted ? count : count - (old.get(le) ?? 0)] as const,
  )
  return {
    completed: since('completed'),
    answered,
    median: quantile(buckets, 0.5),
    slow: quantile(buckets, 0.95),
  }
}

/** Linear within the bucket; the bound of the last finite one for what is beyond it. */
export function quantile(
  buckets: readonly (readonly [number, number])[],
  share: number,
): number | null {
  const total = buckets.at(-1)?.[1] ?? 0
  if (total <= 0) return null
  const rank = share * total
  let [lower, below] = [0, 0]
  for (const [le, count] of buckets) {
    if (count >= rank) {
      if (!Number.isFinite(le)) return lower
      const inside = count - below
      return inside <= 0 ? le : lower + ((le - lower) * (rank - below)) / inside
    }
    ;[lower, below] = [le, count]
  }
  return lower
}
