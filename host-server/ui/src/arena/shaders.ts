/**
 * Shaders of the arena. There are no vertex buffers for robots: the vertex
 * shader fetches each robot's three texels by `gl_VertexID` and blends between
 * its poses itself, so a frame costs the processor two draw calls.
 *
 * Texels of the robot in slot i, RGBA32F, at (3·(i mod ROW), i div ROW):
 *   0  x, y, heading, time: where the robot was on the screen when its newest pose came
 *   1  x, y, heading, time: that pose, and when it is reached
 *   2  state, 1 + presence (0: an empty slot), kind + 4·selected + 8·in the group,
 *      range in metres (−1: none)
 * Times are milliseconds from the latest upload, so that f32 holds them.
 */

import { TONES } from './scene'
import { ROW, TEXELS } from './texels'
import { TRAIL } from './trails'

const COMMON = `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D uRobots;
uniform vec2 uCentre;
uniform vec2 uToClip;
uniform float uTime;
struct Robot { vec2 at; float heading; int state; int presence; int kind; bool selected; bool group; float range; };
Robot robot(int i) {
  ivec2 p = ivec2((i % ${String(ROW)}) * ${String(TEXELS)}, i / ${String(ROW)});
  vec4 a = texelFetch(uRobots, p, 0);
  vec4 b = texelFetch(uRobots, p + ivec2(1, 0), 0);
  vec4 c = texelFetch(uRobots, p + ivec2(2, 0), 0);
  float span = b.w - a.w;
  float t = span > 0.0 ? clamp((uTime - a.w) / span, 0.0, 1.0) : 1.0;
  float turn = mod(b.z - a.z + 3.14159265, 6.28318531) - 3.14159265;
  int packed = int(c.z);
  return Robot(mix(a.xy, b.xy, t), a.z + turn * t, int(c.x), int(c.y) - 1, packed & 3,
    (packed & 4) != 0, (packed & 8) != 0, c.w);
}
vec4 clip(vec2 world) { return vec4((world - uCentre) * uToClip, 0.0, 1.0); }
`

/** Six corners of a square per robot; the outline is drawn by distance. */
export const ROBOT_VERTEX = `${COMMON}
uniform float uRadius;
uniform float uPoints;
out vec2 vAt;
out vec2 vAhead;
flat out ivec4 vWhat;
const vec2 CORNERS[6] = vec2[6](
  vec2(-1.0, -1.0), vec2(1.0, -1.0), vec2(-1.0, 1.0), vec2(-1.0, 1.0), vec2(1.0, -1.0), vec2(1.0, 1.0));
void main() {
  Robot r = robot(gl_VertexID / 6);
  /* Room for the rings around selected robots; for the others, for the nose. */
  bool point = uPoints > 0.5;
  vec2 corner = CORNERS[gl_VertexID % 6] * (point ? 0.6 : r.selected || r.group ? 2.3 : 1.75);
  if (r.presence < 0) corner = vec2(0.0);
  vAt = corner;
  vAhead = vec2(cos(r.heading), sin(r.heading));
  vWhat = ivec4(r.state, r.presence, point ? 3 : r.kind, int(r.selected) + 2 * int(r.group));
  gl_Position = clip(r.at + corner * uRadius);
}`

export const ROBOT_FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
in vec2 vAt;
in vec2 vAhead;
flat in ivec4 vWhat;
uniform vec3 uStates[8];
uniform vec3 uMark;
uniform vec3 uOutline;
uniform vec3 uFrame;
uniform vec3 uGone;
uniform vec3 uAccent;
out vec4 colour;

