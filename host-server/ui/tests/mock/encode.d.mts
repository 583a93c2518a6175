export interface PoseRow {
  index: number
  x: number
  y: number
  heading: number
  state: string
  presence: string
  rangeMm?: number | null
  lowBattery?: boolean
}

export function jsonFrame(
  kind: 'hello' | 'roster' | 'event' | 'metrics',
  body: unknown,
): ArrayBuffer

export function posesFrame(frame: {
  full?: boolean
  ms: number
  x0?: number
  y0?: number
  unit?: number
  robots: readonly PoseRow[]
  bitmap?: boolean
}): ArrayBuffer
