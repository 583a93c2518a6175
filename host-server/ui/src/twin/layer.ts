/** The twin of the selected robot: where it is by what its motors did, and where it will be in a second. */

import { trouble } from '../account/trouble'
import type { TwinForecastsBody } from '../api-types'
import type { Failure } from '../arena/asked-layer'
import { AskedLayer } from '../arena/asked-layer'
import type { Camera, Size } from '../arena/camera'
import type { Ink } from '../arena/overlay'
import type { Stage } from '../arena/stage'
import type { Room } from '../control/room'
import { ApiError } from '../http'
import { words } from '../strings-twin'
import type { TwinApi } from './api'
import { paint } from './paint'

/** From one answer to the next question: twins are stepped as telemetry comes, five times a second. */
export const ASK_EVERY_MS = 400
/** Where there is none, there will not be one so soon. */
export const AGAIN_MS = 2_000
/** What is then no longer so. */
const GONE = new Set(['no_twin', 'unknown_robot'])

export class TwinLayer extends AskedLayer<TwinForecastsBody> {
  /** Null while there is none. */
  readonly twin = this.body

  constructor(
    room: Room,
    stage: Stage,
    private readonly api: Pick<TwinApi, 'forecast'>,
  ) {
    super(room, stage, ASK_EVERY_MS, AGAIN_MS)
  }

  protected override ask(robot: string): Promise<TwinForecastsBody> {
    return this.api.forecast(robot)
  }

  protected override describe(robot: string | null, twin: TwinForecastsBody | null): string {
    if (robot === null) return words.nobody
    return twin === null ? words.asking(robot) : words.twin(robot, twin, this.room.serverNow())
  }

  protected override fail(robot: string, error: unknown): Failure {
    return {
      gone: error instanceof ApiError && GONE.has(error.code ?? ''),
      said: words.failed(robot, trouble(error)),
    }
  }

  protected override paint(
    context: CanvasRenderingContext2D,
    ink: Ink,
    view: { camera: Camera; size: Size },
    twin: TwinForecastsBody,
  ): boolean {
    return paint(context, ink, { ...view, twin })
  }
}
