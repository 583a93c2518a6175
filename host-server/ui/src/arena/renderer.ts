/** Draws the arena with raw WebGL2. Knows no Vue and no document. */

import type { Arena } from '../feed/decode'
import type { Robot } from '../fleet/fleet'
import type { Camera, Size } from './camera'
import type { Program } from './gl'
import { createArray, createProgram, drawsOnProcessor, made } from './gl'
import type { Scene } from './scene'
import { buildScene } from './scene'
import {
  CONE_FRAGMENT,
  CONE_STEPS,
  CONE_VERTEX,
  ROBOT_FRAGMENT,
  ROBOT_VERTEX,
  SCENE_FRAGMENT,
  SCENE_VERTEX,
  TRAIL_CORNERS,
  TRAIL_FRAGMENT,
  TRAIL_VERTEX,
} from './shaders'
import { ROW, TEXELS, Texels } from './texels'
import type { Past } from './trails'
import { TRAIL, Trails } from './trails'

export type Rgb = readonly [number, number, number]

/** Colours of the arena, 0 to 1. */
export interface Palette {
  background: Rgb
  floor: Rgb
  grid: Rgb
  wall: Rgb
  obstacle: Rgb
  edge: Rgb
  /** Borders of the cells that robots listen in. */
  cell: Rgb
  patch: Rgb
  /** Colours of things, in the order of the feed. */
  things: readonly Rgb[]
  /** One per state, in the order of the wire. */
  states: readonly Rgb[]
  /** Marks inside a robot. */
  mark: Rgb
  outline: Rgb
  /** Heavy frame of a physical robot. */
  frame: Rgb
  gone: Rgb
  accent: Rgb
}

/** Radius of a robot, metres, drawn no smaller than {@link View.smallest} pixels. */
const ROBOT_RADIUS = 0.1
/** Half the opening of a US-100's beam. */
const CONE_HALF_ANGLE = (7.5 * Math.PI) / 180
/** Readings beyond this are drawn as "nothing in reach", metres. */
const LONGEST_CONE = 4.5

export interface View {
  camera: Camera
  size: Size
  /** Server time to draw, Unix milliseconds. */
  time: number
  /** Smallest radius of a robot, CSS pixels. */
  smallest: number
  cones: Extent
  trails: Extent
  /** Robots are drawn as points: clusters say what there is. */
  points: boolean
}

/** Of which robots something is drawn. */
export type Extent = 'all' | 'selected' | 'none'

/** Robots drawn with what only selected ones have, at most. */
const MOST_CHOSEN = 64

interface Resources {
  robots: Program
  cones: Program
  trails: Program
  scene: Program
  texture: WebGLTexture
  history: WebGLTexture
  triangles: WebGLBuffer
  lines: WebGLBuffer
  sceneArray: WebGLVertexArrayObject
  lineArray: WebGLVertexArrayObject
  emptyArray: WebGLVertexArrayObject
}

export class Renderer {
  private resources: Resources | null = null
  private palette: Palette | null = null
  private scene: Scene | null = null
  private readonly texels = new Texels()
  private readonly trails = new Trails()
  /** Rows of the textures as they were last made. */
  private rows = 0
  private historyRows = 0
  /** Slots of the robots that are selected, the one that is driven last. */
  private chosen: readonly number[] = []
  /** Server time that texel times are relative to. */
  private base = 0

  private constructor(
    private readonly gl: WebGL2RenderingContext,
    /** Drawing is done by the processor: every pixel and every picture costs. */
    readonly slow: boolean,
  ) {}

  /** Null when the browser has no WebGL2. */
  static create(canvas: HTMLCanvasElement): Renderer | null {
    const slow = drawsOnProcessor()
    const gl = canvas.getContext('webgl2', {
      alpha: false,
      antialias: !slow,
      depth: false,
      stencil: false,
    })
    if (gl === null) return null
    const renderer = new Renderer(gl, slow)
    renderer.restore()
    return renderer
  }

  /** The context is gone; nothing may be drawn until {@link restore}. */
  lose(): void {
    this.resources = null
  }

  /** Builds everything the context holds, at the start and after a loss. */
  restore(): void {
    this.resources = createResources(this.gl)
    this.rows = 0
    this.historyRows = 0
    this.upload()
    this.uploadScene()
  }

  setPalette(palette: Palette): void {
    this.palette = palette
  }

  setArena(arena: Arena | null): void {
    this.scene = arena === null ? null : buildScene(arena)
    this.uploadScene()
  }

