/** Fewer points that look the same: a chart is some hundred pixels wide. */

/**
 * Which of `count` values to draw, in rising order and `most` at the most: the first and the last,
 * and of every stretch between them the least and the greatest, so that no peak is lost.
 */
export function downsample(
  count: number,
  value: (at: number) => number | null,
  most: number,
): number[] {
  if (count <= most || count <= 2) return Array.from({ length: count }, (_, at) => at)
  const stretches = Math.max(1, Math.floor((most - 2) / 2))
  const kept = [0]
  const inner = count - 2
  for (let stretch = 0; stretch < stretches; stretch++) {
    const from = 1 + Math.floor((stretch * inner) / stretches)
    const to = 1 + Math.floor(((stretch + 1) * inner) / stretches)
    let [least, greatest] = [-1, -1]
    let [low, high] = [Infinity, -Infinity]
    for (let at = from; at < to; at++) {
      const here = value(at)
      if (here === null) continue
      if (here < low) [low, least] = [here, at]
      if (here > high) [high, greatest] = [here, at]
    }
    // A stretch without any value stays a gap.
    if (least === -1) kept.push(from)
    else if (least === greatest) kept.push(least)
    else kept.push(Math.min(least, greatest), Math.max(least, greatest))
  }
  kept.push(count - 1)
  return kept
}
