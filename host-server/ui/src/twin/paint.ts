/**
 * The twin of a robot on the canvas over the robots: a dashed outline of a robot with its heading where it is, a faint
 * disc of two deviations around it, and a dotted outline where it will be in a second, with the same around that. A
 * line leads from the one to the other.
 */

import type { TwinForecastsBody } from '../api-types'
import type { Camera, Size } from '../arena/camera'
import { toScreen } from '../arena/camera'
import type { Ink } from '../arena/overlay'

const TURN = 2 * Math.PI
/** As large as robots are drawn, metres, and no smaller than this, pixels. */
const RADIUS_M = 0.1
const LEAST_RADIUS = 7
/** So many deviations hold nineteen of twenty. */
const DEVIATIONS = 2
const DASHED = [4, 3]
const DOTTED = [1.5, 3]

type Pose = TwinForecastsBody['pose']

interface Painting {
  camera: Camera
  size: Size
  twin: TwinForecastsBody
}

/** Always true: there is a robot at least. */
export function paint(context: CanvasRenderingContext2D, ink: Ink, painting: Painting): boolean {
  const { camera, size, twin } = painting
  const at = (pose: Pose) => toScreen(camera, size, pose.x, pose.y)
  const soon = nearest(twin)
  const radius = Math.max(RADIUS_M * camera.scale, LEAST_RADIUS)
  context.save()
  context.lineCap = 'round'
  for (const pose of soon === null ? [twin.pose] : [twin.pose, soon]) {
    const [x, y] = at(pose)
    context.fillStyle = ink.accent
    context.globalAlpha = 0.15
    context.beginPath()
    context.arc(x, y, DEVIATIONS * pose.sigma * camera.scale, 0, TURN)
    context.fill()
  }
  context.globalAlpha = 1
  // Light under dark, so that it is seen on everything.
  for (const [tone, width] of [
    [ink.panel, 4],
    [ink.accent, 2],
  ] as const) {
    context.strokeStyle = tone
    context.lineWidth = width
    if (soon !== null) {
      const [[fromX, fromY], [toX, toY]] = [at(twin.pose), at(soon)]
      context.setLineDash([])
      context.beginPath()
      context.moveTo(fromX, fromY)
      context.lineTo(toX, toY)
      context.stroke()
      outline(context, at(soon), soon.theta, radius, DOTTED)
    }
    outline(context, at(twin.pose), twin.pose.theta, radius, DASHED)
  }
  context.restore()
  return true
}

/** The nearest of the forecasts. */
export function nearest(twin: TwinForecastsBody): Pose | null {
  return twin.forecasts[0]?.pose ?? null
}

/** A robot, and where it heads. On the screen y points down. */
export function outline(
  context: CanvasRenderingContext2D,
  [x, y]: readonly [number, number],
  theta: number,
  radius: number,
  dash: readonly number[],
): void {
  context.setLineDash(dash as number[])
  context.beginPath()
  context.arc(x, y, radius, 0, TURN)
  context.moveTo(x, y)
  context.lineTo(x + 1.5 * radius * Math.cos(theta), y - 1.5 * radius * Math.sin(theta))
  context.stroke()
}
