/** Draws the arena with raw WebGL2. Knows no Vue and no document. */

import type { Arena } from '../feed/decode'
import { KINDS, PRESENCES, STATES } from '../feed/decode'
import type { Robot } from '../fleet/fleet'
import type { Camera, Size } from './camera'
import type { Scene } from './scene'
import { buildScene } from './scene'
import {
  CONE_FRAGMENT,
  CONE_STEPS,
  CONE_VERTEX,
  ROBOT_FRAGMENT,
  ROBOT_VERTEX,
  ROW,
  SCENE_FRAGMENT,
  SCENE_VERTEX,
  TEXELS,
} from './shaders'

export type Rgb = readonly [number, number, number]

/** Colours of the arena, 0 to 1. */
export interface Palette {
  background: Rgb
  floor: Rgb
  grid: Rgb
  wall: Rgb
  obstacle: Rgb
  edge: Rgb
  /** One per state, in the order of the wire. */
  states: readonly Rgb[]
  /** Marks inside a robot. */
  mark: Rgb
  outline: Rgb
  gone: Rgb
  accent: Rgb
}

/** Radius of a robot, metres, drawn no smaller than {@link View.smallest} pixels. */
export const ROBOT_RADIUS = 0.1
/** Half the opening of a US-100's beam. */
export const CONE_HALF_ANGLE = (7.5 * Math.PI) / 180
/** Readings beyond this are drawn as "nothing in reach", metres. */
export const LONGEST_CONE = 4.5

export interface View {
  camera: Camera
  size: Size
  /** Server time to draw, Unix milliseconds. */
  time: number
  /** Smallest radius of a robot, CSS pixels. */
  smallest: number
  cones: 'all' | 'selected' | 'none'
}

interface Program {
  program: WebGLProgram
  uniform(name: string): WebGLUniformLocation | null
}

interface Resources {
  robots: Program
  cones: Program
  scene: Program
  texture: WebGLTexture
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
  /** Contents of the robot texture; grown in steps, so that uploads reuse it. */
  private texels = new Float32Array(0)
  private rows = 0
  private count = 0
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
    this.uploadScene()
  }

  setPalette(palette: Palette): void {
    this.palette = palette
  }

  setArena(arena: Arena | null): void {
    this.scene = arena === null ? null : buildScene(arena)
    this.uploadScene()
  }

  /** Takes over poses and states; call once per feed frame, not per picture. */
  setRobots(robots: Iterable<Robot>, most: number, selected: string | null, base: number): void {
    this.reserve(most)
    this.base = base
    let chosen: Robot | null = null
    let row = 0
    for (const robot of robots) {
      if (!robot.placed) continue
      if (robot.id === selected) chosen = robot
      else this.write(row++, robot, false)
    }
    // Last, so that it is drawn on top.
    if (chosen !== null) this.write(row++, chosen, true)
    this.count = row
    this.upload()
  }

  draw(view: View, selectedOnTop: boolean): void {
    const { gl, resources, palette } = this
    if (resources === null || palette === null || gl.isContextLost()) return
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight)
    const back = this.scene === null ? palette.floor : palette.background
    gl.clearColor(back[0], back[1], back[2], 1)
    gl.clear(gl.COLOR_BUFFER_BIT)
    gl.disable(gl.BLEND)
    if (this.scene !== null) this.drawScene(resources, palette, view, this.scene)
    if (this.count === 0) return
    gl.enable(gl.BLEND)
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA)
    gl.bindVertexArray(resources.emptyArray)
    gl.activeTexture(gl.TEXTURE0)
    gl.bindTexture(gl.TEXTURE_2D, resources.texture)
    this.drawCones(resources, palette, view, selectedOnTop)
    this.drawRobots(resources, palette, view)
  }

  private drawScene(resources: Resources, palette: Palette, view: View, scene: Scene): void {
    const { gl } = this
    gl.useProgram(resources.scene.program)
    setView(gl, resources.scene, view)
    const tones = [palette.floor, palette.grid, palette.wall, palette.obstacle, palette.edge]
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

  private drawCones(resources: Resources, palette: Palette, view: View, chosen: boolean): void {
    const { gl } = this
    const perRobot = 3 * CONE_STEPS
    const first = view.cones === 'all' ? 0 : this.count - 1
    if (view.cones === 'none' || (view.cones === 'selected' && !chosen)) return
    gl.useProgram(resources.cones.program)
    setView(gl, resources.cones, view)
    gl.uniform1f(resources.cones.uniform('uTime'), view.time - this.base)
    gl.uniform1f(resources.cones.uniform('uHalfAngle'), CONE_HALF_ANGLE)
    gl.uniform1f(resources.cones.uniform('uLongest'), LONGEST_CONE)
    gl.uniform3fv(resources.cones.uniform('uStates'), palette.states.flat())
    gl.uniform3fv(resources.cones.uniform('uGone'), palette.gone)
    gl.drawArrays(gl.TRIANGLES, first * perRobot, (this.count - first) * perRobot)
  }

  private drawRobots(resources: Resources, palette: Palette, view: View): void {
    const { gl } = this
    const program = resources.robots
    gl.useProgram(program.program)
    setView(gl, program, view)
    gl.uniform1f(program.uniform('uTime'), view.time - this.base)
    gl.uniform1f(program.uniform('uRadius'), drawnRadius(view))
    gl.uniform3fv(program.uniform('uStates'), palette.states.flat())
    gl.uniform3fv(program.uniform('uMark'), palette.mark)
    gl.uniform3fv(program.uniform('uOutline'), palette.outline)
    gl.uniform3fv(program.uniform('uGone'), palette.gone)
    gl.uniform3fv(program.uniform('uAccent'), palette.accent)
    gl.drawArrays(gl.TRIANGLES, 0, this.count * 6)
  }

  private reserve(robots: number): void {
    const rows = Math.max(1, Math.ceil(robots / ROW))
    if (this.texels.length < rows * ROW * TEXELS * 4) {
      this.texels = new Float32Array(rows * ROW * TEXELS * 4)
    }
  }

  private write(row: number, robot: Robot, selected: boolean): void {
    this.texels.set(
      [
        robot.fromX,
        robot.fromY,
        robot.fromHeading,
        robot.fromTime - this.base,
        robot.x,
        robot.y,
        robot.heading,
        robot.time - this.base,
        STATES.indexOf(robot.state),
        PRESENCES.indexOf(robot.presence),
        KINDS.indexOf(robot.kind) + (selected ? 4 : 0),
        robot.range === null ? -1 : robot.range / 1_000,
      ],
      row * TEXELS * 4,
    )
  }

  private upload(): void {
    const { gl, resources } = this
    if (resources === null) return
    const width = ROW * TEXELS
    const rows = this.texels.length / (width * 4)
    if (rows === 0) return
    gl.bindTexture(gl.TEXTURE_2D, resources.texture)
    if (rows !== this.rows) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, rows, 0, gl.RGBA, gl.FLOAT, this.texels)
      this.rows = rows
    } else {
      const used = Math.max(1, Math.ceil(this.count / ROW))
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, used, gl.RGBA, gl.FLOAT, this.texels)
    }
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

