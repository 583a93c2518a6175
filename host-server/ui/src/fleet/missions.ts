/** Reading what a person types for behaviours with parameters. */

/** Most places of one command. */
export const MOST_PLACES = 8
/** Farthest coordinate of a place that a robot takes, in metres. */
const FARTHEST = 1_000
/** Nearer to a wall nobody stands, in metres. */
const BODY = 0.1

/** The number in a text, with a point or a comma, if it is one within these bounds. */
export function bounded(text: string, least: number, most: number): number | null {
  const trimmed = text.trim()
  const value = trimmed === '' ? Number.NaN : Number(trimmed.replace(',', '.'))
  return value >= least && value <= most ? value : null
}

/** Corners as {@link places} reads them, in whole centimetres. */
export function asText(corners: readonly (readonly number[])[]): string {
  const along = (value: number): string => String(Math.round(value * 100) / 100)
  return corners.map((corner) => corner.map(along).join(' ')).join('; ')
}

/** The corners of an arena of this size round the origin, where robots can stand. */
export function cornersOf(width: number, height: number): number[][] {
  const [x, y] = [width / 2 - BODY, height / 2 - BODY]
  return [
    [-x, -y],
    [x, -y],
    [x, y],
    [-x, y],
  ]
}

/**
 * Places as `x y; x y`: a semicolon or a new line between two, space between the numbers of one, and
 * a comma there too where a point is in the numbers. `null` where it is anything else, or too many.
 */
export function places(text: string): [number, number][] | null {
  const parts = text.split(/[;\n]/).filter((part) => part.trim() !== '')
  if (parts.length === 0 || parts.length > MOST_PLACES) return null
  const read: [number, number][] = []
  for (const part of parts) {
    const numbers = part
      .trim()
      .split(/\s*,\s+|\s+|,/)
      .map((along) => bounded(along, -FARTHEST, FARTHEST))
    const [x, y] = numbers
    if (numbers.length !== 2 || x === undefined || y === undefined) return null
    if (x === null || y === null) return null
    read.push([x, y])
  }
  return read
}
