/** The view on the arena: plain mathematics, y up in the world, down on the screen. */

export interface Camera {
  /** World point in the middle of the view, metres. */
  x: number
  y: number
  /** CSS pixels per metre. */
  scale: number
}

export interface Size {
  width: number
  height: number
}

export interface Bounds {
  minX: number
  minY: number
  maxX: number
  maxY: number
}

const MIN_SCALE = 1
const MAX_SCALE = 1_200

export function toScreen(camera: Camera, size: Size, x: number, y: number): [number, number] {
  return [
    size.width / 2 + (x - camera.x) * camera.scale,
    size.height / 2 - (y - camera.y) * camera.scale,
  ]
}

export function toWorld(camera: Camera, size: Size, x: number, y: number): [number, number] {
  return [
    camera.x + (x - size.width / 2) / camera.scale,
    camera.y - (y - size.height / 2) / camera.scale,
  ]
}

/** Zooms so that the world point under a screen point stays under it. */
export function zoomAt(
  camera: Camera,
  size: Size,
  screenX: number,
  screenY: number,
  factor: number,
): Camera {
  const [worldX, worldY] = toWorld(camera, size, screenX, screenY)
  const scale = clampScale(camera.scale * factor)
  return {
    x: worldX - (screenX - size.width / 2) / scale,
    y: worldY + (screenY - size.height / 2) / scale,
    scale,
  }
}

export function panBy(camera: Camera, dx: number, dy: number): Camera {
  return { ...camera, x: camera.x - dx / camera.scale, y: camera.y + dy / camera.scale }
}

/** Pixels to keep free at each edge. */
interface Margins {
  top: number
  sides: number
  bottom: number
}

/** The view that shows all of `bounds` within the margins. */
export function fit(bounds: Bounds, size: Size, margins: Margins): Camera {
  const width = Math.max(0.5, bounds.maxX - bounds.minX)
  const height = Math.max(0.5, bounds.maxY - bounds.minY)
  const scale = clampScale(
    Math.min(
      Math.max(1, size.width - 2 * margins.sides) / width,
      Math.max(1, size.height - margins.top - margins.bottom) / height,
    ),
  )
  return {
    x: (bounds.minX + bounds.maxX) / 2,
    // Unequal margins move the middle of what is free away from the middle of the view.
    y: (bounds.minY + bounds.maxY) / 2 + (margins.top - margins.bottom) / (2 * scale),
    scale,
  }
}

/** A round length of 40 to 120 pixels for the scale bar, metres. */
export function scaleBar(camera: Camera): number {
  const rough = 100 / camera.scale
  const power = 10 ** Math.floor(Math.log10(rough))
  for (const step of [5, 2, 1]) if (step * power <= rough) return step * power
  return power
}

function clampScale(scale: number): number {
  return Math.min(MAX_SCALE, Math.max(MIN_SCALE, scale))
}