  /**
   * Takes over poses and states; call once per feed frame, not per picture. `base` is the server's
   * time now, `now` the page's. Trails are what was shown before, or what `past` tells.
   */
  setRobots(
    robots: () => Iterable<Robot>,
    selected: string | null,
    group: ReadonlySet<string>,
    base: number,
    now: number,
    past?: Past,
  ): void {
    this.base = base
    this.chosen = this.texels.write(robots(), selected, group, base).slice(-MOST_CHOSEN)
    this.trails.reserve(this.texels.capacity)
    if (past === undefined) this.trails.record(robots(), now)
    else this.trails.replay(robots(), past)
    this.upload()
  }

  draw(view: View): void {
    const { gl, resources, palette } = this
    if (resources === null || palette === null || gl.isContextLost()) return
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight)
    const back = this.scene === null ? palette.floor : palette.background
    gl.clearColor(back[0], back[1], back[2], 1)
    gl.clear(gl.COLOR_BUFFER_BIT)
    gl.disable(gl.BLEND)
    if (this.scene !== null) this.drawScene(resources, palette, view, this.scene)
    if (this.texels.slots === 0) return
    gl.enable(gl.BLEND)
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA)
    gl.bindVertexArray(resources.emptyArray)
    gl.activeTexture(gl.TEXTURE0)
    gl.bindTexture(gl.TEXTURE_2D, resources.texture)
    this.drawTrails(resources, palette, view)
    this.drawCones(resources, palette, view)
    this.drawRobots(resources, palette, view)
  }

  private drawScene(resources: Resources, palette: Palette, view: View, scene: Scene): void {
    const { gl } = this
    gl.useProgram(resources.scene.program)
    setView(gl, resources.scene, view)
    const { floor, grid, wall, obstacle, edge, cell, patch, things } = palette
    const tones = [floor, grid, wall, obstacle, edge, cell, patch, ...things]
    gl.uniform3fv(resources.scene.uniform('uTones'), tones.flat())
    gl.bindVertexArray(resources.sceneArray)
    gl.drawArrays(gl.TRIANGLES, 0, scene.floorVertices)
    if (view.camera.scale >= 12) {
      gl.bindVertexArray(resources.lineArray)
      gl.drawArrays(gl.LINES, 0, scene.lines.length / 3)
      gl.bindVertexArray(resources.sceneArray)
    }
    const rest = scene.triangles.length / 3 - scene.floorVertices
    if (rest > 0) gl.drawArrays(gl.TRIANGLES, scene.floorVertices, rest)
  }

  private drawTrails(resources: Resources, palette: Palette, view: View): void {
    if (view.trails === 'none') return
    const { gl } = this
    const program = resources.trails
    this.begin(program, palette, view)
    gl.activeTexture(gl.TEXTURE1)
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, resources.history)
    gl.uniform1i(program.uniform('uHistory'), 1)
    gl.uniform1i(program.uniform('uHead'), this.trails.head)
    gl.uniform1f(program.uniform('uWidth'), 1.25 / view.camera.scale)
    this.each(view.trails, TRAIL_CORNERS)
    gl.activeTexture(gl.TEXTURE0)
  }

  private drawCones(resources: Resources, palette: Palette, view: View): void {
    if (view.cones === 'none') return
    const { gl } = this
    this.begin(resources.cones, palette, view)
    gl.uniform1f(resources.cones.uniform('uHalfAngle'), CONE_HALF_ANGLE)
    gl.uniform1f(resources.cones.uniform('uLongest'), LONGEST_CONE)
    this.each(view.cones, 3 * CONE_STEPS)
  }

  private begin(program: Program, palette: Palette, view: View): void {
    const { gl } = this
    gl.useProgram(program.program)
    setView(gl, program, view)
    gl.uniform1i(program.uniform('uRobots'), 0)
    gl.uniform1f(program.uniform('uTime'), view.time - this.base)
    gl.uniform3fv(program.uniform('uStates'), palette.states.flat())
    gl.uniform3fv(program.uniform('uGone'), palette.gone)
  }

  /** Draws so many vertices for each robot, or for each that is selected. */
  private each(extent: Extent, vertices: number): void {
    const { gl, texels } = this
    if (extent === 'all') gl.drawArrays(gl.TRIANGLES, 0, texels.slots * vertices)
    else for (const slot of this.chosen) gl.drawArrays(gl.TRIANGLES, slot * vertices, vertices)
  }

  private drawRobots(resources: Resources, palette: Palette, view: View): void {
    const { gl } = this
    const program = resources.robots
    this.begin(program, palette, view)
    gl.uniform1f(program.uniform('uRadius'), drawnRadius(view))
    gl.uniform1f(program.uniform('uPoints'), view.points ? 1 : 0)
    gl.uniform3fv(program.uniform('uMark'), palette.mark)
    gl.uniform3fv(program.uniform('uOutline'), palette.outline)
    gl.uniform3fv(program.uniform('uFrame'), palette.frame)
    gl.uniform3fv(program.uniform('uAccent'), palette.accent)
    this.each('all', 6)
    // Once more, so that they are on top and never points.
    if (this.chosen.length === 0) return
    gl.uniform1f(program.uniform('uPoints'), 0)
    this.each('selected', 6)
  }

  private upload(): void {
    const { gl, resources, texels, trails } = this
    const width = ROW * TEXELS
    const rows = texels.capacity / ROW
    if (resources === null || rows === 0) return
    gl.activeTexture(gl.TEXTURE0)
    gl.bindTexture(gl.TEXTURE_2D, resources.texture)
    if (rows !== this.rows) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, rows, 0, gl.RGBA, gl.FLOAT, texels.data)
      this.rows = rows
    } else {
      const used = Math.max(1, Math.ceil(texels.slots / ROW))
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, used, gl.RGBA, gl.FLOAT, texels.data)
    }
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, resources.history)
    if (rows !== this.historyRows) {
      gl.texImage3D(
        gl.TEXTURE_2D_ARRAY,
        ...([0, gl.RG32F, ROW, rows, TRAIL, 0, gl.RG, gl.FLOAT] as const),
        null,
      )
      this.historyRows = rows
      trails.layers.forEach((_, number) => trails.dirty.add(number))
    }
    for (const number of trails.dirty) {
      const layer = trails.layers[number]
      if (layer === undefined) continue
      gl.texSubImage3D(
        gl.TEXTURE_2D_ARRAY,
        ...([0, 0, 0, number, ROW, rows, 1, gl.RG, gl.FLOAT] as const),
        layer,
      )
    }
    trails.dirty.clear()
  }

  private uploadScene(): void {
    const { gl, resources, scene } = this
    if (resources === null || scene === null) return
    gl.bindBuffer(gl.ARRAY_BUFFER, resources.triangles)
    gl.bufferData(gl.ARRAY_BUFFER, scene.triangles, gl.STATIC_DRAW)
    gl.bindBuffer(gl.ARRAY_BUFFER, resources.lines)
    gl.bufferData(gl.ARRAY_BUFFER, scene.lines, gl.STATIC_DRAW)
  }
}

