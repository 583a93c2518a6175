/** Intervals, and what two of them say about each other. */

/** Of the standard normal distribution: 95 % lie within so many deviations. */
const Z = 1.959964

interface Interval {
  low: number
  high: number
}

/**
 * Wilson's interval for a share, 95 %; of nothing it is everything.
 * E. B. Wilson, J. Am. Stat. Assoc. 22 (1927), 209–212.
 */
export function wilson(successes: number, all: number): Interval {
  if (all === 0) return { low: 0, high: 1 }
  const share = successes / all
  const z2 = Z * Z
  const middle = (share + z2 / (2 * all)) / (1 + z2 / all)
  const half = (Z / (1 + z2 / all)) * Math.sqrt((share * (1 - share) + z2 / (4 * all)) / all)
  return { low: Math.max(0, middle - half), high: Math.min(1, middle + half) }
}

export function overlap(a: Interval, b: Interval): boolean {
  return a.low <= b.high && b.low <= a.high
}
