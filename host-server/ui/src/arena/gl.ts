/** The little of WebGL2 that is the same for everything that is drawn. */

export interface Program {
  program: WebGLProgram
  uniform(name: string): WebGLUniformLocation | null
}

/** Whether WebGL runs without a graphics card, by the name of what draws. */
export function drawsOnProcessor(): boolean {
  const gl = document.createElement('canvas').getContext('webgl2')
  if (gl === null) return false
  const names = gl.getExtension('WEBGL_debug_renderer_info')
  const name: unknown = gl.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER)
  gl.getExtension('WEBGL_lose_context')?.loseContext()
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(String(name))
}

export function createArray(
  gl: WebGL2RenderingContext,
  buffer: WebGLBuffer,
): WebGLVertexArrayObject {
  const array = made(gl.createVertexArray())
  gl.bindVertexArray(array)
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer)
  gl.enableVertexAttribArray(0)
  gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0)
  gl.bindVertexArray(null)
  return array
}

export function createProgram(
  gl: WebGL2RenderingContext,
  vertex: string,
  fragment: string,
): Program {
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

export function made<T>(value: T | null): T {
  if (value === null) throw new Error('the graphics context gave nothing')
  return value
}