float box(vec2 p, vec2 b) { vec2 d = abs(p) - b; return length(max(d, 0.0)) + min(max(d.x, d.y), 0.0); }
float stroke(vec2 p, vec2 a, vec2 b, float w) {
  vec2 d = b - a;
  return length(p - a - d * clamp(dot(p - a, d) / dot(d, d), 0.0, 1.0)) - w;
}
/* Triangle with its point at +x. */
float dart(vec2 p, float back, float tip, float half_) {
  vec2 q = vec2(p.x, abs(p.y));
  vec2 n = normalize(vec2(half_, tip - back));
  return max(dot(q - vec2(tip, 0.0), n), back - q.x);
}
float body(int kind, vec2 p) {
  if (kind == 1) return (abs(p.x) + abs(p.y) - 1.2) * 0.70711;
  if (kind == 2) return box(p, vec2(0.92)) - 0.1;
  return length(p) - 1.0;
}
/* One mark per state, so that colour never speaks alone. */
float mark(int state, vec2 p, vec2 q) {
  if (state == 0) return min(length(q) - 0.16, length(vec2(abs(q.x) - 0.46, q.y)) - 0.16);
  if (state == 1) return box(q, vec2(0.32));
  if (state == 2) return dart(p, -0.38, 0.58, 0.5);
  if (state == 3) return abs(length(q) - 0.42) - 0.13;
  if (state == 4) return min(stroke(q, vec2(0.0, 0.5), vec2(0.0, 0.0), 0.13), length(q + vec2(0.0, 0.44)) - 0.15);
  if (state == 5) return stroke(vec2(p.x, abs(p.y)), vec2(-0.34, 0.48), vec2(0.22, 0.0), 0.14);
  if (state == 6) return min(stroke(q, vec2(0.0, -0.46), vec2(0.0, 0.4), 0.13), stroke(vec2(abs(q.x), q.y), vec2(0.0, 0.46), vec2(0.36, 0.1), 0.13));
  return min(stroke(q, vec2(-0.4), vec2(0.4), 0.14), stroke(q, vec2(-0.4, 0.4), vec2(0.4, -0.4), 0.14));
}
void main() {
  vec2 q = vAt;
  if (vWhat.z == 3) {
    colour = vec4(vWhat.y == 0 ? uStates[vWhat.x] : uGone, 1.0) * 0.55;
    return;
  }
  vec2 p = vec2(dot(q, vAhead), dot(q, vec2(-vAhead.y, vAhead.x)));
  float soft = fwidth(q.x);
  float hull = min(body(vWhat.z, p), dart(p, 0.7, 1.55, 0.55));
  /* What is physical can be hurt and can hurt: a heavy frame on top of the square. */
  float line = max(vWhat.z == 2 ? 0.4 : 0.18, 1.2 * soft);
  if (vWhat.w == 0 && hull > line) discard;
  bool gone = vWhat.y == 2;
  vec3 tone = gone ? uGone : uStates[vWhat.x];
  float inside = 1.0 - smoothstep(-soft, soft, hull);
  float rim = 1.0 - smoothstep(-soft, soft, abs(hull) - line * 0.5);
  float sign_ = (1.0 - smoothstep(-soft, soft, mark(vWhat.x, p, q))) * inside;
  /* Stale is hatched, offline is hollow. */
  float hatch = step(0.5, fract((q.x + q.y) * 1.6));
  float fill = inside * (gone ? 0.0 : (vWhat.y == 1 ? mix(0.25, 0.8, hatch) : 1.0));
  vec4 c = vec4(tone, fill);
  c = mix(c, vec4(gone ? uGone : uMark, 1.0), sign_);
  c = mix(c, vec4(gone ? uGone : vWhat.z == 2 ? uFrame : uOutline, 1.0), rim);
  /* A dashed ring for those of the group, a whole one outside it for the one that is driven. */
  if (vWhat.w >= 2) {
    /* Dashes that are smaller than pixels would be noise. */
    float dashes = soft > 0.17 ? 1.0 : step(0.4, fract(atan(q.y, q.x) * 1.27324));
    float ring = dashes * (1.0 - smoothstep(-soft, soft, abs(length(q) - 1.6) - max(0.12, soft)));
    c = mix(c, vec4(uAccent, 1.0), ring);
  }
  if ((vWhat.w & 1) == 1) {
    float ring = 1.0 - smoothstep(-soft, soft, abs(length(q) - 1.95) - max(0.11, soft));
    c = mix(c, vec4(uAccent, 1.0), ring);
  }
  if (c.a < 0.01) discard;
  colour = vec4(c.rgb * c.a, c.a);
}`

/** Corners of the trail of one robot: two triangles for each piece. */
export const TRAIL_CORNERS = 6 * (TRAIL - 1)

export const TRAIL_VERTEX = `${COMMON}
uniform highp sampler2DArray uHistory;
uniform int uHead;
uniform float uWidth;
flat out int vState;
flat out float vStrength;
out float vAge;
const ivec2 CORNERS[6] = ivec2[6](
  ivec2(0, -1), ivec2(1, -1), ivec2(0, 1), ivec2(0, 1), ivec2(1, -1), ivec2(1, 1));
