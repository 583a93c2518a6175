/** The floor that a drive may take, as an SVG path with the robot in it. */

export interface Outline {
  viewBox: string
  path: string
}

const MARGIN = 0.15

/** `null` without an area. The y axis of the floor goes up. */
export function outlineOf(area: readonly (readonly number[])[]): Outline | null {
  if (area.length < 3) return null
  const xs = area.map((corner) => corner[0] ?? 0)
  const ys = area.map((corner) => -(corner[1] ?? 0))
  const [left, right] = [Math.min(...xs) - MARGIN, Math.max(...xs) + MARGIN]
  const [top, bottom] = [Math.min(...ys) - MARGIN, Math.max(...ys) + MARGIN]
  const box = [left, top, right - left, bottom - top]
  const path = xs.map(
    (x, at) => `${at === 0 ? 'M' : 'L'}${x.toFixed(3)} ${(ys[at] ?? 0).toFixed(3)}`,
  )
  return {
    viewBox: box.map((value) => value.toFixed(3)).join(' '),
    path: `${path.join(' ')} Z`,
  }
}
