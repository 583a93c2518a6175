/**
 * What lies over the robots and changes seldom: counts of clusters, goals, the line of a lasso, the
 * cross that keys aim with. Drawn with Canvas2D, only when some of it changed or the view moved.
 */

import type { Camera, Size } from './camera'
import { toScreen } from './camera'
import type { Cluster } from './cluster'
import { badgeCount, badgeRadius } from './cluster'
import type { Goal } from './goals'
import type { Point } from './lasso'
import { SPACING } from './spread'

/** Colours as CSS writes them. */
export interface Ink {
  panel: string
  text: string
  accent: string
  ok: string
  danger: string
  /** One for each part of a cluster's ring. */
  mix: readonly string[]
}

/** What lies under everything else here; true when there was anything to draw. */
export type Under = (
  context: CanvasRenderingContext2D,
  ink: Ink,
  camera: Camera,
  size: Size,
) => boolean

export interface Over {
  camera: Camera
  size: Size
  /** The lowest first. */
  unders: Iterable<Under>
  clusters: readonly Cluster[]
  /** Goals, and where their robots are on the screen. */
  goals: readonly { goal: Goal; from: Point | null }[]
  lasso: readonly Point[]
  /** Where keys aim: the middle of the view. */
  cross: boolean
}

const TURN = 2 * Math.PI
/** Lines from robots to their goals: more of them hide what they lead to. */
const MOST_LINES = 16
/** Dashes of the ring for each part of the mix: what is told apart by colour is by pattern too. */
const DASHES: readonly (readonly number[])[] = [[], [1.5, 2], [5, 2], [], [1, 4]]
const WIDTHS: readonly number[] = [3, 2.5, 4.5, 6, 2]
const ERROR = 3

export function readInk(element: Element): Ink {
  const style = getComputedStyle(element)
  const tone = (name: string): string => style.getPropertyValue(name).trim()
  return {
    panel: tone('--panel'),
    text: tone('--text'),
    accent: tone('--arena-accent'),
    ok: tone('--ok'),
    danger: tone('--danger-text'),
    mix: ['moving', 'idle', 'caution', 'error', 'gone'].map((name) => tone(`--state-${name}`)),
  }
}

/** True when there was anything to draw. */
export function drawOver(surface: HTMLCanvasElement, ink: Ink, over: Over): boolean {
  const context = surface.getContext('2d')
  if (context === null) return false
  const ratio = surface.width / Math.max(1, over.size.width)
  context.setTransform(ratio, 0, 0, ratio, 0, 0)
  context.clearRect(0, 0, over.size.width, over.size.height)
  let under = false
  for (const lay of over.unders) under = lay(context, ink, over.camera, over.size) || under
  drawClusters(context, ink, over)
  drawGoals(context, ink, over)
  if (over.lasso.length > 1) drawLasso(context, ink, over.lasso)
  if (over.cross) drawCross(context, ink, over.size)
  const drawn = over.clusters.length + over.goals.length + over.lasso.length
  return under || drawn > 0 || over.cross
}

function drawClusters(context: CanvasRenderingContext2D, ink: Ink, over: Over): void {
  context.textAlign = 'center'
  context.textBaseline = 'middle'
  for (const { x, y, count, mix } of over.clusters) {
    const [sx, sy] = toScreen(over.camera, over.size, x, y)
    const r = badgeRadius(count)
    context.setLineDash([])
    context.fillStyle = ink.panel
    context.beginPath()
    context.arc(sx, sy, r, 0, TURN)
    context.fill()
    let from = -TURN / 4
    mix.forEach((part, kind) => {
      if (part === 0) return
      const to = from + (part / count) * TURN
      context.strokeStyle = ink.mix[kind] ?? ink.text
      context.lineWidth = WIDTHS[kind] ?? 3
      context.setLineDash(DASHES[kind] as number[])
      context.beginPath()
      context.arc(sx, sy, r, from, to)
      context.stroke()
      from = to
    })
    context.fillStyle = ink.text
    context.font = '600 11px system-ui, sans-serif'
    context.fillText(badgeCount(count), sx, sy + 0.5)
    if ((mix[ERROR] ?? 0) > 0) drawFault(context, ink, sx + r * 0.75, sy - r * 0.75)
  }
}

