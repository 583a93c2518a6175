/** What the selected robot knows of its surroundings, and its plan. */

import { trouble } from '../account/trouble'
import type { MapBody } from '../api-types'
import type { Failure } from '../arena/asked-layer'
import { AskedLayer } from '../arena/asked-layer'
import type { Camera, Size } from '../arena/camera'
import type { Ink } from '../arena/overlay'
import type { Stage } from '../arena/stage'
import type { Room } from '../control/room'
import { ApiError } from '../http'
import { words } from '../strings-map'
import type { MapApi } from './api'
import { paint } from './paint'

/** From one answer to the next question: the server asks the robot no more often. */
export const ASK_EVERY_MS = 1_000
/** What is then no longer so: the robot has gone, has no map, or never had one. */
const GONE = new Set(['no_map', 'tells_no_map', 'unknown_robot', 'robot_offline'])

export class MapLayer extends AskedLayer<MapBody> {
  /** Null while there is none. */
  readonly map = this.body

  constructor(
    room: Room,
    stage: Stage,
    private readonly api: MapApi,
  ) {
    super(room, stage, ASK_EVERY_MS, ASK_EVERY_MS)
  }

  protected override ask(robot: string): Promise<MapBody> {
    return this.api.map(robot)
  }

  protected override describe(robot: string | null, map: MapBody | null): string {
    if (robot === null) return words.nobody
    return map === null ? words.asking(robot) : words.map(robot, map)
  }

  protected override fail(robot: string, error: unknown): Failure {
    const code = error instanceof ApiError ? error.code : null
    return {
      gone: code !== null && GONE.has(code),
      said: code === 'no_map' ? words.none(robot) : words.failed(robot, trouble(error)),
    }
  }

  protected override paint(
    context: CanvasRenderingContext2D,
    ink: Ink,
    view: { camera: Camera; size: Size },
    map: MapBody,
  ): boolean {
    return paint(context, ink, { ...view, map })
  }
}