/** Whether WebGL runs without a graphics card, by the name of what draws. */
function drawsOnProcessor(): boolean {
  const gl = document.createElement('canvas').getContext('webgl2')
  if (gl === null) return false
  const names = gl.getExtension('WEBGL_debug_renderer_info')
  const name: unknown = gl.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER)
  gl.getExtension('WEBGL_lose_context')?.loseContext()
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(String(name))
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

function createResources(gl: WebGL2RenderingContext): Resources | null {
  try {
    const texture = made(gl.createTexture())
    gl.bindTexture(gl.TEXTURE_2D, texture)
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST)
    }
    const triangles = made(gl.createBuffer())
    const lines = made(gl.createBuffer())
    return {
      robots: createProgram(gl, ROBOT_VERTEX, ROBOT_FRAGMENT),
      cones: createProgram(gl, CONE_VERTEX, CONE_FRAGMENT),
      scene: createProgram(gl, SCENE_VERTEX, SCENE_FRAGMENT),
      texture,
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

function createArray(gl: WebGL2RenderingContext, buffer: WebGLBuffer): WebGLVertexArrayObject {
  const array = made(gl.createVertexArray())
  gl.bindVertexArray(array)
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer)
  gl.enableVertexAttribArray(0)
  gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0)
  gl.bindVertexArray(null)
  return array
}

function createProgram(gl: WebGL2RenderingContext, vertex: string, fragment: string): Program {
  const program = made(gl.createProgram())
  for (const [type, source] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ] as const) {
    const shader = made(gl.createShader(type))
    gl.shaderSource(shader, source)
    gl.compileShader(shader)
    gl.attachShader(program, shader)
    if (gl.getShaderParameter(shader, gl.COMPILE_STATUS) === false) {
      throw new Error(gl.getShaderInfoLog(shader) ?? 'shader')
    }
  }
  gl.linkProgram(program)
  if (gl.getProgramParameter(program, gl.LINK_STATUS) === false) {
    throw new Error(gl.getProgramInfoLog(program) ?? 'program')
  }
  const known = new Map<string, WebGLUniformLocation | null>()
  return {
    program,
    uniform(name) {
      let location = known.get(name)
      if (location === undefined) {
        location = gl.getUniformLocation(program, name)
        known.set(name, location)
      }
      return location
    },
  }
}

function made<T>(value: T | null): T {
  if (value === null) throw new Error('the graphics context gave nothing')
  return value
}