/** Radius at which a robot is drawn, metres. */
export function drawnRadius(view: Pick<View, 'camera' | 'smallest'>): number {
  return Math.max(ROBOT_RADIUS, view.smallest / view.camera.scale)
}

function setView(gl: WebGL2RenderingContext, program: Program, view: View): void {
  const { camera, size } = view
  gl.uniform2f(program.uniform('uCentre'), camera.x, camera.y)
  gl.uniform2f(
    program.uniform('uToClip'),
    (2 * camera.scale) / size.width,
    (2 * camera.scale) / size.height,
  )
}

/** A texture that holds numbers rather than a picture. */
function createTable(gl: WebGL2RenderingContext, target: GLenum): WebGLTexture {
  const texture = made(gl.createTexture())
  gl.bindTexture(target, texture)
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
    gl.texParameteri(target, name, gl.NEAREST)
  }
  return texture
}

function createResources(gl: WebGL2RenderingContext): Resources | null {
  try {
    const texture = createTable(gl, gl.TEXTURE_2D)
    const history = createTable(gl, gl.TEXTURE_2D_ARRAY)
    const triangles = made(gl.createBuffer())
    const lines = made(gl.createBuffer())
    return {
      robots: createProgram(gl, ROBOT_VERTEX, ROBOT_FRAGMENT),
      cones: createProgram(gl, CONE_VERTEX, CONE_FRAGMENT),
      trails: createProgram(gl, TRAIL_VERTEX, TRAIL_FRAGMENT),
      scene: createProgram(gl, SCENE_VERTEX, SCENE_FRAGMENT),
      texture,
      history,
      triangles,
      lines,
      sceneArray: createArray(gl, triangles),
      lineArray: createArray(gl, lines),
      emptyArray: made(gl.createVertexArray()),
    }
  } catch (error) {
    // A context that is lost while being set up hands out nulls; it comes back
    // with an event of its own. Anything else is a mistake in a shader.
    if (gl.isContextLost()) return null
    throw error
  }
}