vec2 place(int slot, int age) {
  int layer = (uHead - age + ${String(TRAIL)}) % ${String(TRAIL)};
  return texelFetch(uHistory, ivec3(slot % ${String(ROW)}, slot / ${String(ROW)}, layer), 0).xy;
}
void main() {
  int slot = gl_VertexID / ${String(TRAIL_CORNERS)};
  int v = gl_VertexID % ${String(TRAIL_CORNERS)};
  int piece = v / 6;
  ivec2 corner = CORNERS[v % 6];
  Robot r = robot(slot);
  /* The newest piece ends where the robot is drawn; the newest place is left out, since the
     picture is behind it. */
  vec2 from = piece == 0 ? r.at : place(slot, piece);
  vec2 to = place(slot, piece + 1);
  vec2 along = to - from;
  float far = length(along);
  vec2 aside = far > 0.001 ? vec2(-along.y, along.x) / far * uWidth * float(corner.y) : vec2(0.0);
  vAge = float(piece + corner.x) / ${String(TRAIL - 1)}.0;
  vState = r.presence == 0 ? r.state : -1;
  vStrength = r.selected ? 1.0 : 0.7;
  gl_Position = r.presence < 0 ? vec4(0.0) : clip(mix(from, to, float(corner.x)) + aside);
}`

export const TRAIL_FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
flat in int vState;
flat in float vStrength;
in float vAge;
uniform vec3 uStates[8];
uniform vec3 uGone;
out vec4 colour;
void main() {
  float a = (1.0 - vAge) * 0.75 * vStrength;
  colour = vec4((vState < 0 ? uGone : uStates[vState]) * a, a);
}`

/** Triangles of one sensor cone. */
export const CONE_STEPS = 6

export const CONE_VERTEX = `${COMMON}
uniform float uHalfAngle;
uniform float uLongest;
flat out int vState;
flat out float vStrength;
out float vReach;
out float vRange;
void main() {
  Robot r = robot(gl_VertexID / ${String(3 * CONE_STEPS)});
  int v = gl_VertexID % ${String(3 * CONE_STEPS)};
  int corner = v % 3;
  float reach = 0.0;
  vec2 at = r.at;
  if (corner > 0 && r.range > 0.0 && r.presence == 0) {
    float share = float(v / 3 + corner - 1) / ${String(CONE_STEPS)}.0;
    float angle = r.heading + mix(-uHalfAngle, uHalfAngle, share);
    reach = min(r.range, uLongest);
    at += reach * vec2(cos(angle), sin(angle));
  }
  vReach = corner > 0 ? 1.0 : 0.0;
  vRange = r.range;
  vState = r.state;
  vStrength = r.selected ? 2.0 : 1.0;
  gl_Position = clip(at);
}`

export const CONE_FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
flat in int vState;
flat in float vStrength;
in float vReach;
in float vRange;
uniform vec3 uStates[8];
uniform vec3 uGone;
uniform float uLongest;
out vec4 colour;
void main() {
  /* What stands still needs no attention. */
  vec3 tone = vState == 1 || vState == 7 ? uGone : uStates[vState];
  /* An echo has a far edge; nothing in reach fades out. */
  float echo = vRange < uLongest ? smoothstep(0.955, 0.97, vReach) : 0.0;
  float a = (mix(0.2, 0.05, vReach) + 0.35 * echo) * vStrength;
  a = min(a, 0.8);
  colour = vec4(tone * a, a);
}`

/** Walls, obstacles and grid: plain coloured triangles and lines. */
export const SCENE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 aVertex;
uniform vec2 uCentre;
uniform vec2 uToClip;
uniform vec3 uTones[${String(TONES)}];
flat out vec3 vTone;
void main() {
  vTone = uTones[int(aVertex.z)];
  gl_Position = vec4((aVertex.xy - uCentre) * uToClip, 0.0, 1.0);
}`

export const SCENE_FRAGMENT = `#version 300 es
precision highp float;
flat in vec3 vTone;
out vec4 colour;
void main() { colour = vec4(vTone, 1.0); }`