/** A cross in a disc: some of those counted report an error. */
function drawFault(context: CanvasRenderingContext2D, ink: Ink, x: number, y: number): void {
  context.setLineDash([])
  context.fillStyle = ink.mix[ERROR] ?? ink.danger
  context.beginPath()
  context.arc(x, y, 6, 0, TURN)
  context.fill()
  context.strokeStyle = ink.panel
  context.lineWidth = 1.8
  context.beginPath()
  context.moveTo(x - 2.3, y - 2.3)
  context.lineTo(x + 2.3, y + 2.3)
  context.moveTo(x + 2.3, y - 2.3)
  context.lineTo(x - 2.3, y + 2.3)
  context.stroke()
}

function drawGoals(context: CanvasRenderingContext2D, ink: Ink, over: Over): void {
  // Those of a group must not cover each other.
  const r = over.goals.length < 2 ? 9 : Math.min(9, Math.max(4, 0.4 * SPACING * over.camera.scale))
  const m = r / 9
  for (const { goal, from } of over.goals) {
    const [x, y] = toScreen(over.camera, over.size, goal.x, goal.y)
    const tone = { sending: ink.accent, going: ink.accent, reached: ink.ok, failed: ink.danger }
    context.strokeStyle = tone[goal.state]
    context.lineWidth = 2
    const lined = over.goals.length <= MOST_LINES
    if (lined && from !== null && (goal.state === 'going' || goal.state === 'sending')) {
      context.globalAlpha = 0.6
      context.setLineDash([4, 5])
      context.beginPath()
      context.moveTo(from[0], from[1])
      context.lineTo(x, y)
      context.stroke()
      context.globalAlpha = 1
    }
    // Not taken by the server yet: dashed. Reached: a tick. Failed: a cross.
    context.setLineDash(goal.state === 'sending' ? [3, 3] : [])
    context.beginPath()
    context.arc(x, y, r, 0, TURN)
    if (goal.state === 'reached') {
      context.moveTo(x - 4 * m, y)
      context.lineTo(x - m, y + 3.5 * m)
      context.lineTo(x + 4.5 * m, y - 3.5 * m)
    } else if (goal.state === 'failed') {
      context.moveTo(x - 4 * m, y - 4 * m)
      context.lineTo(x + 4 * m, y + 4 * m)
      context.moveTo(x + 4 * m, y - 4 * m)
      context.lineTo(x - 4 * m, y + 4 * m)
    } else {
      context.moveTo(x + 2.5 * m, y)
      context.arc(x, y, 2.5 * m, 0, TURN)
    }
    context.stroke()
  }
}

function drawLasso(context: CanvasRenderingContext2D, ink: Ink, line: readonly Point[]): void {
  context.beginPath()
  line.forEach(([x, y], i) => (i === 0 ? context.moveTo(x, y) : context.lineTo(x, y)))
  context.closePath()
  context.globalAlpha = 0.15
  context.fillStyle = ink.accent
  context.fill('evenodd')
  context.globalAlpha = 1
  context.strokeStyle = ink.accent
  context.lineWidth = 2
  context.setLineDash([6, 4])
  context.stroke()
}

function drawCross(context: CanvasRenderingContext2D, ink: Ink, size: Size): void {
  const [x, y] = [Math.round(size.width / 2), Math.round(size.height / 2)]
  context.setLineDash([])
  // Light under dark, so that it is seen on everything.
  for (const [tone, width] of [
    [ink.panel, 5],
    [ink.text, 2],
  ] as const) {
    context.strokeStyle = tone
    context.lineWidth = width
    context.beginPath()
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, 1],
      [0, -1],
    ] as const) {
      context.moveTo(x + 5 * dx, y + 5 * dy)
      context.lineTo(x + 14 * dx, y + 14 * dy)
    }
    context.stroke()
  }
}
