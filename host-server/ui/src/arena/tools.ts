/** What hands and keys do in the arena: choosing robots, drawing around them, sending them. */

import type { Ref } from 'vue'
import { computed, ref } from 'vue'
import type { Room } from '../control/room'
import { position, text } from '../strings'
import { words as account } from '../strings-account'
import { words } from '../strings-arena'
import { toScreen, toWorld } from './camera'
import { clusterAt } from './cluster'
import type { Keys } from './gestures'
import { Goals } from './goals'
import { Lasso } from './lasso'
import { nearest } from './pick'
import { assign } from './spread'
import type { Stage } from './stage'
import { poseAt } from '../fleet/fleet'

export type Tool = 'none' | 'lasso' | 'go' | 'fence'

/** What draws fences; it comes when it is there. */
interface FencePen {
  press(x: number, y: number): void
  close(): void
  cancel(): void
}

/** Finger or pointer this close to a robot selects it, pixels. */
const REACH = 18
/** How long what was said stands beside the tools. */
const SAID_MS = 6_000
/** Robots sent to one point at a time: each is a command of its own, and needs a place. */
const MOST_SENT = 200

export class ArenaTools {
  readonly tool: Ref<Tool> = ref('none')
  /** Said beside the tools until something else happens. */
  readonly said = ref('')
  readonly goals: Goals
  pen: FencePen | null = null
  private line: Lasso | null = null
  private silence: ReturnType<typeof setTimeout> | null = null

  /** Why nothing may be sent anywhere; null when it may. */
  readonly goBlocked = computed<string | null>(() => {
    const { room } = this
    void room.tick.value
    if (!room.mayOperate.value) return account.need.operator
    if (room.stopState.value !== 'armed') return text.drive.blocked.stopped
    if (room.status.value.state !== 'live') return text.drive.blocked.link
    const count = this.sendable().length
    if (count > MOST_SENT) return words.goMany(MOST_SENT)
    return count === 0 ? words.goFirst : null
  })
  /** How many robots a click would send. */
  readonly count = computed(() => {
    void this.room.tick.value
    return this.sendable().length
  })

  constructor(
    private readonly room: Room,
    private readonly stage: Stage,
    private readonly onChosen: () => void,
  ) {
    this.goals = new Goals({
      api: room.api,
      words: (status, reason) => text.log.refused('goto', status, reason),
      onEnd: ({ robot, state, why }) => {
        if (state === 'failed') room.note('warn', robot, why ?? '')
        else room.note('info', robot, words.reached)
      },
    })
  }

  toggle(tool: 'lasso' | 'go'): void {
    if (this.tool.value === 'fence') this.leave()
    this.said.value = ''
    if (tool === 'go' && this.tool.value !== 'go' && this.goBlocked.value !== null) {
      this.say(this.goBlocked.value)
      return
    }
    this.tool.value = this.tool.value === tool ? 'none' : tool
    this.showCross()
  }

  /** True when there was a tool to put away. */
  leave(): boolean {
    const had = this.tool.value !== 'none' || this.line !== null
    this.pen?.cancel()
    this.tool.value = 'none'
    this.endLasso(false, null)
    this.said.value = ''
    this.showCross()
    return had
  }

  tap(x: number, y: number, keys: Keys): void {
    this.said.value = ''
    if (this.tool.value === 'fence') {
      this.pen?.press(x, y)
      return
    }
    if (this.tool.value === 'go') {
      this.go(x, y)
      return
    }
    const { room, stage } = this
    const view = stage.view()
    const found = nearest(room.fleet.all(), view, x, y, view.points ? 3 : REACH)
    const adding = keys.shiftKey || keys.ctrlKey || keys.metaKey
    const cluster = clusterAt(stage.clusters.value, view.camera, view.size, x, y)
    if (cluster !== null && !adding) {
      stage.comeNear(cluster)
    } else if (adding) {
      if (found !== null) this.room.selection.toggle(found.id)
    } else {
      room.select(found?.id ?? null)
      if (found !== null) this.onChosen()
    }
  }

