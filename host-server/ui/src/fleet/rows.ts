/** Which rows of a long list are rendered: those in view and a few beyond each edge. */

export interface Window {
  first: number
  /** One behind the last. */
  end: number
}

/** Rows kept beyond each edge, so that scrolling shows no gaps. */
const SPARE = 6

export function visible(
  scrollTop: number,
  height: number,
  rowHeight: number,
  rows: number,
  spare = SPARE,
): Window {
  const first = Math.max(0, Math.min(rows - 1, Math.floor(scrollTop / rowHeight)) - spare)
  const end = Math.min(rows, Math.ceil((scrollTop + height) / rowHeight) + spare)
  return { first: Math.max(0, first), end: Math.max(end, 0) }
}

/** Where to scroll so that a row is in view; where it is when it already is. */
export function reveal(row: number, scrollTop: number, height: number, rowHeight: number): number {
  const [top, bottom] = [row * rowHeight, (row + 1) * rowHeight]
  if (top < scrollTop) return top
  return Math.max(scrollTop, bottom - height)
}

/** How many cards of at least this width stand side by side. */
export function columnsIn(width: number, least: number, gap: number): number {
  return Math.max(1, Math.floor((width + gap) / (least + gap)))
}
