/**
 * Discs that hold 95 % of the draws, faint around each robot; a dashed outline where a robot was in fact, with a line
 * to where the simulation has it; the recorded way of the chosen robot dotted.
 */

import type { Camera, Size } from '../arena/camera'
import { toScreen } from '../arena/camera'
import type { Ink } from '../arena/overlay'
import { outline } from '../twin/paint'
import type { Ghost, Overlay } from './overlay'

const TURN = 2 * Math.PI
const DASHED = [4, 3]
const DOTTED = [1.5, 5]
/** A ghost nearer than this share of a robot's radius to its robot would only hide it; of the chosen one less does. */
const APART = 0.8
const CHOSEN_APART = 0.6

interface Painting {
  camera: Camera
  size: Size
  /** Of robots as they are drawn, pixels. */
  radius: number
  overlay: Overlay
}

/** True when there was anything to draw. */
export function paintOverlay(
  context: CanvasRenderingContext2D,
  ink: Ink,
  { camera, size, radius, overlay }: Painting,
): boolean {
  const at = ([x, y]: readonly [number, number]) => toScreen(camera, size, x, y)
  const ghosts = overlay.ghosts.filter(
    (ghost) => apart(ghost) * camera.scale > radius * (ghost.chosen ? CHOSEN_APART : APART),
  )
  context.save()
  context.lineCap = 'round'
  context.lineJoin = 'round'
  for (const disc of overlay.discs) {
    const [x, y] = at([disc.x, disc.y])
    context.fillStyle = context.strokeStyle = ink.accent
    context.beginPath()
    context.arc(x, y, disc.radius * camera.scale, 0, TURN)
    context.globalAlpha = disc.chosen ? 0.18 : 0.03
    context.fill()
    context.globalAlpha = disc.chosen ? 0.9 : 0.3
    context.lineWidth = disc.chosen ? 1.5 : 1
    context.stroke()
  }
  context.globalAlpha = 1
  if (overlay.way.length > 1) {
    context.strokeStyle = ink.text
    context.lineWidth = 2
    context.setLineDash(DOTTED)
    context.beginPath()
    overlay.way.forEach((place, i) => {
      if (i === 0) context.moveTo(...at(place))
      else context.lineTo(...at(place))
    })
    context.stroke()
  }
  for (const ghost of ghosts) {
    // Light under dark, so that it is seen on everything.
    for (const [tone, width] of [
      [ink.panel, 4],
      [ghost.outside ? ink.danger : ink.text, 2],
    ] as const) {
      context.strokeStyle = tone
      context.lineWidth = width
      context.setLineDash([])
      context.beginPath()
      context.moveTo(...at(ghost.drawn))
      context.lineTo(...at([ghost.x, ghost.y]))
      context.stroke()
      outline(context, at([ghost.x, ghost.y]), ghost.theta, radius, DASHED)
    }
  }
  context.restore()
  return overlay.discs.length + ghosts.length + overlay.way.length > 0
}

function apart({ x, y, drawn }: Ghost): number {
  return Math.hypot(x - drawn[0], y - drawn[1])
}