  /** What Enter does: the robot nearest to the middle, or a goal there; closes a fence. */
  aim(add: boolean): void {
    const { width, height } = this.stage.size
    this.said.value = ''
    if (this.tool.value === 'fence') {
      this.pen?.close()
      return
    }
    if (this.tool.value === 'go') {
      this.go(width / 2, height / 2)
      return
    }
    const reach = Math.max(width, height)
    const found = nearest(this.room.fleet.all(), this.stage.view(), width / 2, height / 2, reach)
    if (found === null) return
    if (add) this.room.selection.toggle(found.id)
    else this.room.select(found.id)
    this.room.announcement.value = found.id
  }

  startLasso(x: number, y: number): void {
    if (this.tool.value === 'fence') return
    this.said.value = ''
    this.line = new Lasso([x, y])
  }

  moveLasso(x: number, y: number): void {
    if (this.line?.extend([x, y]) !== true) return
    this.stage.lasso = this.line.points
    this.stage.drawOver()
  }

  /** Whoever is inside is chosen: instead of those before, or beside them with Ctrl. */
  endLasso(done: boolean, keys: Keys | null): void {
    const { line } = this
    this.line = null
    this.stage.lasso = []
    this.stage.drawOver()
    if (!done || line?.closed !== true) return
    const view = this.stage.view()
    const inside: string[] = []
    for (const robot of this.room.fleet.all()) {
      if (!robot.placed) continue
      const pose = poseAt(robot, view.time)
      const [x, y] = toScreen(view.camera, view.size, pose.x, pose.y)
      if (line.holds(x, y)) inside.push(robot.id)
    }
    const { selection } = this.room
    if (keys?.ctrlKey === true || keys?.metaKey === true) selection.add(inside)
    else selection.replace(inside)
    this.tool.value = 'none'
    this.showCross()
    this.say(inside.length === 0 ? words.nobody : words.group(selection.size))
  }

  /** Sends whoever is chosen to a point of the screen. */
  private go(x: number, y: number): void {
    const blocked = this.goBlocked.value
    if (blocked !== null) {
      this.say(blocked)
      return
    }
    const { room, stage } = this
    const [wx, wy] = toWorld(stage.camera.value, stage.size, x, y)
    const robots = this.sendable()
    const left = this.wanted().length - robots.length
    room.driver.releaseAll()
    this.tool.value = 'none'
    this.showCross()
    const told = words.sent(robots.length, position(wx, wy))
    this.say(left === 0 ? told : `${told}; ${words.skipped(left)}`)
    room.note('info', robots.length === 1 ? (robots[0]?.id ?? null) : null, this.said.value)
    void this.goals.send(assign(robots, wx, wy, room.arena.value))
  }

  /** The group where there is one, else the robot that is selected. */
  private wanted(): readonly string[] {
    const { selection, selectedId } = this.room
    if (selection.size > 0) return [...selection.ids.value]
    return selectedId.value === null ? [] : [selectedId.value]
  }

  private sendable(): { id: string; x: number; y: number }[] {
    return this.wanted().flatMap((id) => {
      const robot = this.room.fleet.get(id)
      return robot?.placed === true && robot.presence === 'online' ? [robot] : []
    })
  }

  private say(what: string): void {
    this.said.value = what
    if (this.silence !== null) clearTimeout(this.silence)
    this.silence = setTimeout(() => (this.said.value = ''), SAID_MS)
    this.room.announcement.value = what
  }

  /** Keys aim at the middle while the arena has the focus. */
  showCross(): void {
    const focused = document.activeElement?.closest('[data-keys="arena"]') ?? null
    const shown = focused !== null && focused.matches(':focus-visible')
    if (this.stage.cross === shown) return
    this.stage.cross = shown
    this.stage.drawOver()
  }
}
